//! Which camera model the data supports.
//!
//! Each candidate is fitted to all views, and then judged on views that its fit has not seen (only their poses are fitted).
//! Of the candidates the simplest is chosen whose error on unseen views is not distinguishably worse than the best one's:
//! by less than one standard error of the difference, view against view. The Bayesian information criterion is given
//! beside it; alone it would believe that a thousand points are a thousand independent facts, which they are not.

use super::bundle::{BundleError, Fit, ViewPose, fit_pose};
use super::candidate::Candidate;
use super::observation::Observations;

/// Views are left out one at a time up to this many views, else in this many groups.
const MAX_FOLDS: usize = 20;
/// Terms of misalignment that lower the error on unseen views by more than this share are a misalignment. Fewer would move
/// the centre by pixels for hundredths of a pixel in the residuals.
const MISALIGNED: f64 = 0.2;
/// Fewer views are too few to leave some out.
const MIN_VIEWS: usize = 3;

/// A fitted candidate.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Its name.
    pub name: String,
    /// Its fit to all views.
    pub fit: Fit,
    /// Rms residual (both components) on views that the fit had not seen, px; `None` with too few views.
    pub unseen_rms_px: Option<f64>,
    /// Mean squared residual of each unseen view, px².
    unseen_squares_px2: Vec<f64>,
    /// Bayesian information criterion: smaller is better.
    pub information_criterion: f64,
}

/// All candidates, and which is chosen.
#[derive(Debug, Clone)]
pub struct Selection {
    /// Those that could be fitted, in the order given.
    pub judged: Vec<Judged>,
    /// Those that could not, with the reason.
    pub failed: Vec<(String, BundleError)>,
    /// Index into `judged`.
    pub chosen: usize,
}

impl Judged {
    /// The same model without the terms of misalignment, where this one has them and both were fitted.
    fn aligned<'a>(&self, judged: &'a [Self]) -> Option<&'a Self> {
        let aligned = match self.name.strip_suffix(", radial and tangential") {
            Some(model) => format!("{model}, radial"),
            None => self.name.strip_suffix(", misaligned")?.to_owned(),
        };
        judged.iter().find(|j| j.name == aligned)
    }

    /// Whether the terms of misalignment, if it has any, are worth it.
    fn is_justified(&self, judged: &[Self]) -> bool {
        match (self.unseen_rms_px, self.aligned(judged).and_then(|a| a.unseen_rms_px)) {
            (Some(with), Some(without)) => with <= (1.0 - MISALIGNED) * without,
            _ => true,
        }
    }
}

impl Selection {
    /// The best of the models that were fitted with and without misalignment, if it is worth it: with, without.
    pub fn misaligned(&self) -> Option<(&Judged, &Judged)> {
        let unseen = |j: &Judged| j.unseen_rms_px.unwrap_or(f64::INFINITY);
        let pairs = self.judged.iter().filter_map(|with| Some((with, with.aligned(&self.judged)?)));
        let (with, without) = pairs.min_by(|a, b| unseen(a.0).total_cmp(&unseen(b.0)))?;
        (with.unseen_rms_px.is_some() && without.unseen_rms_px.is_some() && with.is_justified(&self.judged))
            .then_some((with, without))
    }

    /// The chosen one.
    pub fn best(&self) -> &Judged {
        &self.judged[self.chosen]
    }

    /// Whether the information criterion prefers another candidate; its name.
    pub fn dissent(&self) -> Option<&str> {
        let least = self.judged.iter().min_by(|a, b| a.information_criterion.total_cmp(&b.information_criterion))?;
        (least.name != self.best().name).then_some(&least.name)
    }
}

/// Fits all candidates and chooses.
///
/// # Errors
/// No candidate can be fitted: the error of the first.
pub fn select(observations: &Observations, candidates: &[Candidate]) -> Result<Selection, BundleError> {
    select_with(observations, candidates, |_| {})
}

