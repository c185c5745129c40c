//! The radial polynomial from bars of equal width.
//!
//! Problem: a board of bars of one unknown width seen along a meridian gives edges r₀ … r_m; wanted is R(r), the radius of
//! a picture in which all bars are equally wide (4-2). Insight: equal bars of unknown size fix R up to an offset and a
//! scale; with R(r₀) = r₀ and R(r_m) = r_m as constraints the rest is linear least squares (a KKT system) in
//! u = (r − r_c)/r_s, which keeps it well conditioned. The noise is in the edges' radii, so each residual counts by
//! 1/R'(r)²; two rounds suffice.
//!
//! Source: `MATHS.md` §4.2, report (4-2).

use nalgebra::{DMatrix, DVector};

/// Order that leaves 0.1 px on the report's lens; higher ones only follow the noise.
pub const DEFAULT_ORDER: usize = 3;
/// Largest order: beyond, the polynomial swings between the edges.
pub const MAX_ORDER: usize = 6;

/// R(r) = Σ vₙ uⁿ, u = (r − r_c)/r_s.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialPolynomial {
    coefficients: Vec<f64>,
    centre_px: f64,
    scale_px: f64,
    /// First and last edge, px: where it holds.
    pub domain_px: [f64; 2],
    /// Rms of the edges against equal bars, in their own radii, px.
    pub rms_px: f64,
    /// The largest of these residuals, px.
    pub worst_px: f64,
    /// Edges minus unknowns.
    pub dof: usize,
}

/// Why there is no polynomial.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RadialError {
    /// Order out of range.
    #[error("order {order}: must be from 1 to {MAX_ORDER}")]
    Order {
        /// As given.
        order: usize,
    },
    /// Too few edges for the order.
    #[error("{edges} edges: order {order} needs at least {needed}")]
    TooFewEdges {
        /// How many there are.
        edges: usize,
        /// Order of the polynomial.
        order: usize,
        /// How many it takes.
        needed: usize,
    },
    /// Edges out of order.
    #[error(
        "edge {index} at {radius_px:.2} px: radii must be positive and go one way, from bar to bar (was an edge missed?)"
    )]
    Sequence {
        /// Index from 0.
        index: usize,
        /// Its radius, px.
        radius_px: f64,
    },
    /// The fit turns back.
    #[error(
        "the polynomial of order {order} turns back at {radius_px:.1} px: the edges are not those of equal bars (was one missed?), or \
         the order is too high"
    )]
    NotMonotone {
        /// Its order.
        order: usize,
        /// Where.
        radius_px: f64,
    },
}

/// Fits the polynomial of this order to the edges of equal bars: radii in px, in the order of the bars, outwards or inwards.
///
/// # Errors
/// A wrong order, too few edges, edges that are not in order, or a polynomial that is not monotone between them.
pub fn from_equal_bars(edges_px: &[f64], order: usize) -> Result<RadialPolynomial, RadialError> {
    let fit = fit(edges_px, order, true)?;
    if let Some(radius_px) = fit.turning_radius_px() {
        return Err(RadialError::NotMonotone { order, radius_px });
    }
    Ok(fit)
}

fn fit(edges_px: &[f64], order: usize, by_slope: bool) -> Result<RadialPolynomial, RadialError> {
    if !(1..=MAX_ORDER).contains(&order) {
        return Err(RadialError::Order { order });
    }
    let needed = order + 2;
    if edges_px.len() < needed {
        return Err(RadialError::TooFewEdges { edges: edges_px.len(), order, needed });
    }
    let outwards = edges_px[1] > edges_px[0];
    for (index, radius_px) in edges_px.iter().enumerate() {
        let in_order =
            index == 0 || ((*radius_px > edges_px[index - 1]) == outwards && *radius_px != edges_px[index - 1]);
        if !(*radius_px > 0.0 && radius_px.is_finite() && in_order) {
            return Err(RadialError::Sequence { index, radius_px: *radius_px });
        }
    }
    let last = edges_px.len() - 1;
    let (first_px, last_px) = (edges_px[0], edges_px[last]);
    let mut polynomial = RadialPolynomial {
        coefficients: vec![0.0; order + 1],
        centre_px: 0.5 * (first_px + last_px),
        scale_px: 0.5 * (last_px - first_px).abs(),
        domain_px: [first_px.min(last_px), first_px.max(last_px)],
        rms_px: 0.0,
        worst_px: 0.0,
        dof: edges_px.len() - 2 - (order - 1),
    };
    let target = |i: usize| first_px + (last_px - first_px) * i as f64 / last as f64;
    let mut weights = vec![1.0; edges_px.len()];
    for _ in 0..if by_slope { 3 } else { 1 } {
        let n = order + 1;
        let mut system = DMatrix::zeros(n + 2, n + 2);
        let mut right = DVector::zeros(n + 2);
        for (i, r) in edges_px.iter().enumerate() {
            let row = polynomial.powers(*r);
            for a in 0..n {
                for b in 0..n {
                    system[(a, b)] += weights[i] * row[a] * row[b];
                }
                right[a] += weights[i] * row[a] * target(i);
            }
        }
        for (k, r) in [first_px, last_px].into_iter().enumerate() {
            for (a, power) in polynomial.powers(r).into_iter().enumerate() {
                system[(n + k, a)] = power;
                system[(a, n + k)] = power;
            }
            right[n + k] = r;
        }
        let solution = system.lu().solve(&right).unwrap_or_else(|| DVector::zeros(n + 2));
        polynomial.coefficients = solution.iter().take(n).copied().collect();
        weights = edges_px.iter().map(|r| polynomial.slope(*r).powi(2).max(1e-6).recip()).collect();
    }
    let residuals: Vec<f64> = edges_px
        .iter()
        .enumerate()
        .map(|(i, r)| (polynomial.value(*r) - target(i)) / if by_slope { polynomial.slope(*r) } else { 1.0 })
        .collect();
    polynomial.worst_px = residuals.iter().fold(0.0, |worst, r| r.abs().max(worst));
    polynomial.rms_px = (residuals.iter().map(|r| r * r).sum::<f64>() / polynomial.dof.max(1) as f64).sqrt();
    Ok(polynomial)
}

