#![doc = include_str!("../README.md")]

pub mod calibration;
pub mod cli;
pub mod clock_offset;
pub mod config;
pub mod correspondence;
pub mod doctor;
#[cfg(test)]
mod golden;
pub mod leader;
pub mod picture;
pub mod planning;
pub mod provision;
pub mod service;
pub mod solve;
pub mod stereo;
pub mod structure;
pub mod team_map;
pub mod timeline;
