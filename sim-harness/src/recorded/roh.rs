//! Roh's rotating bearing sensor: four beacons at known places, nine surveyed places, two hundred sets of bearings each
//! (`landmark.csv`, `(Xx,Yy).csv`; heading 90°). Each set alone gives a pose: by the closed form and by the solver.

use std::path::Path;

use protocol::angle::wrap;
use protocol::frames::Pose2;
use serde::Serialize;
use serde_json::json;
use team_leader::solve::input::Problem;
use team_leader::solve::{resection::resect, solve};

use super::{RecordedError, files, median};

/// Heading of the sensor, by the set's description.
const HEADING_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// With fewer, bearings have no residuals.
const LEAST_BEACONS: usize = 4;
/// Before the data have told, degrees.
const FIRST_SIGMA_DEG: f64 = 0.5;

/// Errors of one way of solving.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Errors {
    /// Median distance to the true place, metres.
    pub median_m: f64,
    /// Median error of the heading, degrees.
    pub median_deg: f64,
    /// Sets without a solution.
    pub failed: usize,
}

/// A place.
#[derive(Debug, Clone, Serialize)]
pub struct Place {
    /// Where it is, metres.
    pub at_m: [f64; 2],
    /// Sets.
    pub sets: usize,
    /// Mean error of the solver: x, y in metres, heading in degrees. What does not scatter is a bias of the sensor there.
    pub bias: [f64; 3],
    /// Scatter about that, the same.
    pub scatter: [f64; 3],
    /// Of the solver.
    pub solver: Errors,
    /// Of the closed form.
    pub closed_form: Errors,
}

/// The whole.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Of a bearing, as its residuals say, degrees.
    pub sigma_deg: f64,
    /// Mean of the squared normalised error over three: the bearings carry a bias, which no covariance of one set knows.
    pub nees: f64,
    /// All places.
    pub solver: Errors,
    /// All places.
    pub closed_form: Errors,
    /// Each.
    pub places: Vec<Place>,
}

struct Set {
    place: usize,
    bearings_rad: Vec<f64>,
}

/// Replays a folder.
pub fn replay(folder: &Path) -> Result<Report, RecordedError> {
    let landmarks = folder.join("landmark.csv");
    let marks = files::table(&landmarks, 2, "x, y of a beacon in metres")?;
    if marks.len() < LEAST_BEACONS {
        let (file, value) = (landmarks.display().to_string(), format!("{} beacons", marks.len()));
        let want = "x, y of at least 4 beacons: three give a place, a fourth says how exact a bearing is";
        return Err(RecordedError::Format { file, line: None, value, want });
    }
    let marks: Vec<[f64; 2]> = marks.iter().map(|m| [m[0], m[1]]).collect();
    let files = files::named(folder, |name| place_of(name).is_some())?;
    let mut places = Vec::new();
    let mut sets = Vec::new();
    for path in &files {
        let Some(at_m) = path.file_name().and_then(|n| place_of(n.to_str()?)) else { continue };
        for row in files::table(path, marks.len(), "a bearing of each beacon in degrees")? {
            sets.push(Set { place: places.len(), bearings_rad: row.iter().map(|d| d.to_radians()).collect() });
        }
        places.push(at_m);
    }
    if sets.is_empty() {
        let (file, want) = (folder.display().to_string(), "files named (X1.5,Y3.0).csv");
        return Err(RecordedError::Format { file, line: None, value: "no set of bearings".into(), want });
    }
    // The residuals of a first pass say how exact a bearing is.
    let first: Vec<_> = sets.iter().filter_map(|s| by_solver(&marks, s, FIRST_SIGMA_DEG)).collect();
    let (chi2, dof) = first.iter().fold((0.0, 0), |(c, d), s| (c + s.chi2, d + s.dof));
    let sigma_deg = FIRST_SIGMA_DEG * (chi2 / f64::from(u32::try_from(dof.max(1)).unwrap_or(1))).sqrt();
    let solved: Vec<_> = sets.iter().map(|s| by_solver(&marks, s, sigma_deg)).collect();
    if solved.iter().all(Option::is_none) {
        let (file, value) = (folder.display().to_string(), "no set of bearings gives a pose".to_owned());
        let want = "beacons at places apart, and a bearing of each in degrees in its order";
        return Err(RecordedError::Format { file, line: None, value, want });
    }
    let closed: Vec<Option<Pose2>> = sets.iter().map(|s| resect(&seen(&marks, s))).collect();
    let nees: Vec<f64> = sets.iter().zip(&solved).filter_map(|(s, p)| p.as_ref()?.nees(places[s.place])).collect();
    let one = |k: Option<usize>| {
        let mine = || sets.iter().enumerate().filter(move |(_, s)| k.is_none_or(|k| s.place == k));
        let solver: Vec<Option<[f64; 3]>> =
            mine().map(|(n, s)| solved[n].as_ref().map(|p| error(&p.pose, places[s.place]))).collect();
        let closed: Vec<Option<[f64; 3]>> =
            mine().map(|(n, s)| closed[n].as_ref().map(|p| error(p, places[s.place]))).collect();
        (solver, closed)
    };
    let all = one(None);
    Ok(Report {
        sigma_deg,
        nees: nees.iter().sum::<f64>() / (3 * nees.len()).max(1) as f64,
        solver: errors(&all.0),
        closed_form: errors(&all.1),
        places: places
            .iter()
            .enumerate()
            .map(|(k, at_m)| {
                let (solver, closed) = one(Some(k));
                let (bias, scatter) = moments(&solver);
                let (sets, solver, closed_form) = (solver.len(), errors(&solver), errors(&closed));
                Place { at_m: *at_m, sets, bias, scatter, solver, closed_form }
            })
            .collect(),
    })
}

