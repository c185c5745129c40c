//! The picture's centre from the images of vertical lines.
//!
//! Problem: the image of the vertical direction, to which all vertical lines run, from edges with noise and some that are
//! no vertical lines. Insight: with all lines through one common point c, each line's angle can be eliminated by itself
//! (a Schur complement of one unknown), and what is left is a problem of two numbers: per line the weight
//! h = m − (Σa)²/Σa² and the residual g = Σe − (Σa)(Σae)/Σa² along its normal n, with levers a and distances e measured
//! from c. A line whose points all lie far from c on a short piece has little h, and counts little, as it should.
//!
//! This is the optical centre only where the camera's axis is vertical; otherwise the offset from the centre of the rim
//! circles ([`super::rim`]) measures the tilt.
//!
//! Source: `MATHS.md` §4.1, report 4.1.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

/// Tukey's constant: 95 % efficiency on Gaussian noise.
const TUKEY: f64 = 4.685;
const MAX_ITERATIONS: usize = 100;
/// A step below this ends the iteration, px.
const SETTLED_PX: f64 = 1e-10;
/// Condition of the normal matrix above which the lines are as good as parallel.
const MAX_CONDITION: f64 = 1e6;

/// The centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Centre {
    /// (u₀, v₀), px.
    pub centre_px: Vector2<f64>,
    /// px²; scaled up where the lines contradict each other by more than their points' noise.
    pub covariance_px2: Matrix2<f64>,
    /// Noise of one edge point across its line, px.
    pub sigma_px: f64,
    /// Scatter of the lines against what their points' noise explains: 1 where they agree.
    pub line_scatter: f64,
    /// Weight of each line in [0, 1], in the order given; 0 for one that misses the centre.
    pub weights: Vec<f64>,
}

/// Why there is no centre.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CentreError {
    /// Not enough lines.
    #[error(
        "{lines} lines of at least 3 points: the centre needs 3 or more (are there long vertical edges in the picture?)"
    )]
    TooFewLines {
        /// Usable ones.
        lines: usize,
    },
    /// Lines that do not cross.
    #[error(
        "the lines are nearly parallel: they say where the centre is across them, not along; take lines from all round the picture"
    )]
    Parallel,
    /// Most lines miss each other.
    #[error("{agreeing} of {lines} lines meet in one point: are they the images of vertical lines?")]
    NoCommonPoint {
        /// Lines that do.
        agreeing: usize,
        /// All.
        lines: usize,
    },
}

/// The common point of lines given by points on them (px), each with the same unknown noise. Robust: lines that miss the
/// point on which most agree do not count.
///
/// # Errors
/// Fewer than three lines, nearly parallel ones, or no common point.
pub fn of_lines(lines: &[Vec<Vector2<f64>>]) -> Result<Centre, CentreError> {
    let usable: Vec<&Vec<Vector2<f64>>> = lines.iter().filter(|l| l.len() >= 3).collect();
    if usable.len() < 3 {
        return Err(CentreError::TooFewLines { lines: usable.len() });
    }
    let start = likeliest_crossing(&usable).ok_or(CentreError::Parallel)?;
    // The noise from each line's own straightness: outliers do not touch it.
    let sigma_px = median(usable.iter().map(|l| own_rms(l))).max(1e-9);
    let mut centre = start;
    // The scale of the robust weights: at first as wide as the lines that seem to agree are scattered.
    let mut weights = vec![1.0; usable.len()];
    for _ in 0..MAX_ITERATIONS {
        let parts: Vec<Line> = usable.iter().map(|l| Line::about(l, &centre)).collect();
        let scale = median(parts.iter().map(|p| p.standardised().abs())) / 0.6745;
        let scale = scale.max(sigma_px);
        weights = parts.iter().map(|p| tukey(p.standardised() / scale)).collect();
        let normal = normal_matrix(&parts, &weights)?;
        let right: Vector2<f64> = parts.iter().zip(&weights).map(|(p, w)| p.normal * (p.g * w)).sum();
        let step = normal.try_inverse().ok_or(CentreError::Parallel)? * right;
        centre += step;
        if step.norm() < SETTLED_PX {
            break;
        }
    }
    let agreeing = weights.iter().filter(|w| **w > 0.0).count();
    if agreeing < 3 || 2 * agreeing < usable.len() {
        return Err(CentreError::NoCommonPoint { agreeing, lines: usable.len() });
    }
    let parts: Vec<Line> = usable.iter().map(|l| Line::about(l, &centre)).collect();
    let squares: f64 = parts.iter().zip(&weights).map(|(p, w)| w * p.standardised().powi(2)).sum();
    let total: f64 = weights.iter().sum();
    let line_scatter = (squares / (total - 2.0).max(1.0)).sqrt() / sigma_px;
    let covariance_px2 = normal_matrix(&parts, &weights)?.try_inverse().ok_or(CentreError::Parallel)?
        * (sigma_px * line_scatter.max(1.0)).powi(2);
    let mut used = weights.iter();
    let weights = lines.iter().map(|l| if l.len() >= 3 { *used.next().unwrap_or(&0.0) } else { 0.0 }).collect();
    Ok(Centre { centre_px: centre, covariance_px2, sigma_px, line_scatter, weights })
}

