//! Figures by marker and range.

use std::collections::BTreeMap;

use robot_agent::peers::Traits;
use serde::Serialize;

use super::Outcome;
use super::hidden::{self, Hidden};
use super::trial::{Kind, Sighting, View, turned};

/// Bounds of the bins of range, metres.
pub const BINS_M: [f64; 7] = [0.6, 1.0, 2.0, 3.0, 4.0, 5.0, 6.01];
/// Least unhidden share of a robot that should be found.
const LEAST_VISIBLE: f64 = 0.5;
/// A plate turned further than this from or towards the edge-on view is not asked for: 60°.
const MOST_TURN_RAD: f64 = std::f64::consts::FRAC_PI_3;
/// χ² of two numbers that is exceeded as often as 4 σ of one (6.3 in 100,000).
pub(super) const FOUR_SIGMA: f64 = 19.33;
/// Pictures in which a robot must be found for its baseline to count.
const LEAST_PICTURES: usize = 5;

/// Most traits that are told of a missed robot.
const MOST_DOUBTS: usize = 4;

/// All figures.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Of the first layout.
    pub seed: u64,
    /// Layouts that were drawn.
    pub layouts: usize,
    /// Pictures of them.
    pub pictures: usize,
    /// Sightings in them.
    pub sightings: usize,
    /// By marker and range.
    pub cells: Vec<Cell>,
    /// Detection of robots of which at least half is unhidden, by marker.
    pub detection: BTreeMap<&'static str, Share>,
    /// Sightings beyond 4 σ of every robot.
    pub beyond_four_sigma: usize,
    /// Of those, sightings where there is no robot at all.
    pub without_robot: usize,
    /// Headings more than 4 σ off.
    pub headings_beyond_four_sigma: usize,
    /// By what stands before a robot.
    pub hidden: Vec<Hidden>,
    /// Range over a second of standing, by range.
    pub baseline: Vec<Baseline>,
    /// Mean time of the detector.
    pub detector_us: f64,
    /// What went wrong where.
    pub faults: Vec<Fault>,
}

/// Found of shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Share {
    /// At least half unhidden.
    pub shown: usize,
    /// Of those.
    pub found: usize,
}

impl Share {
    /// Found over shown; 1 where nothing was shown.
    pub fn rate(&self) -> f64 {
        if self.shown == 0 { 1.0 } else { self.found as f64 / self.shown as f64 }
    }
}

/// One marker in one bin of range. Errors are of all that was found, hidden or not.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Cell {
    /// cylinder, bars, coded bars, rectangle.
    pub marker: &'static str,
    /// Bin.
    pub range_m: [f64; 2],
    /// Of those at least half unhidden.
    pub half_seen: Share,
    /// Errors of bearing: bias and RMS.
    pub bearing_mrad: [f64; 2],
    /// Errors of range: bias and RMS.
    pub range_percent: [f64; 2],
    /// Mean of (error' C⁻¹ error) / 2.
    pub nees: f64,
    /// Sightings with a heading.
    pub headings: usize,
    /// RMS error of the heading.
    pub heading_deg: f64,
    /// Mean squared error of the heading over its variance.
    pub heading_nees: f64,
    /// Sightings that named the right robot, and a wrong one.
    pub named: [usize; 2],
}

/// A bin of range over a second of standing.
#[derive(Debug, Clone, Serialize)]
pub struct Baseline {
    /// Bin.
    pub range_m: [f64; 2],
    /// Robots.
    pub robots: usize,
    /// Mean error.
    pub bias_percent: f64,
    /// RMS error, bias included.
    pub rms_percent: f64,
}

/// A miss or a false sighting.
#[derive(Debug, Clone, Serialize)]
pub struct Fault {
    /// Of the layout.
    pub seed: u64,
    /// From 0.
    pub picture: usize,
    /// Where it is in the observer's body frame.
    pub bearing_deg: f64,
    /// What happened.
    pub what: String,
}

#[derive(Default)]
struct Sums {
    half_seen: Share,
    n: usize,
    bearing: [f64; 2],
    range: [f64; 2],
    nees: f64,
    headings: usize,
    heading2: f64,
    heading_nees: f64,
    named: [usize; 2],
}

