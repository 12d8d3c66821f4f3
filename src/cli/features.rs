//! `rigsmith features`: what the networks see of training characters, computed by the code that the service runs, so
//! that training and service cannot drift apart.

use super::failure::Failure;
use super::files::write_whole;
use clap::Args;
use glam::DVec3;
use rayon::prelude::*;
use rigsmith::cancellation::Cancellation;
use rigsmith::formats::npz::{Array, Arrays, NpzError, Values};
use rigsmith::mesh::Mesh;
use rigsmith::mesh::adjacency::Neighbors;
use rigsmith::pipelines::heter_skin::WeighedBones;
use rigsmith::pipelines::shape::Shape;
use rigsmith::rig::heter_graph::{HeterGraph, JOINT_CHANNELS, LINK_CHANNELS, LINKS, SIGHT};
use rigsmith::rig::skeleton::Bone;
use rigsmith::rig::{Joint, Skeleton};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Compute the arrays that the networks are trained on.
///
/// IN holds characters as `KEY/vertices` [V,3], `KEY/faces` [F,3], `KEY/joints` [J,3] and `KEY/parents` [J] (parent
/// index, -1 for joint 0; parents come first), in the normalised frame, with faces that have an area. The mesh is taken as
/// it is. OUT gets, per character: `KEY/one_ring_offsets` [V+1], `KEY/one_ring` and `KEY/geodesic_ball_offsets` [V+1],
/// `KEY/geodesic_ball` (compressed rows of vertex indices, own vertex excluded, the ball uncapped); `KEY/pairs` [P,2]
/// (all i < j), `KEY/pair_features` [P,2] (length, inside share); `KEY/bones` [B,2] (start joint, end joint; equal for a
/// leaf bone), `KEY/bone_distance` [V,B] (volumetric geodesic); `KEY/medial_offsets` [V,3] (from the vertex to the middle of
/// its body part); `KEY/links`, `KEY/link_mask` [V,8], `KEY/link_features` [V,8,13], `KEY/joint_features` [J,8], `KEY/joint_links`
/// [J,32], `KEY/joint_mask` [J] (the heterogeneous graph of HeterSkinNet); `KEY/symmetry` [5] (normal, offset, score).
/// A character without joints gets the arrays that need none.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct FeaturesArguments {
    /// Characters, .npz.
    input: PathBuf,
    /// Where to write, .npz.
    #[arg(short, long, value_name = "OUT.npz")]
    output: PathBuf,
}

pub fn run(arguments: &FeaturesArguments) -> Result<(), Failure> {
    let path = &arguments.input;
    let bytes = std::fs::read(path).map_err(|error| Failure::unreadable(path, &error))?;
    let input = Arrays::read(&bytes).map_err(|error| refused(path, &error))?;
    let keys: BTreeSet<&str> = input.0.keys().filter_map(|name| name.strip_suffix("/vertices")).collect();
    if keys.is_empty() {
        return Err(Failure::arguments(format!("{}: no array is named KEY/vertices", path.display())));
    }
    let keys: Vec<&str> = keys.into_iter().collect();
    let characters: Vec<Arrays> = keys
        .par_iter()
        .map(|key| features(&input, key))
        .collect::<Result<_, _>>()
        .map_err(|error| refused(path, &error))?;
    let mut output = Arrays::default();
    for character in characters {
        output.0.extend(character.0);
    }
    let bytes = output.write().map_err(|error| Failure::internal(error.to_string(), ""))?;
    write_whole(&arguments.output, &bytes)
}

fn refused(path: &Path, error: &NpzError) -> Failure {
    Failure::arguments(format!("{}: {error}", path.display()))
}

