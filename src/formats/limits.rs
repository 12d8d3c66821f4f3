//! How much one upload may cost, as an explicit value. Decoders compare what a file *declares* with these numbers and
//! with the bytes that are there before they allocate anything for it.

/// Limits of one upload. [`Limits::default`] holds the service's published defaults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The upload and all siblings that it pulls in, and an archive's content unpacked.
    pub bytes_max: u64,
    pub vertices_max: usize,
    /// Triangles, after polygons are cut into triangles.
    pub faces_max: usize,
    /// Up to here nothing is said; above, a finding tells that the work takes longer.
    pub faces_without_a_word: usize,
    /// Nodes of a scene graph; objects and groups of an OBJ.
    pub nodes_max: usize,
    /// Depth of anything nested: scene graph, JSON, FBX elements.
    pub depth_max: usize,
    /// Materials, textures and images, each.
    pub materials_max: usize,
    /// Unpacked bytes per packed byte of an archive.
    pub unzip_ratio_max: u64,
    pub archive_entries_max: usize,
    /// What the FBX reader may allocate, for its working memory and for its result each: FBX packs its arrays.
    pub fbx_memory_bytes_max: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            bytes_max: 100 << 20,
            vertices_max: 1_000_000,
            faces_max: 2_000_000,
            faces_without_a_word: 300_000,
            nodes_max: 4_096,
            depth_max: 64,
            materials_max: 4_096,
            unzip_ratio_max: 100,
            archive_entries_max: 4_096,
            fbx_memory_bytes_max: 512 << 20,
        }
    }
}
