//! Facts about a shape: neighbourhoods, distances, voxels, symmetry. Pure functions of meshes; no I/O.
//!
//! Everything here works in the normalised frame of [`crate::mesh::normalize`] unless it says otherwise; the same input
//! gives the same output for any number of threads.

pub mod bone_pairs;
pub mod box_parts;
pub mod bvh;
pub mod close_pairs;
pub mod hollow_distance;
mod hollow_field;
mod hollow_search;
mod hollow_ways;
pub mod medial_offset;
pub mod mirror_images;
pub mod neighbor_table;
pub mod orientation;
pub mod place_hash;
pub mod point_tree;
pub mod self_intersection;
mod solid_cells;
pub mod stance;
pub mod surface_branches;
pub mod surface_geodesic;
pub mod surface_samples;
mod surface_voxels;
pub mod symmetry_plane;
pub mod transfer;
pub mod triangle;
pub mod volumetric_geodesic;
pub mod voxel_binding;
pub mod voxel_grid;
