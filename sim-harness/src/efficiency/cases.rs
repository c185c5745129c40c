//! The cases, fixed before the first run: nothing here may depend on what came out.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::scene::{Scene, Worn, turn};

/// Of all draws.
pub const SEED: u64 = 20_261_122;
/// A pixel on 1080 columns, radians.
pub const PIXEL: f64 = std::f64::consts::TAU / 1080.0;
/// Layouts of each number of robots.
const LAYOUTS: u64 = 20;
/// The grid of two robots.
const BASELINES_M: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
const PARALLAX_DEG: [f64; 6] = [15.0, 30.0, 60.0, 90.0, 120.0, 160.0];
const NOISES_PX: [f64; 2] = [0.1, 1.0];

/// What the measurements' errors are like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// As stated.
    Gaussian,
    /// 96 % as stated, 4 % with five times the sigma: 2.4 % beyond 3 σ, as in UTIAS MRCLAM.
    Tailed,
}

/// Share of errors from the broad Gaussian, and its width in sigmas, of [`Noise::Tailed`].
pub const TAIL: (f64, f64) = (0.04, 5.0);

impl Noise {
    /// An error in sigmas.
    pub fn draw(self, rng: &mut ChaCha8Rng) -> f64 {
        let normal: f64 = StandardNormal.sample(rng);
        match self {
            Self::Gaussian => normal,
            Self::Tailed => normal * if rng.random_range(0.0..1.0) < TAIL.0 { TAIL.1 } else { 1.0 },
        }
    }

    /// −2 ln of the density of an error of `r` sigmas over its largest, and the weight by which it counts: half the slope over r.
    pub fn loss(self, r: f64) -> (f64, f64) {
        let (share, width) = match self {
            Self::Gaussian => return (r * r, 1.0),
            Self::Tailed => TAIL,
        };
        let narrow = (1.0 - share) * (-0.5 * r * r).exp();
        let broad = share / width * (-0.5 * (r / width).powi(2)).exp();
        let most = 1.0 - share + share / width;
        // Beyond the arithmetic's range only the broad one is left.
        let broad = broad.max(f64::MIN_POSITIVE);
        (2.0 * (most / (narrow + broad)).ln(), (narrow + broad / (width * width)) / (narrow + broad))
    }
}

/// A layout, and how well it is measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its number, of which its random numbers are made.
    pub number: u64,
    /// Marker, and how plates are turned.
    pub marker: &'static str,
    /// Distance of two robots; `None`: a drawn layout.
    pub baseline_m: Option<f64>,
    /// Angle at the target between two robots, degrees.
    pub parallax_deg: Option<f64>,
    /// Standard deviation of each feature, pixels.
    pub noise_px: f64,
    /// Truth.
    pub scene: Scene,
}

impl Case {
    /// Standard deviation of each feature, radians.
    pub fn sigma_rad(&self) -> f64 {
        self.noise_px * PIXEL
    }

    /// What it is, in a line.
    pub fn name(&self) -> String {
        match (self.baseline_m, self.parallax_deg) {
            (Some(b), Some(p)) => format!("{} B {b} m, parallax {p}°, {} px", self.marker, self.noise_px),
            _ => format!("{} robots, layout {}, {} px", self.scene.robots.len(), self.number, self.noise_px),
        }
    }
}

/// All of them: two robots over the grid, then drawn layouts of three, five and ten.
pub fn cases() -> Vec<Case> {
    let mut all = two_robots();
    for robots in [3, 5, 10] {
        for layout in 0..LAYOUTS {
            let scene = drawn(robots, SEED ^ (1000 * robots as u64 + layout));
            for noise_px in NOISES_PX {
                let number = all.len() as u64;
                let (baseline_m, parallax_deg) = (None, None);
                all.push(Case { number, marker: "cylinder", baseline_m, parallax_deg, noise_px, scene: scene.clone() });
            }
        }
    }
    all
}

fn two_robots() -> Vec<Case> {
    let markers = [
        ("cylinder", Worn::Cylinder, 0.0),
        ("8 bars", Worn::Bars(8), 0.0),
        ("24 bars", Worn::Bars(24), 0.0),
        ("plate 0°", Worn::Plate, 0.0),
        ("plate 30°", Worn::Plate, 30.0),
        ("plate 60°", Worn::Plate, 60.0),
    ];
    let mut all = Vec::new();
    for (marker, worn, turned_deg) in markers {
        for baseline_m in BASELINES_M {
            for parallax_deg in PARALLAX_DEG {
                for noise_px in NOISES_PX {
                    // Plates are turned from facing each other; bars too, by half a gap and a bit, so that none is special.
                    let turned = if worn == Worn::Plate { f64::to_radians(turned_deg) } else { 0.1 };
                    let scene = pair(worn, baseline_m, f64::to_radians(parallax_deg), turned);
                    all.push(Case {
                        number: all.len() as u64,
                        marker,
                        baseline_m: Some(baseline_m),
                        parallax_deg: Some(parallax_deg),
                        noise_px,
                        scene,
                    });
                }
            }
        }
    }
    all
}

/// Two robots that look at each other but for `turned`, and a target as far from one as from the other.
fn pair(worn: Worn, baseline_m: f64, parallax: f64, turned: f64) -> Scene {
    let away = 0.5 * baseline_m / (0.5 * parallax).sin();
    // The first looks along x, so that the other stands at `−turned` to it.
    let direction = -turned;
    let (s, c) = direction.sin_cos();
    let to_target = direction + 0.5 * (std::f64::consts::PI - parallax);
    Scene {
        worn,
        robots: vec![[0.0; 3], [baseline_m * c, baseline_m * s, turn(direction + std::f64::consts::PI + turned)]],
        targets: vec![[away * to_target.cos(), away * to_target.sin()]],
    }
}

/// Robots and two targets more than robots in a room of 8 × 6 m, in the first one's frame.
pub fn drawn(robots: usize, seed: u64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut places: Vec<[f64; 2]> = Vec::new();
    while places.len() < 2 * robots + 2 {
        let place = [rng.random_range(0.0..8.0), rng.random_range(0.0..6.0)];
        // Ten robots and twelve targets fit with this between them.
        if places.iter().all(|p| (p[0] - place[0]).hypot(p[1] - place[1]) > 0.7) {
            places.push(place);
        }
    }
    let headings: Vec<f64> = (0..robots).map(|_| rng.random_range(-3.1..3.1)).collect();
    let [x0, y0] = places[0];
    let (s, c) = headings[0].sin_cos();
    let there = |p: &[f64; 2]| {
        let (dx, dy) = (p[0] - x0, p[1] - y0);
        [c * dx + s * dy, c * dy - s * dx]
    };
    Scene {
        worn: Worn::Cylinder,
        robots: places[..robots]
            .iter()
            .zip(&headings)
            .map(|(p, h)| {
                let [x, y] = there(p);
                [x, y, turn(h - headings[0])]
            })
            .collect(),
        targets: places[robots..].iter().map(there).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_of_an_error_is_half_the_slope_of_its_loss_over_it() {
        for noise in [Noise::Gaussian, Noise::Tailed] {
            for r in [0.2, 1.5, 2.5, 3.0, 4.0, 12.0] {
                let slope = (noise.loss(r + 1e-5).0 - noise.loss(r - 1e-5).0) / 2e-5;
                assert!((0.5 * slope / r - noise.loss(r).1).abs() < 1e-6, "{noise:?} {r}");
            }
        }
    }
}
