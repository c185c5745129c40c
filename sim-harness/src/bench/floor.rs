//! What a stage must at least take: bytes over the speed of a plain copy, measured here and now.

use std::hint::black_box;
use std::time::Instant;

use robot_agent::motion::Raster;

use super::PerStage;

/// Floors a stage.
#[derive(Debug, Clone, Copy)]
pub struct Floors {
    /// µs a frame.
    pub stages: PerStage,
}

/// Bytes of the unwarping table a panorama pixel.
const TABLE_BYTES: usize = 4;

impl Floors {
    /// For a camera picture and a panorama of these sizes.
    pub fn measure([width, height]: [u32; 2], raster: Raster) -> Self {
        let n = raster.len();
        // Of the source the ring alone is read: about half of the picture.
        let ring = width as usize * height as usize / 2;
        let unwarp = ring + n * (TABLE_BYTES + 1);
        // Picture, frame before, background and noise (two bytes each) are read, magnitudes and two bits of marks written.
        let change = n * (1 + 1 + 2 + 2 + 1) + n / 4;
        // Faint marks are read and written, then read; a mask is written and read. A bit each.
        let extract = n * 5 / 8;
        // Background and noise read and written, picture and permission read.
        let learn = n * (4 + 4 + 1 + 1);
        let us = |bytes: usize| bytes as f64 / copy_speed(bytes) * 1e6;
        Self {
            stages: PerStage {
                unwarp: us(unwarp),
                change: us(change),
                extract: us(extract),
                track: 0.0,
                learn: us(learn),
                record: 0.0,
            },
        }
    }
}

/// Bytes read and written a second by a copy that touches `bytes` in all; the best of twenty.
fn copy_speed(bytes: usize) -> f64 {
    let from = vec![1u8; bytes.div_ceil(2)];
    let mut to = vec![0u8; from.len()];
    let best = (0..20)
        .map(|_| {
            let start = Instant::now();
            to.copy_from_slice(black_box(&from));
            black_box(&mut to);
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    (2 * from.len()) as f64 / best.max(1e-9)
}