/// As [`select`]; `starts` hears the name of each candidate before it is fitted.
///
/// # Errors
/// As [`select`].
pub fn select_with(
    observations: &Observations,
    candidates: &[Candidate],
    mut starts: impl FnMut(&str),
) -> Result<Selection, BundleError> {
    let (mut judged, mut failed) = (Vec::<Judged>::new(), Vec::new());
    for candidate in candidates {
        starts(&candidate.name);
        // A richer variant of a model starts where the simpler one ended.
        let simpler = judged
            .iter()
            .rev()
            .find_map(|j| Some((candidate.start.with_numbers_of(&j.fit.camera)?, j.fit.poses.clone())));
        let fitted = match simpler {
            Some((start, poses)) => {
                Fit::from_poses(observations, &start, poses).or_else(|_| Fit::search(observations, &candidate.start))
            }
            None => Fit::search(observations, &candidate.start),
        };
        match fitted {
            Ok(fit) => judged.push(judge(observations, candidate, fit)),
            Err(error) => failed.push((candidate.name.clone(), error)),
        }
    }
    match choose(&judged) {
        Some(chosen) => Ok(Selection { judged, failed, chosen }),
        None => Err(failed.into_iter().next().map_or(
            BundleError::TooFew { measurements: 2 * observations.points(), unknowns: 0, camera: 0 },
            |(_, error)| error,
        )),
    }
}

fn judge(observations: &Observations, candidate: &Candidate, fit: Fit) -> Judged {
    let unseen_squares_px2 = unseen(observations, &fit).unwrap_or_default();
    let points: Vec<f64> = observations.views.iter().map(|v| v.points.len() as f64).collect();
    let unseen_rms_px = (!unseen_squares_px2.is_empty()).then(|| {
        let sum: f64 = unseen_squares_px2.iter().zip(&points).map(|(s, n)| s * n).sum();
        (sum / points.iter().sum::<f64>()).sqrt()
    });
    let n = 2.0 * observations.points() as f64;
    let information_criterion = n * (fit.weighted_squares_px2() / n).ln() + fit.camera.unknowns().len() as f64 * n.ln();
    Judged { name: candidate.name.clone(), fit, unseen_rms_px, unseen_squares_px2, information_criterion }
}

/// Mean squared residual of each view under a camera that was fitted without it; `None` where that cannot be done.
fn unseen(observations: &Observations, fit: &Fit) -> Option<Vec<f64>> {
    let views = observations.views.len();
    if views < MIN_VIEWS {
        return None;
    }
    let folds = views.min(MAX_FOLDS);
    let mut squares = vec![0.0; views];
    for fold in 0..folds {
        let kept: Vec<usize> = (0..views).filter(|v| v % folds != fold).collect();
        let poses: Vec<ViewPose> = kept.iter().map(|v| fit.poses[*v].clone()).collect();
        let without = Fit::from_poses(&observations.subset(&kept), &fit.camera, poses).ok()?;
        for v in (fold..views).step_by(folds) {
            let view = &observations.views[v];
            let weights = &fit.weights[v];
            let pose = fit_pose(&without.camera, view, weights, &fit.poses[v]);
            let residuals = pose.residuals_px(&without.camera, view);
            let sum: f64 = residuals.iter().zip(weights).map(|(r, w)| w * r.norm_squared()).sum();
            squares[v] = sum / view.points.len() as f64;
        }
    }
    Some(squares)
}

/// Among those whose terms of misalignment are worth it, the simplest candidate that is not distinguishably worse on unseen views than the best.
fn choose(judged: &[Judged]) -> Option<usize> {
    let score = |j: &Judged| j.unseen_rms_px.unwrap_or(f64::INFINITY);
    let justified = || (0..judged.len()).filter(|i| judged[*i].is_justified(judged));
    let best = justified().min_by(|a, b| {
        let criterion = |i: usize| judged[i].information_criterion;
        score(&judged[*a]).total_cmp(&score(&judged[*b])).then(criterion(*a).total_cmp(&criterion(*b)))
    })?;
    let as_good = |i: &usize| {
        if *i == best {
            return true;
        }
        let (own, least) = (&judged[*i].unseen_squares_px2, &judged[best].unseen_squares_px2);
        if own.is_empty() || own.len() != least.len() {
            return false;
        }
        let differences: Vec<f64> = own.iter().zip(least).map(|(a, b)| a - b).collect();
        let n = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / n;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
        mean < (variance / n).sqrt()
    };
    let unknowns = |i: &usize| judged[*i].fit.camera.unknowns().len();
    justified().filter(as_good).min_by_key(unknowns)
}