/// Puts outcomes together.
pub fn report(outcomes: &[Outcome]) -> Report {
    let mut sums: BTreeMap<(Kind, usize), Sums> = BTreeMap::new();
    let mut report = Report {
        seed: outcomes.first().map_or(0, |o| o.seed),
        layouts: outcomes.iter().filter(|o| !o.views.is_empty()).count(),
        pictures: outcomes.iter().map(|o| o.views.len()).sum(),
        sightings: outcomes.iter().flat_map(|o| &o.sightings).map(Vec::len).sum(),
        cells: Vec::new(),
        detection: BTreeMap::new(),
        beyond_four_sigma: 0,
        without_robot: 0,
        headings_beyond_four_sigma: 0,
        hidden: hidden::table(outcomes),
        baseline: Vec::new(),
        detector_us: outcomes.iter().map(|o| o.detector_us).sum::<f64>() / outcomes.len().max(1) as f64,
        faults: Vec::new(),
    };
    for outcome in outcomes {
        for (picture, (views, sightings)) in outcome.views.iter().zip(&outcome.sightings).enumerate() {
            let mut tell = |bearing_rad: f64, what: String| {
                let bearing_deg = bearing_rad.to_degrees();
                report.faults.push(Fault { seed: outcome.seed, picture, bearing_deg, what });
            };
            for (n, view) in views.iter().enumerate() {
                let Some(bin) = bin(view.range_m) else { continue };
                let cell = sums.entry((view.kind, bin)).or_default();
                let found = sightings.iter().find(|s| s.view == Some(n));
                if is_asked_for(view) {
                    cell.half_seen.shown += 1;
                    cell.half_seen.found += usize::from(found.is_some());
                    if found.is_none() {
                        tell(view.bearing_rad, missed(view, outcome.likeliest[picture][n].as_ref()));
                    }
                }
                if let Some(found) = found {
                    cell.add(view, found);
                    if let Some(what) = turned_wrong(view, found) {
                        report.headings_beyond_four_sigma += 1;
                        tell(view.bearing_rad, what);
                    }
                    if let Some(what) = misnamed(view, found) {
                        tell(view.bearing_rad, what);
                    }
                }
            }
            for sighting in sightings {
                let nearest = views.iter().map(|v| distance2(v, sighting)).fold(f64::INFINITY, f64::min);
                if nearest > FOUR_SIGMA {
                    report.beyond_four_sigma += 1;
                    report.without_robot += usize::from(sighting.view.is_none());
                    let view = sighting.view.map(|n| &views[n]);
                    tell(sighting.peer.bearing_rad, strayed(sighting, view, nearest.sqrt()));
                }
            }
        }
    }
    for ((kind, bin), sums) in &sums {
        let share = report.detection.entry(kind.name()).or_default();
        share.shown += sums.half_seen.shown;
        share.found += sums.half_seen.found;
        report.cells.push(sums.cell(*kind, *bin));
    }
    report.baseline = baseline(outcomes);
    report
}

fn bin(range_m: f64) -> Option<usize> {
    BINS_M.windows(2).position(|b| range_m >= b[0] && range_m < b[1])
}

fn is_asked_for(view: &View) -> bool {
    view.visible >= LEAST_VISIBLE && shows(view)
}

/// Whether the marker would be seen if nothing hid it.
pub(super) fn shows(view: &View) -> bool {
    let faces = view.turn_rad.min(std::f64::consts::PI - view.turn_rad);
    view.pixels > 0 && (view.kind != Kind::Rectangle || faces <= MOST_TURN_RAD)
}

/// (error' C⁻¹ error) of bearing and range.
pub(super) fn distance2(view: &View, sighting: &Sighting) -> f64 {
    let peer = &sighting.peer;
    let error = nalgebra::Vector2::new(turned(peer.bearing_rad - view.bearing_rad), peer.range_m - view.range_m);
    peer.covariance.try_inverse().map_or(f64::INFINITY, |inverse| (error.transpose() * inverse * error)[0])
}

fn missed(view: &View, likeliest: Option<&Traits>) -> String {
    let why = likeliest.map_or("nothing fits there".to_owned(), doubt);
    format!(
        "missed {} {} at {:.1}°, {:.2} m, turned {:.0}°, {:.0} % of {} px to be seen; {why}",
        view.kind.name(),
        view.robot,
        view.bearing_rad.to_degrees(),
        view.range_m,
        view.turn_rad.to_degrees(),
        100.0 * view.visible,
        view.pixels
    )
}

/// What was fitted, and what spoke most against its being a robot.
pub(super) fn doubt(traits: &Traits) -> String {
    let mut against = traits.terms();
    against.sort_by(|a, b| a.1.total_cmp(&b.1));
    let against: Vec<String> =
        against.iter().take(MOST_DOUBTS).map(|(name, nats)| format!("{name} {nats:.1}")).collect();
    let by_net = traits.by_net().map_or(String::new(), |nats| format!(" (network {nats:.1})"));
    format!("{:?} fit, log-odds {:.1}{by_net}: {}", traits.basis, traits.log_odds(), against.join(", "))
}

