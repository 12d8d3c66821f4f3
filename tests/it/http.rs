//! The HTTP service, without networks: a scripted rigger stands in for the work.

#[path = "http/artifacts.rs"]
mod artifacts;
#[path = "http/callers.rs"]
mod callers;
#[path = "http/jobs.rs"]
mod jobs;
#[path = "http/refusals.rs"]
mod refusals;
#[path = "http/scripted.rs"]
mod scripted;
#[path = "http/service.rs"]
mod service;
#[path = "http/socket.rs"]
mod socket;
