//! REST and gRPC are two doors to one service: one table of cases, through both, with the same answers.

#[path = "doors/asks.rs"]
mod asks;
#[path = "doors/cases.rs"]
mod cases;
#[path = "doors/grpc.rs"]
pub mod grpc;
#[path = "doors/rest.rs"]
mod rest;
#[path = "doors/streams.rs"]
mod streams;