/// A line through a common point, its angle eliminated.
struct Line {
    normal: Vector2<f64>,
    h: f64,
    g: f64,
}

impl Line {
    fn about(points: &[Vector2<f64>], centre: &Vector2<f64>) -> Self {
        let scatter: Matrix2<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
        let eigen = SymmetricEigen::new(scatter);
        let normal: Vector2<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let along = Vector2::new(-normal.y, normal.x);
        let (mut e_sum, mut a_sum, mut ae, mut aa) = (0.0, 0.0, 0.0, 0.0);
        for p in points {
            let (e, a) = (normal.dot(&(p - centre)), along.dot(&(p - centre)));
            e_sum += e;
            a_sum += a;
            ae += a * e;
            aa += a * a;
        }
        let h = points.len() as f64 - a_sum * a_sum / aa;
        Self { normal, h: h.max(1e-12), g: e_sum - a_sum * ae / aa }
    }

    /// The residual in units of a point's noise.
    fn standardised(&self) -> f64 {
        self.g / self.h.sqrt()
    }
}

fn normal_matrix(parts: &[Line], weights: &[f64]) -> Result<Matrix2<f64>, CentreError> {
    let normal: Matrix2<f64> =
        parts.iter().zip(weights).map(|(p, w)| p.normal * p.normal.transpose() * (p.h * w)).sum();
    let values = normal.symmetric_eigenvalues();
    if values.min() * MAX_CONDITION <= values.max() {
        return Err(CentreError::Parallel);
    }
    Ok(normal)
}

/// Of all crossings of two lines the one with the least median distance to the others.
fn likeliest_crossing(lines: &[&Vec<Vector2<f64>>]) -> Option<Vector2<f64>> {
    let straight: Vec<(Vector2<f64>, f64)> = lines.iter().map(|l| straight_line(l)).collect();
    let mut best: Option<(f64, Vector2<f64>)> = None;
    for (i, (n, c)) in straight.iter().enumerate() {
        for (m, d) in &straight[..i] {
            let Some(inverse) = Matrix2::new(n.x, n.y, m.x, m.y).try_inverse() else { continue };
            let crossing = -(inverse * Vector2::new(*c, *d));
            let distance = median(straight.iter().map(|(n, c)| (n.dot(&crossing) + c).abs()));
            if distance.is_finite() && best.as_ref().is_none_or(|(least, _)| distance < *least) {
                best = Some((distance, crossing));
            }
        }
    }
    best.map(|(_, crossing)| crossing)
}

/// Normal n and offset c of n·x + c = 0 with the least squared distances.
fn straight_line(points: &[Vector2<f64>]) -> (Vector2<f64>, f64) {
    let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let scatter: Matrix2<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    let normal: Vector2<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    (normal, -normal.dot(&mean))
}

fn own_rms(points: &[Vector2<f64>]) -> f64 {
    let (normal, offset) = straight_line(points);
    let squares: f64 = points.iter().map(|p| (normal.dot(p) + offset).powi(2)).sum();
    (squares / (points.len() as f64 - 2.0)).sqrt()
}

