//! The stages of a job, in the order that every job walks through them.

/// Where the work is. A method may leave stages out, and may come back to one (progress stays where it was).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Bytes to meshes.
    Ingest,
    /// Can this be rigged at all.
    Check,
    /// Weld, simplify, move into the normalised frame.
    Normalize,
    /// Facts about the shape: neighbours, voxels, distances.
    Geometry,
    /// Where the joints are.
    Joints,
    /// Which joints make a bone.
    Connect,
    /// Weights of the working mesh.
    Skin,
    /// Weights back to the uploaded vertices.
    Transfer,
    /// Rig to files.
    Export,
    /// What was written is read back and checked.
    Validate,
}

impl From<crate::pipelines::Stage> for Stage {
    fn from(stage: crate::pipelines::Stage) -> Self {
        use crate::pipelines::Stage as Of;
        match stage {
            Of::Normalize => Self::Normalize,
            Of::Geometry => Self::Geometry,
            Of::Joints => Self::Joints,
            Of::Connect => Self::Connect,
            Of::Skin => Self::Skin,
            Of::Transfer => Self::Transfer,
        }
    }
}

impl Stage {
    pub const ALL: [Stage; 10] = [
        Stage::Ingest,
        Stage::Check,
        Stage::Normalize,
        Stage::Geometry,
        Stage::Joints,
        Stage::Connect,
        Stage::Skin,
        Stage::Transfer,
        Stage::Export,
        Stage::Validate,
    ];

    /// The word in job status, tracing spans and timings.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Ingest => "ingest",
            Stage::Check => "check",
            Stage::Normalize => "normalize",
            Stage::Geometry => "geometry",
            Stage::Joints => "joints",
            Stage::Connect => "connect",
            Stage::Skin => "skin",
            Stage::Transfer => "transfer",
            Stage::Export => "export",
            Stage::Validate => "validate",
        }
    }

    /// The stage that is called `name`.
    pub fn named(name: &str) -> Option<Self> {
        Stage::ALL.into_iter().find(|stage| stage.name() == name)
    }

    /// The share of a job's time that this stage usually takes, in percent. The shares sum to 100.
    fn share(self) -> u8 {
        match self {
            Stage::Ingest => 3,
            Stage::Check => 2,
            Stage::Normalize => 10,
            Stage::Geometry => 20,
            Stage::Joints => 22,
            Stage::Connect => 13,
            Stage::Skin => 20,
            Stage::Transfer => 4,
            Stage::Export => 3,
            Stage::Validate => 3,
        }
    }

    /// Progress of the whole job on entering this stage, 0 to 97. 100 is kept for success.
    pub fn progress(self) -> u8 {
        Stage::ALL.iter().take_while(|stage| **stage < self).map(|stage| stage.share()).sum()
    }
}
