//! Edges of bars along a meridian of the picture, as radii.
//!
//! The derivative of the gray value outwards is averaged over a few parallel lines beside the meridian; each extremum that
//! stands out, alternating between dark to bright and bright to dark, is an edge, placed at the slope's centre of gravity.
//!
//! Source: report 4.2.

use nalgebra::Vector2;

use super::gradient::Gradients;
use crate::capture::GrayPicture;

/// Samples along the meridian, px apart.
const STEP_PX: f64 = 0.25;
/// Samples on either side of a peak that belong to its edge.
const HALF_PEAK: usize = 8;
/// Half width of the strip that is averaged, px.
const STRIP_PX: i32 = 3;
/// Weaker edges than this share of the strong ones are texture.
const RELATIVE_STRENGTH: f64 = 0.3;
/// Gray levels per px below which there is no edge.
const MIN_STRENGTH: f64 = 3.0;

/// Why no edges were found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BarsError {
    /// Radii that cannot be.
    #[error("radii [{from_px}, {to_px}] px: must be from a smaller to a larger one, both positive and on the picture")]
    Radii {
        /// Inner, px.
        from_px: f64,
        /// Outer, px.
        to_px: f64,
    },
    /// Too few.
    #[error("{found} edges between the radii: are the bars there, and is the angle the meridian's?")]
    TooFew {
        /// How many.
        found: usize,
    },
}

/// Radii (px, outwards) of the edges along the direction `angle_rad` (from u towards v) between two radii.
///
/// # Errors
/// The radii are not on the picture, or fewer than three edges lie between them.
pub fn edges(
    picture: &GrayPicture,
    centre_px: Vector2<f64>,
    angle_rad: f64,
    [from_px, to_px]: [f64; 2],
) -> Result<Vec<f64>, BarsError> {
    let gradients = Gradients::new(picture);
    // Beside the meridian along the circle: a straight strip would smear and shift the edges.
    let slope = |radius: f64| -> Option<f64> {
        let samples = (-STRIP_PX..=STRIP_PX).map(|k| {
            let angle = angle_rad + f64::from(k) / radius;
            let out = Vector2::new(angle.cos(), angle.sin());
            gradients.between(&(centre_px + out * radius)).map(|g| g.map(f64::from).dot(&out))
        });
        samples.sum::<Option<f64>>().map(|sum| sum / f64::from(2 * STRIP_PX + 1))
    };
    let wrong = BarsError::Radii { from_px, to_px };
    if !(from_px > 0.0 && to_px > from_px + 4.0 && to_px < 1e5) {
        return Err(wrong);
    }
    let count = ((to_px - from_px) / STEP_PX) as usize;
    let radius = |i: usize| from_px + STEP_PX * i as f64;
    let profile: Vec<f64> = (0..=count).map(|i| slope(radius(i))).collect::<Option<_>>().ok_or(wrong)?;
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    for i in 1..count {
        let (before, here, after) = (profile[i - 1], profile[i], profile[i + 1]);
        let is_peak = here.abs() >= before.abs() && here.abs() > after.abs() && here.abs() > MIN_STRENGTH;
        if is_peak {
            // The centre of gravity of the slope: interpolation between pixels does not shift it, as it does the peak.
            let near = i.saturating_sub(HALF_PEAK)..=(i + HALF_PEAK).min(count);
            let same = near.filter(|k| profile[*k].signum() == here.signum());
            let (sum, moment) = same.fold((0.0, 0.0), |(s, m), k| (s + profile[k], m + profile[k] * radius(k)));
            peaks.push((moment / sum, here));
        }
    }
    let mut strengths: Vec<f64> = peaks.iter().map(|p| p.1.abs()).collect();
    strengths.sort_by(f64::total_cmp);
    let strong = strengths.get(strengths.len() * 3 / 4).copied().unwrap_or(0.0);
    peaks.retain(|p| p.1.abs() > RELATIVE_STRENGTH * strong);
    // Of neighbours of one sign the stronger is the edge.
    let mut edges: Vec<(f64, f64)> = Vec::new();
    for peak in peaks {
        match edges.last_mut() {
            Some(last) if last.1.signum() == peak.1.signum() => {
                if peak.1.abs() > last.1.abs() {
                    *last = peak;
                }
            }
            _ => edges.push(peak),
        }
    }
    if edges.len() < 3 {
        return Err(BarsError::TooFew { found: edges.len() });
    }
    Ok(edges.into_iter().map(|e| e.0).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rings about (160.2, 119.6) that change at these radii, drawn with 8×8 samples a pixel.
    fn picture(changes: &[f64]) -> GrayPicture {
        let (width, height) = (320u32, 240u32);
        let gray = (0..height)
            .flat_map(|v| (0..width).map(move |u| (u, v)))
            .map(|(u, v)| {
                let bright = (0..64).filter(|k| {
                    let x = f64::from(u) + (f64::from(k % 8) - 3.5) / 8.0 - 160.2;
                    let y = f64::from(v) + (f64::from(k / 8) - 3.5) / 8.0 - 119.6;
                    let radius = x.hypot(y);
                    changes.iter().filter(|c| **c < radius).count() % 2 == 1
                });
                (40.0 + 150.0 * bright.count() as f64 / 64.0).round() as u8
            })
            .collect();
        GrayPicture { width, height, gray }
    }

    #[test]
    fn edges_of_rings_are_found_to_a_tenth_of_a_pixel_in_every_direction() {
        let radii = [40.3, 47.1, 54.4, 62.0, 70.2, 79.1, 88.5];
        let picture = picture(&radii);
        for angle in [0.0, 0.7, 2.4, -1.2] {
            let found = edges(&picture, Vector2::new(160.2, 119.6), angle, [30.0, 100.0]).unwrap();
            assert_eq!(found.len(), radii.len(), "{found:?}");
            for (a, b) in found.iter().zip(radii) {
                assert!((a - b).abs() < 0.1, "{a} {b}");
            }
        }
    }

    #[test]
    fn an_empty_wall_and_radii_off_the_picture_are_errors() {
        let wall = GrayPicture { width: 320, height: 240, gray: vec![120; 320 * 240] };
        let middle = Vector2::new(160.0, 120.0);
        assert_eq!(edges(&wall, middle, 0.0, [30.0, 100.0]), Err(BarsError::TooFew { found: 0 }));
        assert!(matches!(edges(&wall, middle, 0.0, [30.0, 900.0]), Err(BarsError::Radii { .. })));
    }
}
