//! Bars that were missed or seen twice, against drawn truth.

use protocol::frames::Pose2;
use protocol::message::observation::FeaturePart;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::json;

use super::*;
use crate::solve::input::RawProblem;

const RADIUS_M: f64 = 0.2;
/// A tenth of a pixel of 1,080 columns.
const SIGMA_RAD: f64 = 5.8e-4;

/// What is wrong with what is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Nothing,
    Missed,
    Doubled,
}

/// How often what was said.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Count {
    draws: usize,
    answered: usize,
    /// Of the answered, beyond 4 σ in range or bearing, or with a wrong number.
    wrong: usize,
}

fn drawn(azimuths_deg: &[f64], ranges_m: [f64; 2], fault: Fault, draws: usize, seed: u64) -> Count {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let azimuths: Vec<f64> = azimuths_deg.iter().map(|a| a.to_radians()).collect();
    let marker = Marker::Bars {
        radius_m: RADIUS_M,
        azimuths_deg: azimuths_deg.to_vec(),
        height_m: [0.1, 0.5],
        code: None,
        look: None,
    };
    let mut count = Count::default();
    while count.draws < draws {
        let range_m = rng.random_range(ranges_m[0]..ranges_m[1]);
        let bearing: f64 = rng.random_range(-PI..PI);
        let peer = Pose2::new(range_m * bearing.cos(), range_m * bearing.sin(), rng.random_range(-PI..PI));
        let limb = (RADIUS_M / range_m).acos();
        let mut seen: Vec<(usize, f64)> = Vec::new();
        for feature in marker.features(&peer, 0.6) {
            let FeaturePart::Bar(Some(n)) = feature.part else { continue };
            let psi = wrap(bearing + PI - peer.heading_rad - azimuths[usize::from(n)]);
            // 10° from the outline a bar is no bar any more.
            if psi.abs() < limb - 0.175 {
                let noise: f64 = StandardNormal.sample(&mut rng);
                seen.push((usize::from(n), feature.bearing_rad + SIGMA_RAD * noise));
            }
        }
        let mut extra = None;
        match fault {
            Fault::Nothing => {}
            Fault::Missed => {
                if seen.len() > 2 {
                    seen.remove(rng.random_range(1..seen.len() - 1));
                }
            }
            Fault::Doubled => {
                let k = rng.random_range(0..seen.len().max(1));
                extra = seen.get(k).map(|s| s.1 + rng.random_range(3.0..20.0) * SIGMA_RAD);
            }
        }
        if seen.len() < 3 {
            continue;
        }
        count.draws += 1;
        let mut truth: Vec<Option<usize>> = seen.iter().map(|s| Some(s.0)).collect();
        let mut bearings: Vec<(f64, f64)> = seen.iter().map(|s| (wrap(s.1), SIGMA_RAD)).collect();
        if let Some(extra) = extra {
            truth.push(None);
            bearings.push((wrap(extra), SIGMA_RAD));
        }
        match number(&bearings, None, &azimuths, RADIUS_M) {
            Numbering::Open => {}
            Numbering::Turned([b, r]) => {
                count.answered += 1;
                let off = difference(b.0, bearing).abs() > 4.0 * b.1 || (r.0 - range_m).abs() > 4.0 * r.1;
                count.wrong += usize::from(off);
            }
            Numbering::Numbered(numbers) => {
                count.answered += 1;
                // Which of two bearings a few sigmas apart is the bar's own cannot be known.
                let alike =
                    |a: &Option<usize>, b: &Option<usize>| a == b || (extra.is_some() && (a.is_none() || b.is_none()));
                count.wrong += usize::from(!numbers.iter().zip(&truth).all(|(a, b)| alike(a, b)));
            }
        }
    }
    count
}

fn equal(n: usize) -> Vec<f64> {
    (0..n).map(|k| 360.0 * k as f64 / n as f64).collect()
}

const CODED: [f64; 8] = [0.0, 30.0, 75.0, 135.0, 165.0, 225.0, 285.0, 325.0];

#[test]
fn a_missed_or_doubled_bar_is_found_and_no_answer_is_confidently_wrong() {
    for (name, azimuths, least) in
        [("8 equal", equal(8), 0.0), ("8 uneven", CODED.to_vec(), 0.0), ("24", equal(24), 0.9)]
    {
        for fault in [Fault::Nothing, Fault::Missed, Fault::Doubled] {
            let count = drawn(&azimuths, [0.8, 2.5], fault, 120, 7);
            println!("{name} {fault:?}: {count:?}");
            assert!(count.wrong <= 1, "{name} {fault:?}: {count:?}");
            assert!(count.answered as f64 >= least * count.draws as f64, "{name} {fault:?}: {count:?}");
        }
    }
}

#[test]
#[ignore = "a measurement: cargo test -p team-leader --lib bars::tests::measure -- --ignored --nocapture"]
fn measure() {
    for (name, azimuths) in
        [("8 equal", equal(8)), ("8 uneven", CODED.to_vec()), ("12 equal", equal(12)), ("24 equal", equal(24))]
    {
        for ranges_m in [[0.6, 1.5], [1.5, 3.0], [3.0, 6.0]] {
            for fault in [Fault::Nothing, Fault::Missed, Fault::Doubled] {
                let c = drawn(&azimuths, ranges_m, fault, 2000, 11);
                println!(
                    "{name:9} {ranges_m:?} m {fault:?}: answered {:.1} %, wrong {} of {}",
                    100.0 * c.answered as f64 / c.draws as f64,
                    c.wrong,
                    c.answered
                );
            }
        }
    }
}

#[test]
fn a_file_without_numbers_is_solved_and_says_which_bar_is_none() {
    let azimuths_deg: Vec<f64> = equal(24).iter().map(|a| if *a == 45.0 { 49.0 } else { *a }).collect();
    let marker = Marker::Bars {
        radius_m: RADIUS_M,
        azimuths_deg: azimuths_deg.clone(),
        height_m: [0.1, 0.5],
        code: None,
        look: None,
    };
    let peer = Pose2::new(1.2, 0.5, -2.6);
    let mut features: Vec<serde_json::Value> = marker
        .features(&peer, 0.6)
        .iter()
        .map(|f| json!({"part": "bar", "index": null, "bearing_deg": f.bearing_rad.to_degrees(), "sigma_deg": 0.03}))
        .collect();
    features.remove(features.len() / 2);
    let doubled = features[2]["bearing_deg"].as_f64().unwrap() + 0.4;
    features.push(json!({"part": "bar", "index": null, "bearing_deg": doubled, "sigma_deg": 0.03}));
    let raw: RawProblem = serde_json::from_value(json!({
        "anchor": "r1",
        "robots": [{"id": "r1"}, {"id": "r2", "marker": {"kind": "bars", "radius_m": RADIUS_M, "azimuths_deg": azimuths_deg, "height_m": [0.1, 0.5]}}],
        "sightings": [{"observer": "r1", "peer": "r2", "features": features}],
        "bearings": []
    }))
    .unwrap();
    let solution = crate::solve::solve(Problem::check(&raw).unwrap());
    let r2 = solution.robots.iter().find(|r| r.id == "r2").unwrap();
    let away = (r2.x_m - 1.2).hypot(r2.y_m - 0.5);
    assert!(away < 0.02, "{away} {solution:?}");
    assert!(difference(r2.heading_deg.to_radians(), -2.6).abs() < 0.1, "{}", r2.heading_deg);
    assert!(solution.warnings.iter().any(|w| w.contains("1 are none of its bars")), "{:?}", solution.warnings);
}
