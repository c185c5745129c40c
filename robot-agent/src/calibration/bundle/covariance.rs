//! How well a fit knows its camera.
//!
//! Problem: (Σ JᵀJ)⁻¹σ² is right only if the points' errors are independent. On real data they are not: a bent board, light
//! from one side, or a model that is a little wrong push all points of a view together, and the camera moves from one set
//! of views to the next by several times what the points alone say. Insight: how much the result would move if a view were
//! left out is seen in the view's own gradient: d_v = (A − A_v)⁻¹ g_v, and (V − 1)/V · Σ d_v d_vᵀ is the jackknife's
//! covariance over views. A handful of views give that matrix badly, so it is drawn towards the points' covariance scaled
//! to the same size. Where the views scatter no more than the points explain, the points' covariance stands.
//!
//! Source: the CR3 estimator of clustered regression (MacKinnon & White 1985, Bell & McCaffrey 2002).

use nalgebra::{DMatrix, DVector};

use super::Fit;

/// Fewer views say nothing about their own scatter.
const MIN_VIEWS: usize = 4;

/// Where a covariance comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CovarianceSource {
    /// From the points' noise: the views scatter no more than that explains.
    Points,
    /// From the scatter of the views, whose variance is this many times what the points explain.
    Views {
        /// Ratio of variances, above 1.
        inflation: f64,
    },
}

/// The covariance of the camera's unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCovariance {
    /// In the order and units of the unknowns.
    pub matrix: DMatrix<f64>,
    /// What it is made from.
    pub source: CovarianceSource,
}

impl CameraCovariance {
    /// Standard deviation of an unknown.
    pub fn sigma(&self, unknown: usize) -> f64 {
        self.matrix[(unknown, unknown)].max(0.0).sqrt()
    }
}

impl Fit {
    /// The camera's information (inverse covariance) from the points alone, for residuals of 1 px.
    pub fn information(&self) -> DMatrix<f64> {
        self.view_information.iter().sum()
    }

    /// The covariance from the points alone, for noise of `sigma_px` in each component. `None` where the data does not
    /// determine every unknown.
    pub fn point_covariance(&self, sigma_px: f64) -> Option<DMatrix<f64>> {
        scaled_inverse(&self.information()).map(|inverse| inverse * (sigma_px * sigma_px))
    }

    /// The covariance of the camera's unknowns, from the views where they scatter more than the points explain.
    /// `None` where the data does not determine every unknown.
    pub fn covariance(&self) -> Option<CameraCovariance> {
        let by_points = self.point_covariance(self.sigma_px)?;
        let (unknowns, views) = (by_points.nrows() as f64, self.view_information.len() as f64);
        let information = self.information();
        let mut jackknife = DMatrix::zeros(by_points.nrows(), by_points.nrows());
        for (own, gradient) in self.view_information.iter().zip(&self.view_gradients) {
            // A view without which the rest is undetermined counts with its first-order influence.
            let rest = scaled_inverse(&(&information - own)).or_else(|| scaled_inverse(&information))?;
            let change: DVector<f64> = rest * gradient;
            jackknife += &change * change.transpose();
        }
        jackknife *= (views - 1.0) / views.max(1.0);
        let whitened = (&information / (self.sigma_px * self.sigma_px)) * &jackknife;
        let inflation = whitened.trace() / unknowns.max(1.0);
        let scatter = 3.0 * (2.0 / (unknowns * (views - 1.0).max(1.0))).sqrt();
        if (self.view_information.len() < MIN_VIEWS) || inflation < 1.0 + scatter {
            return Some(CameraCovariance { matrix: by_points, source: CovarianceSource::Points });
        }
        // As if the scaled points' covariance had been seen in as many views as there are unknowns.
        let share = unknowns / (unknowns + views);
        let matrix = jackknife * (1.0 - share) + by_points * (inflation * share);
        Some(CameraCovariance { matrix, source: CovarianceSource::Views { inflation } })
    }

    /// Directions of the camera's unknowns that the data hardly determines, worst first.
    pub fn weak_directions(&self) -> Vec<WeakDirection> {
        let information = self.information();
        let n = information.nrows();
        let scale = DVector::from_fn(n, |i, _| information[(i, i)].max(1e-300).sqrt().recip());
        let correlation = DMatrix::from_fn(n, n, |i, j| information[(i, j)] * scale[i] * scale[j]);
        let eigen = correlation.symmetric_eigen();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        order
            .into_iter()
            .filter(|k| eigen.eigenvalues[*k] < WEAK_EIGENVALUE)
            .map(|k| {
                let direction = DVector::from_fn(n, |i, _| eigen.eigenvectors[(i, k)] * scale[i]);
                // One sigma along the direction.
                let length = self.sigma_px / eigen.eigenvalues[k].max(1e-12).sqrt();
                WeakDirection { change: direction * length, share: eigen.eigenvalues[k].max(0.0) }
            })
            .collect()
    }
}

/// Unknowns that together explain each other to all but this share are called weak.
const WEAK_EIGENVALUE: f64 = 1e-3;

/// Unknowns that may change together without the data noticing.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// One standard deviation of the combination, in the unknowns' units.
    pub change: DVector<f64>,
    /// What is left of their separate information, in [0, 1].
    pub share: f64,
}

impl Fit {
    /// What the data does not determine, in words, worst first.
    pub fn undetermined(&self) -> Vec<String> {
        let names: Vec<&str> = self.camera.unknowns().iter().map(|u| u.name.as_str()).collect();
        let information = self.information();
        self.weak_directions()
            .iter()
            .map(|weak| {
                let mut parts: Vec<(f64, usize)> =
                    (0..names.len()).map(|i| ((weak.change[i] * information[(i, i)].sqrt()).abs(), i)).collect();
                parts.sort_by(|a, b| b.0.total_cmp(&a.0));
                let largest = parts.first().map_or(0.0, |p| p.0);
                let together: Vec<String> = parts
                    .iter()
                    .filter(|p| p.0 > 0.2 * largest)
                    .map(|(_, i)| format!("{} {}", names[*i], signed(names[*i], weak.change[*i])))
                    .collect();
                format!(
                    "{} may change together by this much (one sigma) and the pictures would hardly differ: only the \
                     combination is known, not each alone",
                    together.join(", ")
                )
            })
            .collect()
    }
}

/// A change with its sign, three significant digits and its unit.
fn signed(name: &str, change: f64) -> String {
    let unit = unit(name);
    let space = if unit.is_empty() { "" } else { " " };
    let decimals = if change == 0.0 { 0.0 } else { (2.0 - change.abs().log10().floor()).clamp(0.0, 300.0) };
    if decimals > 6.0 {
        format!("{change:+.2e}{space}{unit}")
    } else {
        format!("{change:+.*}{space}{unit}", decimals as usize)
    }
}

/// The unit that a parameter's key names; empty for numbers without one and where the unit is the key's own affair.
pub(crate) fn unit(name: &str) -> &'static str {
    let key = name.split('[').next().unwrap_or(name);
    [("_px", "px"), ("_mm", "mm"), ("_deg", "°"), ("_s", "s")]
        .into_iter()
        .find_map(|(ending, unit)| key.ends_with(ending).then_some(unit))
        .unwrap_or(if key == "skew" { "px" } else { "" })
}

/// The inverse after scaling the diagonal to one; `None` where it is singular.
pub(crate) fn scaled_inverse(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = information.nrows();
    let scale = DVector::from_fn(n, |i, _| information[(i, i)].sqrt().recip());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let correlation = DMatrix::from_fn(n, n, |i, j| information[(i, j)] * scale[i] * scale[j]);
    let inverse = correlation.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]))
}