/// The place in a file's name, `(X1.5,Y3.0).csv`.
fn place_of(name: &str) -> Option<[f64; 2]> {
    let (x, y) = name.strip_prefix("(X")?.strip_suffix(").csv")?.split_once(",Y")?;
    Some([x.parse().ok()?, y.parse().ok()?])
}

fn seen(marks: &[[f64; 2]], set: &Set) -> Vec<([f64; 2], f64)> {
    marks.iter().copied().zip(set.bearings_rad.iter().copied()).collect()
}

struct Solved {
    pose: Pose2,
    covariance: nalgebra::Matrix3<f64>,
    chi2: f64,
    dof: usize,
}

impl Solved {
    fn nees(&self, at_m: [f64; 2]) -> Option<f64> {
        let e = error(&self.pose, at_m);
        let e = nalgebra::Vector3::new(e[0], e[1], e[2].to_radians());
        Some(e.dot(&self.covariance.cholesky()?.solve(&e)))
    }
}

fn by_solver(marks: &[[f64; 2]], set: &Set, sigma_deg: f64) -> Option<Solved> {
    let id = |k: usize| format!("m{}", k + 1);
    let landmarks: Vec<_> =
        marks.iter().enumerate().map(|(k, m)| json!({"id": id(k), "x_m": m[0], "y_m": m[1]})).collect();
    let bearings: Vec<_> = set.bearings_rad[..marks.len()]
        .iter()
        .enumerate()
        .map(|(k, b)| {
            json!({"observer": "sensor", "target": id(k), "bearing_deg": b.to_degrees(), "bearing_sigma_deg": sigma_deg})
        })
        .collect();
    let problem = json!({"robots": [{"id": "sensor"}], "landmarks": landmarks, "bearings": bearings});
    let solution = solve(Problem::parse(&problem.to_string()).ok()?);
    let robot = solution.robots.first()?;
    let c = robot.covariance?;
    Some(Solved {
        pose: Pose2::new(robot.x_m, robot.y_m, robot.heading_deg.to_radians()),
        covariance: nalgebra::Matrix3::from_fn(|r, k| c[r][k]),
        chi2: solution.chi2,
        dof: solution.dof,
    })
}

/// x, y in metres, heading in degrees.
fn error(pose: &Pose2, at_m: [f64; 2]) -> [f64; 3] {
    [pose.x_m - at_m[0], pose.y_m - at_m[1], wrap(pose.heading_rad - HEADING_RAD).to_degrees()]
}

fn errors(of: &[Option<[f64; 3]>]) -> Errors {
    let solved = || of.iter().flatten();
    Errors {
        median_m: median(solved().map(|e| e[0].hypot(e[1])).collect()),
        median_deg: median(solved().map(|e| e[2].abs()).collect()),
        failed: of.iter().filter(|e| e.is_none()).count(),
    }
}

fn moments(of: &[Option<[f64; 3]>]) -> ([f64; 3], [f64; 3]) {
    let n = of.iter().flatten().count().max(1) as f64;
    let mean = [0, 1, 2].map(|k| of.iter().flatten().map(|e| e[k]).sum::<f64>() / n);
    let spread = [0, 1, 2].map(|k| (of.iter().flatten().map(|e| (e[k] - mean[k]).powi(2)).sum::<f64>() / n).sqrt());
    (mean, spread)
}
