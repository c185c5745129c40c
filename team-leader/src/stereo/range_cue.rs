//! What one robot alone knows about how far an object is: from its feet, its head, its width.
//!
//! Heights and widths of people vary, feet are cut off near the camera and shadows lengthen them, so a cue only helps to
//! decide which tracks of two robots are one object (ghosts of crossing rays have wrong ranges). It never enters an
//! estimate of position that two robots measure, but for feet that a camera sees from high above: there an error of an elevation is
//! a small one of the range (D/tan of it), furniture hides little, and the range is a measurement like a bearing. Where both ends are cut, the bounds remain: with the camera at 0.6 m a
//! foot below −15° means nearer than 2.2 m. (`MATHS.md` §7.11.)

use protocol::message::{ElevationEnd, TrackObservation, TrackState};

use super::triangulate::weighted_mean;

/// Shoulder width of people, metres, and its spread as a fraction (arms, side view).
const WIDTH_M: f64 = 0.48;
const WIDTH_SPREAD: f64 = 0.35;
/// Least relative error of a range from the feet or the head: gait, shadows, hair.
const LEAST_SPREAD: f64 = 0.08;
/// Elevations nearer to the horizon say nothing about range, radians.
const LEAST_ELEVATION_RAD: f64 = 0.02;
/// Spread of a range from ground contact: shadows reach nearer than feet, furniture hides them.
const FOOT_SPREAD: f64 = 0.15;
/// Feet this far below the horizon are seen from high above, rad.
const STEEP_RAD: f64 = 0.35;
/// The lower edge of what is seen of somebody is the near end of a foot: nearer than the body's axis by half a foot, m; a stride
/// makes it more or less (standard deviation).
const HALF_FOOT_M: (f64, f64) = (0.13, 0.08);
/// Tallest that is expected, in sigmas of the height.
const TALL_SIGMAS: f64 = 2.0;
/// A cue never costs more: it may be wrong altogether (half a body, two people).
pub const MOST_COST: f64 = 9.0;

/// The camera that saw the track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraFacts {
    /// Above the floor, m.
    pub height_m: f64,
    /// Unknown tilt, rad.
    pub tilt_sigma_rad: f64,
}

/// Logarithm of the range with its spread, and an upper bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeCue {
    /// ln(range/m) and its standard deviation, where known.
    pub log_range: Option<(f64, f64)>,
    /// The same by all but the height of people: where the height of this one is measured.
    pub beside_top: Option<(f64, f64)>,
    /// The object is nearer than this, m.
    pub upper_m: f64,
    /// Range of the body's axis by feet seen from high above, with its standard deviation, m.
    pub foot_m: Option<(f64, f64)>,
    /// Its top is seen, and lower than anybody's: a shadow, a chair, a robot.
    pub low: bool,
}

impl RangeCue {
    /// Nothing is known.
    pub const NONE: Self = Self { log_range: None, beside_top: None, upper_m: f64::INFINITY, foot_m: None, low: false };

    /// From one observation of a track; `person_height_m` is mean and standard deviation.
    pub fn of(track: &TrackObservation, camera: CameraFacts, person_height_m: (f64, f64)) -> Self {
        if track.state != TrackState::Visible {
            return Self::NONE;
        }
        let [low, high] = track.elevation.map(|e| e.rad());
        let sigma = track.elevation_sigma.value().hypot(camera.tilt_sigma_rad).hypot(0.004);
        let (mean_m, spread_m) = person_height_m;
        let mut cues: Vec<(f64, f64)> = Vec::new();
        let mut by_top = None;
        let mut upper_m = f64::INFINITY;
        let mut steep_m = None;
        if let Some(range) = track.range {
            let m = range.range.m().max(0.1);
            cues.push((m.ln(), (range.sigma.value() / m).max(FOOT_SPREAD)));
        }
        if low < -LEAST_ELEVATION_RAD {
            let foot_m = camera.height_m / (-low).tan();
            if track.ends[0] == ElevationEnd::Seen && low < -STEEP_RAD {
                let by_angle = (foot_m.powi(2) + camera.height_m.powi(2)) / camera.height_m * sigma;
                let spread = by_angle.hypot(HALF_FOOT_M.1);
                steep_m = Some((foot_m + HALF_FOOT_M.0, spread));
            }
            match track.ends[0] {
                ElevationEnd::Seen if track.range.is_none() => {
                    let error = (foot_m.powi(2) + camera.height_m.powi(2)) / (camera.height_m * foot_m) * sigma;
                    cues.push((foot_m.ln(), error.hypot(FOOT_SPREAD)));
                }
                ElevationEnd::Seen => {}
                ElevationEnd::Cut | ElevationEnd::Hidden => upper_m = upper_m.min(foot_m),
            }
        }
        if high > LEAST_ELEVATION_RAD && mean_m > camera.height_m {
            let above_m = mean_m - camera.height_m;
            match track.ends[1] {
                ElevationEnd::Seen => {
                    let error = (spread_m / above_m).hypot(2.0 * sigma / (2.0 * high).sin());
                    by_top = Some(((above_m / high.tan()).ln(), error.hypot(LEAST_SPREAD)));
                }
                ElevationEnd::Cut | ElevationEnd::Hidden => {
                    upper_m = upper_m.min((above_m + TALL_SIGMAS * spread_m) / high.tan());
                }
            }
        }
        let width = track.width.rad().abs();
        if width > 0.01 {
            cues.push(((WIDTH_M / width).ln(), WIDTH_SPREAD));
        }
        let beside_top = weighted_mean(cues.iter().copied());
        cues.extend(by_top);
        let log_range = weighted_mean(cues);
        let low = track.ends[1] == ElevationEnd::Seen && high < 2.0 * sigma && camera.height_m < 1.2;
        Self { log_range, beside_top, upper_m, foot_m: steep_m, low }
    }

