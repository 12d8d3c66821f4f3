//! The five networks of RigNet [Xu et al. 2020], Table 6, as typed functions.
//!
//! | function                | in                                                         | out                             |
//! |-------------------------|------------------------------------------------------------|---------------------------------|
//! | [`RigNets::displaced`]  | shape graph                                                | `[V, 3]` points near joints, Eq. 1 |
//! | [`RigNets::attention`]  | shape graph                                                | `[V]` in 0 to 1, Eq. 2          |
//! | [`RigNets::bone_probability`] | shape graph, [`JointPairs`]                          | `[P]` in 0 to 1, Eq. 7          |
//! | [`RigNets::root`]       | shape graph, [`JointPairs`]                                | index of the root joint, Eq. 8  |
//! | [`RigNets::skin_logits`] | shape graph, bone features `[V, 40]`, mask `[V, 5]`       | `[V, 5]` logits, Eq. 9          |
//!
//! All positions are in the normalised frame (y up, facing +z, longest side 1, x and z centred, lowest y 0). A network is given those
//! inputs that it has: published weights read no medial offsets, ours for bones and root read no neighbours.

use super::error::NetError;
use super::network::{Input, Network};
use crate::cancellation::Cancellation;
use ndarray::{Array2, ArrayD, ArrayView2, Axis, Ix1, Ix2};

/// A working mesh as the networks see it.
///
/// Each row of a neighbour table starts with the vertex itself; short rows are padded with it, which a maximum does
/// not notice.
#[derive(Clone)]
pub struct ShapeGraph {
    /// `[V, 3]`
    pub positions: Array2<f32>,
    /// `[V, 3]`: from the vertex to the middle of its body part, see [`crate::geometry::medial_offset`].
    pub medial_offsets: Array2<f32>,
    /// `[V, K]`: the vertex, and all vertices that share an edge with it.
    pub one_ring: Array2<i64>,
    /// `[V, K]`: the vertex, and some of those within the geodesic ball.
    pub geodesic_ball: Array2<i64>,
}

/// Joints, and what the solid says of every two of them.
pub struct JointPairs {
    /// `[J, 3]`
    pub joints: Array2<f32>,
    /// `[P, 2]`: all pairs of joint indices i < j, in lexicographic order.
    pub pairs: Array2<i64>,
    /// `[P, 2]`: the length and the inside share of each pair's segment.
    pub features: Array2<f32>,
}

/// The networks of RigNet, loaded and checked.
pub struct RigNets {
    pub(super) displacement: Network,
    pub(super) attention: Network,
    pub(super) bone: Network,
    pub(super) root: Network,
    pub(super) skin: Network,
}

impl RigNets {
    /// File stems in the models folder, in the order of the fields.
    pub const NETWORKS: [&str; 5] =
        ["rignet_displacement", "rignet_attention", "rignet_bone", "rignet_root", "rignet_skin"];

    /// Vertices moved toward the joints that drive them: positions + displacement, `[V, 3]`.
    pub fn displaced(&self, graph: &ShapeGraph, cancellation: &Cancellation) -> Result<Array2<f32>, NetError> {
        let displacement =
            self.displacement.run(&wanted(&self.displacement, graph.inputs()), "displacement", cancellation)?;
        let displacement = shaped::<Ix2>(&self.displacement, displacement, &[graph.vertex_count(), 3])?;
        Ok(&graph.positions + &displacement)
    }

    /// How much each vertex says about joints, `[V]`, 0 to 1.
    pub fn attention(&self, graph: &ShapeGraph, cancellation: &Cancellation) -> Result<Vec<f32>, NetError> {
        let logits = self.attention.run(&wanted(&self.attention, graph.inputs()), "attention_logit", cancellation)?;
        let logits = shaped::<Ix1>(&self.attention, logits, &[graph.vertex_count()])?;
        Ok(logits.iter().map(|&logit| sigmoid(logit)).collect())
    }

