//! The HTTP service, without networks: a scripted rigger stands in for the work.

#[path = "http/artifacts.rs"]
mod artifacts;
#[path = "http/assets.rs"]
mod assets;
#[path = "http/batches.rs"]
mod batches;
#[path = "http/callers.rs"]
mod callers;
#[path = "http/events.rs"]
mod events;
#[path = "http/examples.rs"]
mod examples;
#[path = "http/fetching.rs"]
mod fetching;
#[path = "http/jobs.rs"]
mod jobs;
#[path = "http/receiver.rs"]
pub mod receiver;
#[path = "http/refusals.rs"]
mod refusals;
#[path = "http/scripted.rs"]
pub mod scripted;
#[path = "http/service.rs"]
mod service;
#[path = "http/socket.rs"]
pub mod socket;
#[path = "http/tus.rs"]
mod tus;
#[path = "http/webhooks.rs"]
mod webhooks;
