//! Geometry against the golden vectors of the RigNet reference, at the tolerances that their README calls fair.

use crate::golden::{Case, cases};
use glam::{DMat3, DVec3};
use rigsmith::geometry::bone_pairs::BonePair;
use rigsmith::geometry::bvh::Bvh;
use rigsmith::geometry::neighbor_table::{GEODESIC_CAP, NeighborTable};
use rigsmith::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
use rigsmith::geometry::surface_samples::SurfaceSamples;
use rigsmith::geometry::volumetric_geodesic::{
    Segment, bone_euclid, bone_visibility, distance_given_visibility, nearest_on_segment, volumetric_geodesic_distance,
};
use rigsmith::geometry::voxel_grid::{RESOLUTION, VoxelGrid};
use rigsmith::mesh::Mesh;
use rigsmith::mesh::adjacency::one_ring;
use rigsmith::mesh::normalize::Normalization;
use std::collections::BTreeSet;

/// Distances are stored in single precision.
const STORED: f64 = 1e-6;

fn mesh(case: &Case) -> Mesh {
    Mesh { positions: case.points("vertices"), triangles: case.triangles("faces") }
}

fn geodesic(case: &Case) -> SurfaceGeodesic {
    let samples =
        SurfaceSamples { positions: case.points("geo_sample_points"), normals: case.points("geo_sample_normals") };
    SurfaceGeodesic::new(&samples, &case.points("vertices"))
}

fn bones(case: &Case) -> Vec<Segment> {
    case.f64s("bones").chunks_exact(6).map(|bone| (DVec3::from_slice(bone), DVec3::from_slice(&bone[3..]))).collect()
}

fn voxels(case: &Case) -> VoxelGrid {
    VoxelGrid {
        origin: DVec3::from_slice(&case.f64s("vox_translate")),
        side: case.scalar("vox_scale"),
        inside: case.bits("vox_bits", RESOLUTION.pow(3)),
    }
}

/// The mesh that the reference cast its rays on: the original one where it has no more faces than the working mesh.
fn ray_mesh(case: &Case) -> Mesh {
    let working = mesh(case);
    let Some(mut original) = case.original_mesh() else { return working };
    if original.triangles.len() > working.triangles.len() {
        return working;
    }
    let (pivot, scale) = (DVec3::from_slice(&case.f64s("pivot")), case.scalar("scale"));
    original.positions.iter_mut().for_each(|position| *position = (*position - pivot) * scale);
    original
}

/// The reference rounds where a cell should be looked up by floor: half a cell further.
fn as_the_reference_rounds(point: DVec3, grid: &VoxelGrid) -> DVec3 {
    point + DVec3::splat(0.5 * grid.side / RESOLUTION as f64)
}

