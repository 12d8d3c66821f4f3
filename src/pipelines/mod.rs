//! The published methods, one file each, composed from mesh, geometry, nets and rig.
