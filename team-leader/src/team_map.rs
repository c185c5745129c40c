//! The map as a message and as JSON.

pub mod build;
pub mod json;
