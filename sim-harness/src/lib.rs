#![doc = include_str!("../README.md")]

mod adam;
pub mod bandwidth;
pub mod baseline;
pub mod bench;
pub mod chaos;
pub mod cli;
pub mod efficiency;
pub mod guidance;
pub mod motion;
pub mod network;
mod parallel;
pub mod peers;
pub mod recorded;
pub mod render;
pub mod replay;
pub mod scale;
pub mod scenario;
pub mod score;
pub mod shadows;
pub mod team;
pub mod world;
pub mod zoo;