/// What is wrong about a heading, if it is more than 4 σ off.
fn turned_wrong(view: &View, sighting: &Sighting) -> Option<String> {
    let [heading, sigma] = sighting.peer.heading_rad?;
    let error = turned(heading - view.heading_rad);
    (error.abs() > 4.0 * sigma).then(|| {
        format!(
            "heading {:+.1}° off ± {:.2}°: {} {} at {:.2} m, turned {:.0}°, {:.0} % seen, sighted as kind {}",
            error.to_degrees(),
            sigma.to_degrees(),
            view.kind.name(),
            view.robot,
            view.range_m,
            view.turn_rad.to_degrees(),
            100.0 * view.visible,
            sighting.peer.kind
        )
    })
}

/// Who was taken for somebody else.
fn misnamed(view: &View, sighting: &Sighting) -> Option<String> {
    let named = sighting.peer.robot.filter(|robot| *robot != view.robot)?;
    let (kind, robot, range, seen) = (view.kind.name(), view.robot, view.range_m, 100.0 * view.visible);
    Some(format!("named {named}: {kind} {robot} at {range:.2} m, {seen:.0} % seen, kind {}", sighting.peer.kind))
}

fn strayed(sighting: &Sighting, view: Option<&View>, sigmas: f64) -> String {
    let p = &sighting.peer;
    let of = view.map_or("nobody".to_owned(), |v| {
        format!(
            "{} {} at {:.2}°, {:.3} m ({:.0} % seen)",
            v.kind.name(),
            v.robot,
            v.bearing_rad.to_degrees(),
            v.range_m,
            100.0 * v.visible
        )
    });
    format!(
        "{sigmas:.1} σ off: {of}, sighted as kind {} at {:.2}° ± {:.3}°, {:.3} ± {:.4} m, {} features, confidence {:.2}",
        p.kind,
        p.bearing_rad.to_degrees(),
        p.bearing_sigma_rad().to_degrees(),
        p.range_m,
        p.range_sigma_m(),
        p.features.len(),
        p.confidence
    )
}

impl Sums {
    fn add(&mut self, view: &View, sighting: &Sighting) {
        let peer = &sighting.peer;
        self.n += 1;
        let bearing = turned(peer.bearing_rad - view.bearing_rad);
        let range = peer.range_m / view.range_m - 1.0;
        for (sums, error) in [(&mut self.bearing, bearing), (&mut self.range, range)] {
            sums[0] += error;
            sums[1] += error * error;
        }
        self.nees += 0.5 * distance2(view, sighting);
        if let Some([heading, sigma]) = peer.heading_rad {
            let error = turned(heading - view.heading_rad);
            self.headings += 1;
            self.heading2 += error * error;
            self.heading_nees += (error / sigma).powi(2);
        }
        if let Some(robot) = peer.robot {
            self.named[usize::from(robot != view.robot)] += 1;
        }
    }

    fn cell(&self, kind: Kind, bin: usize) -> Cell {
        let mean = |sum: f64, n: usize| sum / n.max(1) as f64;
        let errors =
            |[sum, squares]: [f64; 2], unit: f64| [unit * mean(sum, self.n), unit * mean(squares, self.n).sqrt()];
        Cell {
            marker: kind.name(),
            range_m: [BINS_M[bin], BINS_M[bin + 1]],
            half_seen: self.half_seen,
            bearing_mrad: errors(self.bearing, 1e3),
            range_percent: errors(self.range, 100.0),
            nees: mean(self.nees, self.n),
            headings: self.headings,
            heading_deg: mean(self.heading2, self.headings).sqrt().to_degrees(),
            heading_nees: mean(self.heading_nees, self.headings),
            named: self.named,
        }
    }
}

/// The mean range of each robot over its pictures, against truth.
fn baseline(outcomes: &[Outcome]) -> Vec<Baseline> {
    let mut errors: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for outcome in outcomes {
        for n in 0..outcome.views.first().map_or(0, Vec::len) {
            // A robot's weight in a picture is what the agent says of its noise.
            let (mut sum, mut weights, mut count) = (0.0, 0.0, 0);
            for sightings in &outcome.sightings {
                if let Some(s) = sightings.iter().find(|s| s.view == Some(n)) {
                    let weight = 1.0 / s.peer.range_sigma_m().powi(2).max(1e-12);
                    sum += weight * s.peer.range_m;
                    weights += weight;
                    count += 1;
                }
            }
            let truth = outcome.views[0][n].range_m;
            if let (true, Some(bin)) = (count >= LEAST_PICTURES, bin(truth)) {
                errors.entry(bin).or_default().push(sum / weights / truth - 1.0);
            }
        }
    }
    errors
        .into_iter()
        .map(|(bin, errors)| {
            let n = errors.len() as f64;
            Baseline {
                range_m: [BINS_M[bin], BINS_M[bin + 1]],
                robots: errors.len(),
                bias_percent: 100.0 * errors.iter().sum::<f64>() / n,
                rms_percent: 100.0 * (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            }
        })
        .collect()
}
