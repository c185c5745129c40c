//! One binary for all cross-crate tests: linking zenoh once is slow enough.

mod layout;
mod optics;
mod services;
mod team;
