//! HeterSkinNet [Pan et al. 2021], Sections 3.2 to 3.4, as one typed function.
//!
//! | function                         | in                                       | out             |
//! |----------------------------------|------------------------------------------|-----------------|
//! | [`HeterSkinNet::link_logits`]    | shape graph, heterogeneous graph         | `[V, K]` logits |
//!
//! All positions are in the normalised frame.

use super::error::NetError;
use super::network::{Input, Network};
use super::rignet::{ShapeGraph, shaped};
use crate::cancellation::Cancellation;
use crate::rig::heter_graph::{HeterGraph, JOINT_CHANNELS, LINK_CHANNELS, LINKS, SIGHT};
use ndarray::{Array1, Array2, ArrayD, Ix2, IxDyn};

/// The network, loaded and checked.
pub struct HeterSkinNet(pub(super) Network);

impl HeterSkinNet {
    /// File stem in the models folder.
    pub const NETWORK: &str = "heter_skin_net";

    /// Logits over each vertex's links, `[V, K]`, before softmax; very low where a link is empty.
    pub fn link_logits(
        &self,
        graph: &ShapeGraph,
        links: &HeterGraph,
        cancellation: &Cancellation,
    ) -> Result<Array2<f32>, NetError> {
        let (vertex_count, joint_count) = (graph.vertex_count(), links.joint_mask.len());
        let widest = links.joint_neighbors.iter().map(Vec::len).max().unwrap_or(0);
        let neighbors = Array2::from_shape_fn((joint_count, 1 + widest), |(joint, column)| {
            let others = &links.joint_neighbors[joint];
            column.checked_sub(1).and_then(|at| others.get(at)).map_or(joint as i64, |&other| i64::from(other))
        });
        let indices =
            |values: &[u32], width: usize| self.array(values.iter().map(|&at| i64::from(at)).collect(), &[width]);
        let floats = |values: &[f32], tail: &[usize]| self.array(values.to_vec(), tail);
        let joint_features = floats(&links.joint_features, &[JOINT_CHANNELS])?;
        let link_joints = indices(&links.links, LINKS)?;
        let link_mask = floats(&links.link_mask, &[LINKS])?;
        let link_features = floats(&links.link_features, &[LINKS, LINK_CHANNELS])?;
        let joint_links = indices(&links.joint_links, SIGHT)?;
        let joint_mask = Array1::from(links.joint_mask.clone());
        let inputs = [
            ("positions", Input::F32(graph.positions.view().into_dyn())),
            ("medial_offsets", Input::F32(graph.medial_offsets.view().into_dyn())),
            ("one_ring", Input::I64(graph.one_ring.view().into_dyn())),
            ("joint_features", Input::F32(joint_features.view())),
            ("joint_neighbours", Input::I64(neighbors.view().into_dyn())),
            ("links", Input::I64(link_joints.view())),
            ("link_mask", Input::F32(link_mask.view())),
            ("link_features", Input::F32(link_features.view())),
            ("joint_links", Input::I64(joint_links.view())),
            ("joint_mask", Input::F32(joint_mask.view().into_dyn())),
        ];
        let logits = self.0.run(&inputs, "link_logit", cancellation)?;
        shaped::<Ix2>(&self.0, logits, &[vertex_count, LINKS])
    }

    /// Row-major values as an array of rows shaped `tail`.
    fn array<T>(&self, values: Vec<T>, tail: &[usize]) -> Result<ArrayD<T>, NetError> {
        let rows = values.len() / tail.iter().product::<usize>();
        let shape = [&[rows], tail].concat();
        ArrayD::from_shape_vec(IxDyn(&shape), values).map_err(|error| NetError::Interface {
            network: self.0.name().to_owned(),
            what: "input shape",
            got: error.to_string(),
            expected: format!("{shape:?}"),
        })
    }
}