fn features(input: &Arrays, key: &str) -> Result<Arrays, NpzError> {
    let array = |name: &str| input.get(&format!("{key}/{name}"));
    let mesh = Mesh { positions: points(array("vertices")?), triangles: triangles(array("faces")?) };
    let broken = mesh.triangles.iter().flatten().any(|&corner| corner as usize >= mesh.positions.len());
    if broken || mesh.triangles.is_empty() {
        return Err(NpzError::Array {
            name: format!("{key}/faces"),
            cause: "no faces, or a corner out of range".into(),
        });
    }
    let shape = Shape::new(mesh);
    let mut output = Arrays::default();
    put_rows(&mut output, &format!("{key}/one_ring"), &shape.one_ring);
    put_rows(&mut output, &format!("{key}/geodesic_ball"), &shape.geodesic_ball);
    let offsets = shape.medial_offsets().iter().flat_map(|offset| offset.to_array().map(|c| c as f32)).collect();
    output.insert(format!("{key}/medial_offsets"), &[shape.mesh.positions.len(), 3], Values::F32(offsets));
    let plane = shape.symmetry;
    let symmetry = [plane.normal.x, plane.normal.y, plane.normal.z, plane.offset, plane.score];
    output.insert(format!("{key}/symmetry"), &[5], Values::F64(symmetry.to_vec()));
    if input.0.contains_key(&format!("{key}/joints")) {
        let skeleton = skeleton(points(array("joints")?), &array("parents")?.to_f64());
        put_skeleton(&mut output, key, &shape, &skeleton);
        let weighed = WeighedBones::new(&shape, &skeleton, &skeleton.bones(), &Cancellation::default())
            .map_err(|error| NpzError::Array { name: format!("{key}/joints"), cause: error.to_string() })?;
        put_heter_graph(&mut output, key, &weighed.heter_graph(&shape, &skeleton));
    }
    Ok(output)
}

fn put_skeleton(output: &mut Arrays, key: &str, shape: &Shape, skeleton: &Skeleton) {
    let joints: Vec<DVec3> = skeleton.joints.iter().map(|joint| joint.position).collect();
    let (pairs, segments) = shape.bone_pairs(&joints);
    let indices = pairs.iter().flatten().map(|&joint| joint as i32).collect();
    output.insert(format!("{key}/pairs"), &[pairs.len(), 2], Values::I32(indices));
    let features = segments.iter().flat_map(|pair| [pair.length as f32, pair.inside_share() as f32]).collect();
    output.insert(format!("{key}/pair_features"), &[pairs.len(), 2], Values::F32(features));
    let bones: Vec<Bone> = skeleton.bones();
    let ends = bones.iter().flat_map(|bone| [bone.start_joint as i32, bone.end_joint as i32]).collect();
    output.insert(format!("{key}/bones"), &[bones.len(), 2], Values::I32(ends));
    let segments: Vec<_> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
    let distances = shape.bone_distances(&segments);
    let size = [shape.mesh.positions.len(), bones.len()];
    output.insert(format!("{key}/bone_distance"), &size, Values::F32(distances));
}

/// The heterogeneous graph of HeterSkinNet.
fn put_heter_graph(output: &mut Arrays, key: &str, graph: &HeterGraph) {
    let vertex_count = graph.links.len() / LINKS;
    let joint_count = graph.joint_mask.len();
    let links = graph.links.iter().map(|&joint| joint as i32).collect();
    output.insert(format!("{key}/links"), &[vertex_count, LINKS], Values::I32(links));
    output.insert(format!("{key}/link_mask"), &[vertex_count, LINKS], Values::F32(graph.link_mask.clone()));
    let features = Values::F32(graph.link_features.clone());
    output.insert(format!("{key}/link_features"), &[vertex_count, LINKS, LINK_CHANNELS], features);
    let features = Values::F32(graph.joint_features.clone());
    output.insert(format!("{key}/joint_features"), &[joint_count, JOINT_CHANNELS], features);
    let seen = graph.joint_links.iter().map(|&link| link as i32).collect();
    output.insert(format!("{key}/joint_links"), &[joint_count, SIGHT], Values::I32(seen));
    output.insert(format!("{key}/joint_mask"), &[joint_count], Values::F32(graph.joint_mask.clone()));
}

fn put_rows(output: &mut Arrays, name: &str, rows: &Neighbors) {
    let offsets: Vec<i32> = rows.offsets.iter().map(|&offset| offset as i32).collect();
    output.insert(format!("{name}_offsets"), &[offsets.len()], Values::I32(offsets));
    let members: Vec<i32> = rows.members.iter().map(|&member| member as i32).collect();
    output.insert(name, &[members.len()], Values::I32(members));
}

fn points(array: &Array) -> Vec<DVec3> {
    array.to_f64().chunks_exact(3).map(DVec3::from_slice).collect()
}

fn triangles(array: &Array) -> Vec<[u32; 3]> {
    array.to_f64().chunks_exact(3).map(|corners| [corners[0] as u32, corners[1] as u32, corners[2] as u32]).collect()
}

fn skeleton(positions: Vec<DVec3>, parents: &[f64]) -> Skeleton {
    let parent = |index: usize| parents.get(index).filter(|&&parent| parent >= 0.0).map(|&parent| parent as usize);
    let joints = positions.into_iter().enumerate();
    let joint = |(index, position)| Joint { name: format!("joint_{index}"), parent: parent(index), position };
    Skeleton { joints: joints.map(joint).collect() }
}
