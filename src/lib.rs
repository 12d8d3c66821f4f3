//! Rigs characters: a mesh in, a skeleton and skin weights out. The modules, in the order a mesh meets them:
//!
//! 1. [`formats`]   bytes -> [`formats::Asset`]                  (untrusted input stops here)
//! 2. [`mesh`]      weld, normalize, working mesh                `[V, 3]`, `[F, 3]`
//! 3. [`geometry`]  one-ring, geodesic balls, voxels, distances  facts about the shape
//! 4. [`nets`]      ONNX graphs as typed functions               the only place that knows `ort`
//! 5. [`rig`]       joints -> tree -> bones -> skin weights      takes turns with `nets`
//! 6. [`formats`]   [`rig::Rig`] -> glTF, JSON
//!
//! [`pipelines`] composes 2-5, one file per published method. [`jobs`], [`storage`] and [`server`] carry
//! requests to it and results back; they know nothing of geometry. [`cancellation`] is the one word that all
//! of them share.

pub mod cancellation;
pub mod config;
pub mod formats;
pub mod geometry;
pub mod jobs;
pub mod mesh;
pub mod nets;
pub mod outgoing;
pub mod pipelines;
pub mod rig;
pub mod server;
pub mod storage;
pub mod telemetry;
