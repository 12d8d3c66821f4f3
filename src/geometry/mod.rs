//! Facts about a shape: neighbourhoods, distances, voxels, symmetry. Pure functions of meshes; no I/O.
