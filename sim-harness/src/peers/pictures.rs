//! Faults to look at: the panorama about each, enlarged. White ticks above it stand over true robots, below it under sightings.

use std::f64::consts::TAU;
use std::path::Path;

use image::imageops::{self, FilterType};
use image::{GrayImage, ImageFormat, Luma};

use super::trial::{Eyes, panorama};
use super::{Outcome, PeersError, Plan, Report};

/// Most pictures that are written.
pub const MOST: usize = 200;
/// Shown on either side of a fault.
const BESIDE_RAD: f64 = 0.35;
const ENLARGED: u32 = 4;
const TICK_PX: u32 = 12;

/// Renders the faults of a report again and writes at most [`MOST`] of them as `seed-picture-bearing.png`.
pub fn write(plan: &Plan, outcomes: &[Outcome], report: &Report, folder: &Path) -> Result<(), PeersError> {
    let eyes = Eyes::of(&plan.camera)?;
    let mut rendered: Option<((u64, usize), GrayImage)> = None;
    for fault in report.faults.iter().take(MOST) {
        let at = (fault.seed, fault.picture);
        if rendered.as_ref().is_none_or(|(of, _)| *of != at) {
            rendered = panorama(&eyes, plan, fault.seed, fault.picture).map(|picture| (at, picture));
        }
        let Some((_, picture)) = &rendered else { continue };
        let Some(outcome) = outcomes.iter().find(|o| o.seed == fault.seed) else { continue };
        let (views, sightings) = (&outcome.views[fault.picture], &outcome.sightings[fault.picture]);
        let ticks = [
            views.iter().map(|view| view.bearing_rad).collect::<Vec<_>>(),
            sightings.iter().map(|sighting| sighting.peer.bearing_rad).collect(),
        ];
        let path = folder.join(format!("{}-{}-{:+.0}.png", fault.seed, fault.picture, fault.bearing_deg));
        about(&eyes, picture, fault.bearing_deg.to_radians(), &ticks)
            .save_with_format(&path, ImageFormat::Png)
            .map_err(|e| PeersError(format!("{}: {e}", path.display())))?;
    }
    Ok(())
}

/// The part of a panorama about a bearing.
fn about(eyes: &Eyes, panorama: &GrayImage, bearing_rad: f64, ticks: &[Vec<f64>; 2]) -> GrayImage {
    let (width, height) = panorama.dimensions();
    let column = |bearing: f64| (eyes.grid.seam_rad - bearing) / TAU * f64::from(width) - 0.5;
    let reach = (BESIDE_RAD / TAU * f64::from(width)) as u32;
    let first = column(bearing_rad).round() as i64 - i64::from(reach);
    let part = GrayImage::from_fn(2 * reach + 1, height, |u, v| {
        *panorama.get_pixel((first + i64::from(u)).rem_euclid(i64::from(width)) as u32, v)
    });
    let large = imageops::resize(&part, part.width() * ENLARGED, height * ENLARGED, FilterType::Nearest);
    let mut out = GrayImage::new(large.width(), large.height() + 2 * TICK_PX);
    imageops::replace(&mut out, &large, 0, i64::from(TICK_PX));
    for (bearings, top) in ticks.iter().zip([0, TICK_PX + large.height()]) {
        for bearing in bearings {
            let beside = (column(*bearing) - first as f64).rem_euclid(f64::from(width));
            let first = ((beside + 0.5) * f64::from(ENLARGED)) as u32;
            for u in first..(first + 2).min(out.width()) {
                (top..top + TICK_PX).for_each(|v| out.put_pixel(u, v, Luma([255])));
            }
        }
    }
    out
}