fn tukey(standardised: f64) -> f64 {
    let t = standardised / TUKEY;
    if t.abs() < 1.0 { (1.0 - t * t).powi(2) } else { 0.0 }
}

pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};

    use super::*;

    #[test]
    fn golden_lines_meet_where_independent_code_says() {
        let golden = crate::calibration::golden("centre");
        let lines: Vec<Vec<[f64; 2]>> = serde_json::from_value(golden["inputs"]["segments"].clone()).unwrap();
        let lines: Vec<Vec<Vector2<f64>>> =
            lines.into_iter().map(|l| l.into_iter().map(Vector2::from).collect()).collect();
        // The golden numbers are without robust weights.
        let mut centre = Vector2::new(385.0, 287.0);
        let mut parts = Vec::new();
        for _ in 0..50 {
            parts = lines.iter().map(|l| Line::about(l, &centre)).collect::<Vec<_>>();
            let right: Vector2<f64> = parts.iter().map(|p| p.normal * p.g).sum();
            centre += normal_matrix(&parts, &[1.0; 4]).unwrap().try_inverse().unwrap() * right;
        }
        let ml: [f64; 2] = serde_json::from_value(golden["outputs"]["ml"].clone()).unwrap();
        assert!((centre - Vector2::from(ml)).norm() < 1e-9 * 385.0, "{centre}");
        let expected: [[f64; 2]; 2] = serde_json::from_value(golden["outputs"]["cov_unit_sigma"].clone()).unwrap();
        let covariance = normal_matrix(&parts, &[1.0; 4]).unwrap().try_inverse().unwrap();
        for i in 0..2 {
            for j in 0..2 {
                assert!((covariance[(i, j)] - expected[i][j]).abs() < 1e-7, "{covariance}");
            }
        }
        let robust = of_lines(&lines).unwrap();
        assert!((robust.centre_px - Vector2::from(ml)).norm() < 1.0, "{robust:?}");
    }

    fn lines(seed: u64, count: usize, noise_px: f64) -> Vec<Vec<Vector2<f64>>> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_px).unwrap();
        (0..count)
            .map(|i| {
                let angle = (i as f64 + random.random::<f64>()) * std::f64::consts::TAU / count as f64;
                let (along, across) = (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
                (0..60)
                    .map(|k| {
                        let lever = 160.0 + 1.8 * f64::from(k);
                        Vector2::new(384.0, 288.0) + along * lever + across * noise.sample(&mut random)
                    })
                    .collect()
            })
            .collect()
    }

    #[test]
    fn covariance_is_honest_over_many_draws() {
        let runs = 400;
        let mut nees = 0.0;
        for seed in 0..runs {
            let centre = of_lines(&lines(seed, 12, 0.3)).unwrap();
            let error = centre.centre_px - Vector2::new(384.0, 288.0);
            nees += error.dot(&(centre.covariance_px2.try_inverse().unwrap() * error));
        }
        let mean = nees / (2.0 * runs as f64);
        // The scatter of 12 lines is itself uncertain, so the scaled covariance is a little too large on average.
        assert!(mean > 0.75 && mean < 1.15, "NEES/2 = {mean}");
    }

    #[test]
    fn a_line_that_is_not_vertical_does_not_move_the_centre() {
        let mut lines = lines(5, 8, 0.3);
        for p in &mut lines[3] {
            *p += Vector2::new(25.0, 25.0);
        }
        let centre = of_lines(&lines).unwrap();
        assert!((centre.centre_px - Vector2::new(384.0, 288.0)).norm() < 0.6, "{centre:?}");
        assert!(centre.weights[3] == 0.0, "{:?}", centre.weights);
    }

    #[test]
    fn parallel_lines_and_too_few_are_refused_in_words() {
        let parallel: Vec<Vec<Vector2<f64>>> = (0..5)
            .map(|i| (0..20).map(|k| Vector2::new(100.0 + 10.0 * f64::from(i), 50.0 + f64::from(k))).collect())
            .collect();
        assert_eq!(of_lines(&parallel), Err(CentreError::Parallel));
        assert_eq!(of_lines(&lines(1, 2, 0.1)), Err(CentreError::TooFewLines { lines: 2 }));
    }
}
