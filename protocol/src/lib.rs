#![doc = include_str!("../README.md")]

pub mod angle;
pub mod appearance;
#[cfg(feature = "zenoh")]
pub mod board;
pub mod closed_pipe;
pub mod codec;
pub mod document;
pub mod estimate;
pub mod fence;
pub mod folder;
pub mod frames;
#[cfg(feature = "zenoh")]
pub mod host_clock;
pub mod id;
pub mod key;
pub mod latency;
pub mod marker;
pub mod message;
pub mod meter;
pub mod quantity;
pub mod security;
pub mod time;
#[cfg(feature = "zenoh")]
pub mod transport;
pub mod whole_file;

#[doc = include_str!("../ERRATA.md")]
pub mod errata {}