    /// The probability that each pair of joints is a bone, `[P]`.
    pub fn bone_probability(
        &self,
        graph: &ShapeGraph,
        joints: &JointPairs,
        cancellation: &Cancellation,
    ) -> Result<Vec<f32>, NetError> {
        let inputs = wanted(&self.bone, [graph.inputs(), joints.inputs()].concat());
        let logits = self.bone.run(&inputs, "bone_logit", cancellation)?;
        let logits = shaped::<Ix1>(&self.bone, logits, &[joints.pairs.len_of(Axis(0))])?;
        Ok(logits.iter().map(|&logit| sigmoid(logit)).collect())
    }

    /// The joint that is most likely the root.
    pub fn root(
        &self,
        graph: &ShapeGraph,
        joints: &JointPairs,
        cancellation: &Cancellation,
    ) -> Result<usize, NetError> {
        let inputs = wanted(&self.root, [graph.inputs(), joints.inputs()].concat());
        let logits = self.root.run(&inputs, "root_logit", cancellation)?;
        let logits = shaped::<Ix1>(&self.root, logits, &[joints.joints.len_of(Axis(0))])?;
        // The first of equal maxima, so that the choice does not depend on iteration order.
        let best = logits.iter().enumerate().fold(
            (0, f32::MIN),
            |best, (index, &logit)| {
                if logit > best.1 { (index, logit) } else { best }
            },
        );
        Ok(best.0)
    }

    /// Logits over each vertex's five nearest bones, `[V, 5]`, before softmax and mask.
    pub fn skin_logits(
        &self,
        graph: &ShapeGraph,
        bone_features: ArrayView2<f32>,
        bone_mask: ArrayView2<f32>,
        cancellation: &Cancellation,
    ) -> Result<Array2<f32>, NetError> {
        let mut inputs = wanted(&self.skin, graph.inputs());
        inputs.push(("bone_features", Input::F32(bone_features.into_dyn())));
        inputs.push(("bone_mask", Input::F32(bone_mask.into_dyn())));
        let logits = self.skin.run(&inputs, "skin_logit", cancellation)?;
        shaped::<Ix2>(&self.skin, logits, &[graph.vertex_count(), bone_mask.len_of(Axis(1))])
    }
}

impl ShapeGraph {
    /// The same neighbours with the vertices and their offsets elsewhere, both `[V, 3]`.
    pub fn moved(&self, positions: Array2<f32>, medial_offsets: Array2<f32>) -> Self {
        Self { positions, medial_offsets, one_ring: self.one_ring.clone(), geodesic_ball: self.geodesic_ball.clone() }
    }

    pub fn vertex_count(&self) -> usize {
        self.positions.len_of(Axis(0))
    }

    fn inputs(&self) -> Vec<(&'static str, Input<'_>)> {
        vec![
            ("positions", Input::F32(self.positions.view().into_dyn())),
            ("one_ring", Input::I64(self.one_ring.view().into_dyn())),
            ("geodesic_ball", Input::I64(self.geodesic_ball.view().into_dyn())),
            ("medial_offsets", Input::F32(self.medial_offsets.view().into_dyn())),
        ]
    }
}

impl JointPairs {
    fn inputs(&self) -> Vec<(&'static str, Input<'_>)> {
        vec![
            ("joints", Input::F32(self.joints.view().into_dyn())),
            ("pairs", Input::I64(self.pairs.view().into_dyn())),
            ("pair_features", Input::F32(self.features.view().into_dyn())),
        ]
    }
}

/// Those of `inputs` that `network` has.
fn wanted<'a>(network: &Network, mut inputs: Vec<(&'static str, Input<'a>)>) -> Vec<(&'static str, Input<'a>)> {
    inputs.retain(|(name, _)| network.input_names().iter().any(|known| known == name));
    inputs
}

fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

/// The output as an array of the given shape; another shape means that program and models do not fit together.
pub(super) fn shaped<D: ndarray::Dimension>(
    network: &Network,
    values: ArrayD<f32>,
    expected: &[usize],
) -> Result<ndarray::Array<f32, D>, NetError> {
    let got = values.shape().to_vec();
    let wrong = || NetError::Interface {
        network: network.name().to_owned(),
        what: "output shape",
        got: format!("{got:?}"),
        expected: format!("{expected:?}"),
    };
    if got != expected {
        return Err(wrong());
    }
    values.into_dimensionality::<D>().map_err(|_| wrong())
}