impl RadialPolynomial {
    fn powers(&self, radius_px: f64) -> Vec<f64> {
        let u = (radius_px - self.centre_px) / self.scale_px;
        (0..self.coefficients.len()).map(|n| u.powi(n as i32)).collect()
    }

    /// R(r), px.
    pub fn value(&self, radius_px: f64) -> f64 {
        self.powers(radius_px).iter().zip(&self.coefficients).map(|(p, c)| p * c).sum()
    }

    /// dR/dr.
    pub fn slope(&self, radius_px: f64) -> f64 {
        let u = (radius_px - self.centre_px) / self.scale_px;
        let terms = self.coefficients.iter().enumerate().skip(1);
        terms.map(|(n, c)| n as f64 * c * u.powi(n as i32 - 1)).sum::<f64>() / self.scale_px
    }

    /// Where between the edges the slope is no longer positive.
    fn turning_radius_px(&self) -> Option<f64> {
        let [low, high] = self.domain_px;
        (0..=256).map(|i| low + (high - low) * f64::from(i) / 256.0).find(|r| self.slope(*r) <= 0.0)
    }

    /// The coefficients v₀ … of powers of r itself, as (4-2) prints them.
    pub fn monomials(&self) -> Vec<f64> {
        // Horner's scheme on polynomials: multiply by u = (r − r_c)/r_s, add the next coefficient.
        let mut result = vec![0.0; self.coefficients.len()];
        for c in self.coefficients.iter().rev() {
            let mut next = vec![0.0; result.len()];
            for (n, v) in result.iter().enumerate() {
                next[n] -= v * self.centre_px / self.scale_px;
                if n + 1 < next.len() {
                    next[n + 1] += v / self.scale_px;
                }
            }
            next[0] += c;
            result = next;
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden_edges() -> Vec<f64> {
        serde_json::from_value(crate::calibration::golden("poly42")["inputs"]["edges_r"].clone()).unwrap()
    }

    #[test]
    fn golden_edges_give_the_golden_polynomial() {
        let expected = crate::calibration::golden("poly42")["outputs"].clone();
        let fit = fit(&golden_edges(), 2, false).unwrap();
        let v: Vec<f64> = serde_json::from_value(expected["v_monomial"].clone()).unwrap();
        for (a, b) in fit.monomials().iter().zip(&v) {
            assert!((a - b).abs() < 1e-8 * b.abs(), "{a} {b}");
        }
        assert!((fit.worst_px - expected["max_resid"].as_f64().unwrap()).abs() < 1e-8);
    }

    #[test]
    fn each_order_leaves_what_the_report_s_lens_leaves() {
        for (order, left_px) in [(2, 0.80), (3, 0.095), (4, 0.012)] {
            let fit = fit(&golden_edges(), order, false).unwrap();
            assert!((fit.worst_px - left_px).abs() < 0.05 * left_px, "order {order}: {}", fit.worst_px);
        }
    }

    #[test]
    fn the_ends_stay_and_bars_become_equal() {
        let edges = golden_edges();
        let fit = from_equal_bars(&edges, 3).unwrap();
        assert!((fit.value(edges[0]) - edges[0]).abs() < 1e-9);
        let widths: Vec<f64> = edges.windows(2).map(|e| fit.value(e[0]) - fit.value(e[1])).collect();
        let mean = widths.iter().sum::<f64>() / widths.len() as f64;
        assert!(widths.iter().all(|w| (w - mean).abs() < 0.03 * mean), "{widths:?}");
    }

    #[test]
    fn missed_and_repeated_edges_are_refused() {
        assert!(matches!(
            from_equal_bars(&[10.0, 12.0, 11.0, 15.0, 18.0], 2),
            Err(RadialError::Sequence { index: 2, .. })
        ));
        assert!(matches!(from_equal_bars(&[10.0, 12.0], 2), Err(RadialError::TooFewEdges { needed: 4, .. })));
        assert!(matches!(from_equal_bars(&golden_edges(), 9), Err(RadialError::Order { order: 9 })));
    }
}
