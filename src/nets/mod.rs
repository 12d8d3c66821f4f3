//! Trained networks as typed functions. The only place that names `ort`.
//!
//! | file          | network                                              | in → out                                  |
//! |---------------|------------------------------------------------------|-------------------------------------------|
//! | [`rignet`]    | RigNet [Xu et al. 2020]: five graphs                 | shape graph (+ joints, bones) → numbers   |
//! | [`heter_skin_net`] | HeterSkinNet [Pan et al. 2021]                  | shape graph, skeleton and links → numbers |
//! | `manifest`    | what stands in the models folder, and its digests    |                                           |
//! | `self_test`   | known answers, checked before a method is offered    |                                           |
//! | [`network`]   | one graph as a pool of sessions                      |                                           |
//! | [`runtime`]   | ONNX Runtime, one thread pool for the whole process  |                                           |

mod error;
pub mod heter_skin_net;
pub mod locate;
mod manifest;
mod models;
pub mod network;
pub mod rignet;
pub mod runtime;
mod self_test;

pub use error::NetError;
pub use manifest::Licence;
pub use models::{LoadOptions, ModelStatus, Models};