fn largest_difference(ours: impl IntoIterator<Item = f64>, golden: impl IntoIterator<Item = f64>) -> f64 {
    ours.into_iter().zip(golden).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn golden_normalisation_agrees() {
    for case in cases() {
        let raw = case.points("raw_vertices");
        let frame = Normalization::new(&raw, DMat3::IDENTITY).expect("an extent");
        let pivot = DVec3::from_slice(&case.f64s("pivot"));
        assert!(frame.pivot.distance(pivot) < STORED, "{}: {} {pivot}", case.id, frame.pivot);
        assert!((frame.scale / case.scalar("scale") - 1.0).abs() < STORED, "{}", case.id);
        for (&upload, golden) in raw.iter().zip(case.points("vertices")) {
            assert!(frame.apply(upload).distance(golden) < STORED, "{}", case.id);
        }
    }
}

#[test]
fn golden_one_ring_agrees() {
    for case in cases() {
        let ring = one_ring(&mesh(&case));
        let ours: BTreeSet<(i64, i64)> = (0..ring.vertex_count())
            .flat_map(|v| ring.row(v).iter().map(move |&n| (v as i64, i64::from(n))).collect::<Vec<_>>())
            .collect();
        let golden: BTreeSet<(i64, i64)> = case.ints("tpl_edges").chunks_exact(2).map(|e| (e[0], e[1])).collect();
        assert_eq!(ours, golden, "{}", case.id);
    }
}

#[test]
fn golden_vertex_samples_agree() {
    for case in cases() {
        let ours: Vec<i64> = geodesic(&case).sample_of_vertex().iter().map(|&s| i64::from(s)).collect();
        assert_eq!(ours, case.ints("geo_vertex_sample"), "{}", case.id);
    }
}

#[test]
fn golden_geodesic_rows_agree() {
    for case in cases() {
        let geodesic = geodesic(&case);
        let vertex_count = case.shape("vertices")[0];
        let golden = case.f64s("geo_row_distances");
        for (&vertex, golden) in case.ints("geo_rows").iter().zip(golden.chunks_exact(vertex_count)) {
            let mut ours = geodesic.row(vertex as usize);
            ours[vertex as usize] = golden[vertex as usize]; // the reference leaves 1 on the diagonal
            let difference = largest_difference(ours, golden.iter().copied());
            assert!(difference < STORED, "{} row {vertex}: {difference}", case.id);
        }
        if case.id == "17872" {
            let golden = case.f64s("geo_distances_full");
            for (vertex, golden) in golden.chunks_exact(vertex_count).enumerate() {
                let mut ours = geodesic.row(vertex);
                ours[vertex] = golden[vertex];
                let difference = largest_difference(ours, golden.iter().copied());
                assert!(difference < STORED, "{} row {vertex}: {difference}", case.id);
            }
        }
    }
}

#[test]
fn golden_ball_members_agree() {
    for case in cases() {
        let balls = geodesic(&case).balls(BALL_RADIUS);
        let offsets: Vec<i64> = balls.offsets.iter().map(|&o| i64::from(o)).collect();
        let members: Vec<i64> = balls.members.iter().map(|&m| i64::from(m)).collect();
        assert_eq!(offsets, case.ints("geo_ball_offsets"), "{}", case.id);
        assert_eq!(members, case.ints("geo_ball_members"), "{}", case.id);
    }
}

/// The reference draws at random; the rule is the same: members of the ball, ten of them or all.
#[test]
fn golden_capped_table_follows_the_sampling_rule() {
    for case in cases() {
        let balls = geodesic(&case).balls(BALL_RADIUS);
        let table = NeighborTable::capped(&balls, GEODESIC_CAP, &case.points("vertices"), 0);
        let mut golden_counts = vec![0usize; table.vertex_count];
        for edge in case.ints("geo_edges_sampled").chunks_exact(2) {
            golden_counts[edge[0] as usize] += 1;
        }
        for (vertex, &golden_count) in golden_counts.iter().enumerate() {
            let ball: BTreeSet<i64> = balls.row(vertex).iter().map(|&m| i64::from(m)).collect();
            let chosen: BTreeSet<i64> = table.row(vertex).iter().copied().filter(|&m| m != vertex as i64).collect();
            assert!(chosen.is_subset(&ball), "{} vertex {vertex}", case.id);
            assert_eq!(chosen.len(), ball.len().min(GEODESIC_CAP), "{} vertex {vertex}", case.id);
            assert_eq!(chosen.len(), golden_count, "{} vertex {vertex}", case.id);
        }
    }
}

#[test]
fn golden_bone_euclid_agrees() {
    for case in cases() {
        let ours = bone_euclid(&case.points("vertices"), &bones(&case));
        let difference = largest_difference(ours.into_iter().map(f64::from), case.f64s("bone_euclid"));
        assert!(difference < STORED, "{}: {difference}", case.id);
    }
}

/// The reference's rule, by our rays: seen if the first hit is the vertex itself, or nothing is hit at all.
#[test]
fn golden_visibility_agrees_but_for_grazing_rays() {
    for case in cases() {
        let surface = Bvh::new(&ray_mesh(&case));
        let bones = bones(&case);
        let sees = |vertex: DVec3, bone: Segment| {
            let from = nearest_on_segment(vertex, bone);
            let length = from.distance(vertex);
            let first = surface.first_hit(from, (vertex - from) / length);
            first.is_none_or(|hit| (hit.t - length).abs() < 1e-4)
        };
        let vertices = case.points("vertices");
        let all = vertices.iter().flat_map(|&vertex| bones.iter().map(move |&bone| (vertex, bone)));
        let ours: Vec<bool> = all.map(|(vertex, bone)| sees(vertex, bone)).collect();
        let golden = case.bits("bone_visible_raw", ours.len());
        let differing = ours.iter().zip(&golden).filter(|(a, b)| a != b).count();
        assert!(differing as f64 <= 1e-3 * ours.len() as f64, "{}: {differing} of {} bits differ", case.id, ours.len());

        // Ours: any hit before the vertex hides it, on the working mesh itself.
        let ours = bone_visibility(&vertices, &Bvh::new(&mesh(&case)), &bones);
        let differing = ours.iter().zip(&golden).filter(|(a, b)| a != b).count();
        assert!(differing as f64 <= 0.03 * ours.len() as f64, "{}: {differing} of {} bits differ", case.id, ours.len());
    }
}

#[test]
fn golden_bone_volumetric_agrees_given_the_visibility() {
    for case in cases() {
        let (vertices, bones) = (case.points("vertices"), bones(&case));
        let visible = case.bits("bone_visible_raw", vertices.len() * bones.len());
        let ours = distance_given_visibility(&vertices, &geodesic(&case), &bones, &visible);
        let golden = case.f32s("bone_volumetric");
        let close = ours.iter().zip(&golden).filter(|(a, b)| (*a - *b).abs() < 1e-4).count();
        assert!(close as f64 >= 0.999 * ours.len() as f64, "{}: {close} of {} agree", case.id, ours.len());
    }
}

/// Rays on the working mesh see a little more than rays on the original one, and the limit of reach moves with it.
#[test]
fn golden_bone_volumetric_is_near_from_end_to_end() {
    for case in cases() {
        let surface = Bvh::new(&mesh(&case));
        let ours = volumetric_geodesic_distance(&case.points("vertices"), &geodesic(&case), &surface, &bones(&case));
        let golden = case.f32s("bone_volumetric");
        let difference =
            ours.iter().zip(&golden).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / ours.len() as f64;
        println!("{}: mean difference {difference:.5}", case.id);
        assert!(difference < 0.01, "{}: mean difference {difference:.4}", case.id);
    }
}

/// Distances to the five nearest bones; vertices between two bones may swap them.
#[test]
fn golden_nearest_bones_are_as_near() {
    for case in cases() {
        let bone_count = case.shape("bones")[0];
        let (vertices, bones) = (case.points("vertices"), bones(&case));
        let visible = case.bits("bone_visible_raw", vertices.len() * bones.len());
        let ours = distance_given_visibility(&vertices, &geodesic(&case), &bones, &visible);
        let nearest = case.ints("skin_nearest");
        let golden = case.f64s("bone_volumetric");
        let width = case.shape("skin_nearest")[1];
        let mut close = 0;
        for (vertex, row) in ours.chunks_exact(bone_count).enumerate() {
            let mut row: Vec<f64> = row.iter().map(|&d| f64::from(d)).collect();
            row.sort_by(f64::total_cmp);
            let theirs = nearest[vertex * width..(vertex + 1) * width].iter();
            let theirs = theirs.map(|&bone| golden[vertex * bone_count + bone as usize]);
            close += usize::from(largest_difference(row, theirs) < 1e-4);
        }
        let vertex_count = case.shape("vertices")[0];
        assert!(close as f64 >= 0.995 * vertex_count as f64, "{}: {close} of {vertex_count} rows agree", case.id);
    }
}

#[test]
fn golden_inside_flags_agree_when_rounded_as_the_reference_does() {
    for case in cases() {
        let grid = voxels(&case);
        let flags = case.ints("inside_flags");
        for (point, &flag) in case.points("inside_points").into_iter().zip(&flags) {
            assert_eq!(grid.contains(as_the_reference_rounds(point, &grid)), flag == 1, "{} {point}", case.id);
        }
    }
}

/// Lengths agree; inside shares agree on the reference's voxels once the points are rounded as it rounds.
#[test]
fn golden_pair_attributes_agree() {
    for case in cases() {
        let grid = voxels(&case);
        let rounding = VoxelGrid { origin: grid.origin - DVec3::splat(0.5 * grid.side / RESOLUTION as f64), ..grid };
        let joints = case.points("joints");
        let pairs = case.ints("pairs");
        for (pair, golden) in pairs.chunks_exact(2).zip(case.f64s("pair_attr").chunks_exact(2)) {
            let ours = BonePair::new(joints[pair[0] as usize], joints[pair[1] as usize], &rounding);
            assert!((ours.length - golden[0]).abs() < STORED, "{} {pair:?}", case.id);
            assert!(
                (ours.inside_share() - golden[1]).abs() < STORED,
                "{} {pair:?}: {} {golden:?}",
                case.id,
                ours.inside_share()
            );
        }
    }
}

#[test]
fn golden_voxels_overlap_with_ours() {
    for case in cases() {
        let (ours, golden) = (VoxelGrid::solid(&mesh(&case)), voxels(&case));
        assert!(
            ours.origin.distance(golden.origin) < STORED && (ours.side - golden.side).abs() < STORED,
            "{}",
            case.id
        );
        let both = ours.inside.iter().zip(&golden.inside).filter(|(a, b)| **a && **b).count();
        let either = ours.inside.iter().zip(&golden.inside).filter(|(a, b)| **a || **b).count();
        let overlap = both as f64 / either as f64;
        assert!(overlap > 0.95, "{}: intersection over union {overlap:.3}", case.id);
    }
}