    /// How badly a range fits: squared sigmas, at most [`MOST_COST`].
    pub fn cost(&self, range_m: f64) -> f64 {
        if self.low {
            return MOST_COST;
        }
        let r = range_m.max(0.05).ln();
        let by_mean = self.log_range.map_or(0.0, |(m, s)| ((r - m) / s).powi(2));
        let over = (r - self.upper_m.ln()).max(0.0) / LEAST_SPREAD;
        (by_mean + over * over).min(MOST_COST)
    }
}

#[cfg(test)]
mod tests {
    use protocol::id::TrackId;
    use protocol::message::ObjectClass;
    use protocol::quantity::{Angle16, Fraction8, LogSigma};

    use super::*;

    fn person(range_m: f64, height_m: f64) -> TrackObservation {
        let (low, high) = ((-0.6f64 / range_m).atan(), ((height_m - 0.6) / range_m).atan());
        let (bottom, top) = ((-15f64).to_radians(), 20f64.to_radians());
        let end = |cut: bool| if cut { ElevationEnd::Cut } else { ElevationEnd::Seen };
        TrackObservation {
            track: TrackId(1),
            state: TrackState::Visible,
            bearing: Angle16::from_rad(0.0),
            bearing_sigma: LogSigma::from_value(0.006),
            elevation: [Angle16::from_rad(low.max(bottom)), Angle16::from_rad(high.min(top))],
            elevation_sigma: LogSigma::from_value(0.005),
            ends: [end(low < bottom), end(high > top)],
            width: Angle16::from_rad(0.45 / range_m),
            range: None,
            class: ObjectClass::Person,
            confidence: Fraction8::from_value(1.0),
            doubtful: false,
            appearance: None,
        }
    }

    #[test]
    fn a_cue_prefers_the_true_range_to_a_ghosts() {
        let camera = CameraFacts { height_m: 0.6, tilt_sigma_rad: 0.003 };
        for range_m in [1.2, 1.8, 2.5, 3.5, 5.0] {
            for height_m in [1.55, 1.9] {
                let cue = RangeCue::of(&person(range_m, height_m), camera, (1.72, 0.12));
                assert!(cue.cost(range_m) < 4.0, "{range_m} {height_m} {cue:?}");
                assert!(cue.cost(range_m * 2.0) > 3.0 + cue.cost(range_m), "{range_m} {height_m} {cue:?}");
            }
        }
    }

    #[test]
    fn feet_seen_from_high_above_measure_the_range_and_others_do_not() {
        let low = CameraFacts { height_m: 0.6, tilt_sigma_rad: 0.0 };
        assert_eq!(RangeCue::of(&person(2.5, 1.7), low, (1.72, 0.12)).foot_m, None);
        let high = CameraFacts { height_m: 2.2, tilt_sigma_rad: 0.0 };
        for range_m in [1.5, 3.0, 5.0] {
            let mut seen = person(range_m, 1.7);
            let near_m: f64 = range_m - 0.13;
            seen.elevation = [Angle16::from_rad((-2.2 / near_m).atan()), Angle16::from_rad((-0.5 / range_m).atan())];
            seen.ends = [ElevationEnd::Seen; 2];
            let (found_m, sigma_m) = RangeCue::of(&seen, high, (1.72, 0.12)).foot_m.unwrap();
            assert!((found_m - range_m).abs() < 0.01, "{found_m} m at {range_m} m");
            assert!((0.04..0.25).contains(&sigma_m), "{sigma_m} m at {range_m} m");
            seen.ends[0] = ElevationEnd::Hidden;
            assert_eq!(RangeCue::of(&seen, high, (1.72, 0.12)).foot_m, None);
        }
    }

    #[test]
    fn a_cut_end_bounds_and_never_measures() {
        let camera = CameraFacts { height_m: 0.6, tilt_sigma_rad: 0.0 };
        let cue = RangeCue::of(&person(1.0, 1.7), camera, (1.72, 0.12));
        assert!((cue.upper_m - 0.6 / 15f64.to_radians().tan()).abs() < 0.01);
        let (_, spread) = cue.log_range.unwrap();
        assert!(spread > 0.3, "only the width is left: {spread}");
    }
}
