//! How people walk: each has a list of things to do (cross behind a robot, stop, meet somebody, stroll), follows the way
//! there, keeps out of the way of others, and walks smoothly. Worked out once in small steps, kept as samples.

mod crowd;
mod given;
mod steer;

use rand_chacha::ChaCha12Rng;

use super::floor::Grid;
use super::person::Gait;
use super::robot::Robot;
use crate::scenario::PeopleSpec;
use crowd::Crowd;

/// Time step of the samples.
const STEP_S: f64 = 0.02;
/// Walking begins before the pictures.
const WARM_UP_S: f64 = 4.0;
/// Legs swing this far at 1 m/s.
const SWING_RAD: f64 = 0.40;
/// All walks of a run.
#[derive(Debug, Clone)]
pub struct Walks {
    samples: Vec<Vec<Gait>>,
}

impl Walks {
    /// How person `n` stands or walks at a true time; the ends are held.
    pub fn at(&self, n: usize, time_s: f64) -> Gait {
        let track = &self.samples[n];
        let place = ((time_s + WARM_UP_S) / STEP_S).clamp(0.0, (track.len() - 1) as f64);
        let (i, f) = (place as usize, place.fract());
        let (a, b) = (track[i], track[(i + 1).min(track.len() - 1)]);
        let mix = |a: f64, b: f64| a + (b - a) * f;
        Gait {
            x_m: mix(a.x_m, b.x_m),
            y_m: mix(a.y_m, b.y_m),
            heading_rad: mix(a.heading_rad, b.heading_rad),
            phase_rad: mix(a.phase_rad, b.phase_rad),
            swing_rad: mix(a.swing_rad, b.swing_rad),
        }
    }

    /// Metres a second at a true time.
    pub fn speed(&self, n: usize, time_s: f64) -> f64 {
        let (a, b) = (self.at(n, time_s - STEP_S), self.at(n, time_s + STEP_S));
        (b.x_m - a.x_m).hypot(b.y_m - a.y_m) / (2.0 * STEP_S)
    }
}

impl Walks {
    /// Whether person `n` stands still for `span_s` on end within the first `duration_s`.
    pub(super) fn stops_for(&self, n: usize, span_s: f64, duration_s: f64) -> bool {
        const LOOK_S: f64 = 0.25;
        let mut still_s = 0.0;
        (0..(duration_s / LOOK_S) as usize).any(|i| {
            still_s = if self.speed(n, i as f64 * LOOK_S) < 0.1 { still_s + LOOK_S } else { 0.0 };
            still_s >= span_s
        })
    }
}

/// Works out everybody's walk.
pub(super) fn walk(
    spec: &PeopleSpec,
    heights_m: &[f64],
    robots: &[Robot],
    grid: &Grid,
    duration_s: f64,
    rng: &mut ChaCha12Rng,
) -> Option<Walks> {
    if !spec.ways.is_empty() {
        let steps = ((WARM_UP_S + duration_s + 1.0) / STEP_S) as usize;
        let samples = spec.ways.iter().zip(heights_m).map(|(way, height)| given::walk(way, *height, steps)).collect();
        return Some(Walks { samples });
    }
    let mut crowd = Crowd::new(spec, heights_m, robots, grid, duration_s, rng)?;
    let steps = ((WARM_UP_S + duration_s + 1.0) / STEP_S) as usize;
    let mut samples = vec![Vec::with_capacity(steps); heights_m.len()];
    for step in 0..steps {
        crowd.step(step as f64 * STEP_S - WARM_UP_S, rng);
        for (track, (w, height)) in samples.iter_mut().zip(crowd.walkers.iter().zip(heights_m)) {
            let swing = swing_rad(w.velocity.norm(), *height);
            track.push(Gait {
                x_m: w.position.x,
                y_m: w.position.y,
                heading_rad: w.heading,
                phase_rad: w.phase,
                swing_rad: swing,
            });
        }
    }
    Some(Walks { samples })
}

/// How far the legs of somebody of a height swing at a speed, radians.
fn swing_rad(speed_mps: f64, height_m: f64) -> f64 {
    SWING_RAD * (speed_mps / (height_m / 1.75)).min(1.3)
}
