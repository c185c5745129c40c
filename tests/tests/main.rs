//! One binary for all cross-crate tests: linking zenoh once is slow enough.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod failover;
mod hostile;
mod layout;
mod mounting;
mod optics;
mod security;
mod services;
mod team;
