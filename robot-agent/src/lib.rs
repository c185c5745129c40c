#![doc = include_str!("../README.md")]

pub mod agent;
pub mod calibration;
pub mod capture;
pub mod config;
pub mod motion;
pub mod optics;
pub mod panorama;
pub mod peers;
pub mod picture;
pub mod service;
pub mod structure;
pub mod tracking;
