//! Checks on recordings; they need folders that are named in the environment and are ignored otherwise.

use std::path::Path;

use protocol::angle::{difference, wrap};
use protocol::message::{ObjectClass, TrackState};
use protocol::time::Timestamp;

use super::*;
use crate::capture::{self, CaptureOptions};
use crate::motion::{BackgroundState, MotionSettings, MotionStage};
use crate::optics::MountedCamera;
use crate::panorama::{Lut, PanoramaGeometry};

/// A recording's panoramas and capture times; unwrapped once and kept beside the frames.
fn panoramas(dir: &Path, lut: &Lut, pixels: usize) -> Vec<(f64, Vec<u8>)> {
    let cache = dir.join("panoramas.raw");
    let times: Vec<f64> = std::fs::read_to_string(dir.join("frames/frames.csv"))
        .unwrap()
        .lines()
        .skip(1)
        .map(|l| l.split(',').nth(1).unwrap().trim().parse::<f64>().unwrap() * 1e-9)
        .collect();
    if !cache.exists() {
        let mut all = Vec::new();
        let mut source = capture::open(dir, CaptureOptions::default()).unwrap();
        while let Some(frame) = source.next_frame() {
            let mut out = vec![0; pixels];
            lut.unwarp(&frame.unwrap().gray, &mut out).unwrap();
            all.extend(out);
        }
        std::fs::write(&cache, all).unwrap();
    }
    let all = std::fs::read(&cache).unwrap();
    times.into_iter().zip(all.chunks_exact(pixels).map(<[u8]>::to_vec)).collect()
}

/// Fellow robots in each frame, found once and kept beside the frames.
fn peers(
    dir: &Path,
    robot: &Path,
    camera: &MountedCamera,
    geometry: &PanoramaGeometry,
    lut: &Lut,
) -> Vec<Vec<PeerBearing>> {
    let cache = robot.join("peers.json");
    if !cache.exists() {
        let markers = [serde_json::from_str(&std::fs::read_to_string(dir.join("markers.json")).unwrap()).unwrap()];
        let grid = crate::peers::Grid::of(geometry).unwrap();
        let mut detector = crate::peers::PeerDetector::new(camera, grid, &markers);
        let mut source = capture::open(robot, CaptureOptions::default()).unwrap();
        let mut panorama = vec![0; geometry.pixels()];
        let mut all: Vec<Vec<[f64; 2]>> = Vec::new();
        while let Some(frame) = source.next_frame() {
            let frame = frame.unwrap();
            lut.unwarp(&frame.gray, &mut panorama).unwrap();
            let found = detector.follow(&frame.gray, &panorama, frame.capture);
            all.push(
                found
                    .iter()
                    .map(|p| PeerBearing::of(&p.to_sighting()))
                    .map(|p| [p.bearing_rad, p.half_width_rad])
                    .collect(),
            );
        }
        std::fs::write(&cache, serde_json::to_string(&all).unwrap()).unwrap();
    }
    let all: Vec<Vec<[f64; 2]>> = serde_json::from_str(&std::fs::read_to_string(cache).unwrap()).unwrap();
    all.into_iter()
        .map(|f| {
            f.into_iter().map(|[bearing_rad, half_width_rad]| PeerBearing { bearing_rad, half_width_rad }).collect()
        })
        .collect()
}

fn view_bearing_deg(tracker: &Tracker, column: f64) -> f64 {
    tracker.view().angles_rad(column, 80.0).map_or(f64::NAN, |(b, _)| b.to_degrees().round())
}

#[derive(Debug, Clone)]
struct Person {
    id: String,
    x: f64,
    y: f64,
    height: f64,
    visible: f64,
}

/// Pose of a robot and the people, interpolated.
fn truth_at(truth: &[serde_json::Value], robot: &str, t: f64) -> (f64, f64, f64, Vec<Person>) {
    let i = ((t / 0.05).floor().max(0.0) as usize).min(truth.len() - 2);
    let part = (t - truth[i]["time_s"].as_f64().unwrap()) / 0.05;
    let pick = |line: &serde_json::Value| {
        let r = line["robots"].as_array().unwrap().iter().find(|r| r["id"] == robot).unwrap();
        let v = |k: &str| r[k].as_f64().unwrap();
        (v("x_m"), v("y_m"), v("heading_deg").to_radians())
    };
    let (a, b) = (pick(&truth[i]), pick(&truth[i + 1]));
    let mix = |a: f64, b: f64| a + part * (b - a);
    let people = truth[i]["people"]
        .as_array()
        .unwrap()
        .iter()
        .zip(truth[i + 1]["people"].as_array().unwrap())
        .map(|(p, q)| {
            let v = |k: &str| mix(p[k].as_f64().unwrap(), q[k].as_f64().unwrap());
            Person {
                id: p["id"].as_str().unwrap().to_owned(),
                x: v("x_m"),
                y: v("y_m"),
                height: v("height_m"),
                visible: p["visible_fraction"][robot].as_f64().unwrap(),
            }
        })
        .collect();
    (mix(a.0, b.0), mix(a.1, b.1), wrap(a.2 + part * difference(b.2, a.2)), people)
}

/// Changes between values that last for five entries each.
fn lasting_changes(values: &[String]) -> usize {
    let runs: Vec<&[String]> = values.chunk_by(|a, b| a == b).filter(|run| run.len() >= 5).collect();
    runs.windows(2).filter(|w| w[0][0] != w[1][0]).count()
}

#[test]
#[ignore = "needs RECORDING: a folder written by `sim-harness record`"]
fn recorded_robots_see_the_people() {
    let dir = std::env::var("RECORDING").expect("RECORDING names a folder");
    let dir = Path::new(&dir);
    let dump = std::env::var("DUMP").ok();
    let dumped: Vec<usize> =
        std::env::var("FRAMES").unwrap_or_default().split(',').filter_map(|s| s.parse().ok()).collect();
    let truth: Vec<serde_json::Value> = std::fs::read_to_string(dir.join("truth.jsonl"))
        .unwrap()
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    for robot in std::env::var("ROBOTS").unwrap_or("r1,r2,r3".into()).split(',') {
        let camera = MountedCamera::load(&dir.join(robot).join("camera.toml")).unwrap();
        let geometry = PanoramaGeometry::for_camera(&camera).unwrap();
        let lut = Lut::panorama(&camera, &geometry);
        let raster = Raster { width: geometry.width() as usize, height: geometry.height() as usize, wraps: true };
        let valid: Vec<u8> = lut.valid().iter().map(|&v| u8::from(v)).collect();
        let frames = panoramas(&dir.join(robot), &lut, raster.len());
        let found_peers = peers(dir, &dir.join(robot), &camera, &geometry, &lut);
        let view = View::panorama(geometry, &camera);
        let settings = MotionSettings { upright_row: view.upright_row(), ..MotionSettings::default() };
        let mut motion = MotionStage::new(raster, Some(&valid), settings).unwrap();
        let mut tracker = Tracker::new(raster, view, TrackerSettings::default());
        let gallery = crate::picture::Gallery::new(raster);

        let (mut wanted, mut covered, mut merged, mut falses, mut switches) = (0, 0, 0, 0, 0);
        let mut by_support: Vec<(f64, f64, f64, TrackState, f64)> = Vec::new();
        let mut errors: Vec<(f64, f64, f64)> = Vec::new(); // error, sigma, time
        let mut group_errors: Vec<(f64, f64)> = Vec::new();
        let mut ranges: Vec<(f64, f64, f64)> = Vec::new();
        let mut widths: Vec<(f64, f64)> = Vec::new();
        let mut names: std::collections::BTreeMap<String, TrackId> = Default::default();
        // Of each track the people, and of each person the tracks, one entry a frame in which it was seen alone.
        let mut followed: std::collections::BTreeMap<String, Vec<String>> = Default::default();
        let mut spent = [f64::INFINITY; 4];
        let mut motions = String::new();
        let mut missed_by: std::collections::BTreeMap<String, u32> = Default::default();
        let limit = std::env::var("LIMIT").map_or(usize::MAX, |v| v.parse().unwrap());
        for (i, (stamp, picture)) in frames.iter().enumerate().take(limit) {
            let capture = Timestamp::from_secs_f64(*stamp);
            let clock = std::time::Instant::now();
            let mut laps = Vec::new();
            let change = motion.change(picture, capture).unwrap();
            laps.push(clock.elapsed().as_secs_f64());
            motion.extract();
            laps.push(clock.elapsed().as_secs_f64());
            if change.background == BackgroundState::Ready {
                let before = i.checked_sub(1).map_or(&[][..], |b| &found_peers[b]);
                tracker.step(&motion.scene(), capture, before);
                laps.push(clock.elapsed().as_secs_f64());
                motion.learn(tracker.holds());
            } else {
                tracker.suspend(capture);
                laps.push(clock.elapsed().as_secs_f64());
            }
            laps.push(clock.elapsed().as_secs_f64());
            if change.background == BackgroundState::Ready {
                for k in 0..4 {
                    // The least over the frames: other programs run beside.
                    let lap = laps[k] - if k > 0 { laps[k - 1] } else { 0.0 };
                    spent[k] = spent[k].min(lap);
                }
            }
            motions.push(match change.motion {
                protocol::message::Motion::Standing => '.',
                protocol::message::Motion::Moving => 'M',
                protocol::message::Motion::Turning => 'T',
                _ => '?',
            });
            if let Some(alarm) = &change.alarm {
                eprintln!("{robot} frame {i}: {alarm:?}");
            }
            let tracks = tracker.tracks();
            let t = stamp - 1.0;
            let (rx, ry, rh, people) = truth_at(&truth, robot, t);
            let bearing = |p: &Person| wrap((p.y - ry).atan2(p.x - rx) - rh);
            if let Some(dump) = dump.as_ref().filter(|_| dumped.contains(&i)) {
                let mut annotated = gallery.panorama(picture, &tracks, tracker.view());
                let mask: Vec<u8> = motion.scene().mask.iter().map(|m| m * 255).collect();
                let mask = image::GrayImage::from_raw(raster.width as u32, raster.height as u32, mask).unwrap();
                let ground = image::GrayImage::from_raw(raster.width as u32, raster.height as u32, motion.background());
                let (w, h) = (annotated.width(), annotated.height());
                for p in &people {
                    let x = (geometry.column_of_bearing(bearing(p)) * f64::from(w) / raster.width as f64) as u32;
                    for y in h - 30..h {
                        for dx in 0..3 {
                            annotated.put_pixel((x + dx).min(w - 1), y, image::Rgb([255, 0, 0]));
                        }
                    }
                }
                let mut all = image::RgbImage::new(w, h + 2 * 162 + 4);
                image::imageops::replace(&mut all, &annotated, 0, 0);
                let mask = image::DynamicImage::from(mask).into_rgb8();
                image::imageops::replace(&mut all, &mask, 0, i64::from(h));
                let ground = image::DynamicImage::from(ground.unwrap()).into_rgb8();
                image::imageops::replace(&mut all, &ground, 1080, i64::from(h));
                all.save(format!("{dump}/{robot}-{i:04}.png")).unwrap();
            }
            if t < 5.0 || change.background != BackgroundState::Ready {
                continue;
            }
            // Optimal matching within three degrees.
            let costs: Vec<Vec<f64>> = people
                .iter()
                .map(|p| {
                    let half = (0.3 / (p.x - rx).hypot(p.y - ry)).atan().to_degrees();
                    tracks
                        .iter()
                        .map(|t| difference(t.bearing_rad, bearing(p)).to_degrees().abs() / half.max(2.0))
                        .collect()
                })
                .collect();
            let matched = assign(&costs, 1.0);
            for ((p, found), _) in people.iter().zip(&matched).zip(0..) {
                if p.visible < 0.5 {
                    continue;
                }
                wanted += 1;
                let Some(found) = *found else {
                    *missed_by.entry(p.id.clone()).or_default() += 1;
                    if std::env::var("MISSED").is_ok() && i % 5 == 0 {
                        let near: Vec<String> = tracker
                            .tracks
                            .iter()
                            .filter(|t| {
                                let at = view_bearing_deg(&tracker, t.filter.column);
                                difference(at.to_radians(), bearing(p)).abs() < 0.3
                            })
                            .map(|t| {
                                format!(
                                    "{}:{:?}{} {}° {:.1}m hits {} miss {} moving {} trav {:.0} evidence {:.2}",
                                    t.id,
                                    t.state,
                                    if t.confirmed { "" } else { "?" },
                                    view_bearing_deg(&tracker, t.filter.column),
                                    t.log_range.exp(),
                                    t.hits,
                                    t.misses,
                                    t.moving_hits,
                                    t.travelled,
                                    t.evidence
                                )
                            })
                            .collect();
                        eprintln!(
                            "{robot} {i} missed {} at {:.0}° {:.1} m; {near:?}",
                            p.id,
                            bearing(p).to_degrees(),
                            (p.x - rx).hypot(p.y - ry)
                        );
                    }
                    continue;
                };
                covered += 1;
                let track = &tracks[found];
                if let Some(old) = names.insert(p.id.clone(), track.id).filter(|old| *old != track.id) {
                    switches += 1;
                    if std::env::var("SWITCHES").is_ok() {
                        let before = tracker.tracks.iter().find(|t| t.id == old).map(|t| {
                            (t.state, view_bearing_deg(&tracker, t.filter.column), t.log_range.exp(), t.misses)
                        });
                        let now = tracker
                            .tracks
                            .iter()
                            .find(|t| t.id == track.id)
                            .map(|t| (t.state, t.hits, t.log_range.exp()));
                        eprintln!(
                            "{robot} {i} switch of {} at {:.0}° {:.1} m: {old} {before:?} to {} at {:.0}° {now:?}",
                            p.id,
                            bearing(p).to_degrees(),
                            (p.x - rx).hypot(p.y - ry),
                            track.id,
                            track.bearing_rad.to_degrees()
                        );
                    }
                }
                let error = difference(track.bearing_rad, bearing(p));
                let distance = (p.x - rx).hypot(p.y - ry);
                if let Some(t) = tracker.tracks.iter().find(|t| t.id == track.id && track.state != TrackState::Hidden) {
                    by_support.push((
                        t.support,
                        t.evidence,
                        error / track.bearing_sigma_rad,
                        track.state,
                        error * distance,
                    ));
                }
                if std::env::var("MISSED").is_ok() && (error / track.bearing_sigma_rad).abs() > 4.0 {
                    eprintln!(
                        "{robot} {i} {:?} track {} of {} at {:.1} m off {:.1}° sigma {:.1}° w {} rows {:?}",
                        track.state,
                        track.id,
                        p.id,
                        distance,
                        error.to_degrees(),
                        track.bearing_sigma_rad.to_degrees(),
                        track.arc.width,
                        track.rows
                    );
                }
                if track.state == TrackState::Visible && !track.doubtful {
                    followed.entry(track.id.0.to_string()).or_default().push(p.id.clone());
                    followed.entry(p.id.clone()).or_default().push(track.id.0.to_string());
                }
                if track.state == TrackState::Visible {
                    errors.push((error, track.bearing_sigma_rad, t));
                    widths.push((error * distance, distance));
                    if let Some(r) = track.extent.range {
                        ranges.push((r.range_m - distance, r.sigma_m, distance));
                    }
                    let _ = p.height;
                } else {
                    merged += 1;
                    group_errors.push((error, track.bearing_sigma_rad));
                }
            }
            if std::env::var("FALSE").is_ok() && i % 10 == 0 {
                let used: Vec<usize> = matched.iter().flatten().copied().collect();
                for (_, t) in tracks.iter().enumerate().filter(|(k, _)| !used.contains(k)) {
                    let nearest = people
                        .iter()
                        .map(|p| (difference(t.bearing_rad, bearing(p)).to_degrees(), p))
                        .min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                        .unwrap();
                    eprintln!(
                        "{robot} {i} false {} {:?} {:?} {:.0}° w {} rows {:?}; {} off {:.1}° at {:.1} m",
                        t.id,
                        t.state,
                        t.class,
                        t.bearing_rad.to_degrees(),
                        t.arc.width,
                        t.rows,
                        nearest.1.id,
                        nearest.0,
                        (nearest.1.x - rx).hypot(nearest.1.y - ry),
                    );
                }
            }
            let used: Vec<usize> = matched.iter().flatten().copied().collect();
            falses += (0..tracks.len())
                .filter(|k| !used.contains(k) && tracks[*k].class == ObjectClass::Person)
                .filter(|k| tracks[*k].state == TrackState::Visible)
                .count();
        }
        let rms = |v: &[f64]| (v.iter().map(|e| e * e).sum::<f64>() / v.len().max(1) as f64).sqrt();
        let nees = |v: &[(f64, f64)]| v.iter().map(|(e, s)| e * e / s / s).sum::<f64>() / v.len().max(1) as f64;
        let alone: Vec<(f64, f64)> = errors.iter().map(|(e, s, _)| (*e, *s)).collect();
        let mean = alone.iter().map(|(e, _)| e).sum::<f64>() / alone.len().max(1) as f64;
        eprintln!("{robot} {motions}");
        eprintln!(
            "{robot}: coverage {:.3} ({covered}/{wanted}, {merged} not alone), false {falses}, switches {switches}, missed {missed_by:?}",
            f64::from(covered) / f64::from(wanted)
        );
        let changes = |of_people: bool| -> usize {
            followed.iter().filter(|(k, _)| k.starts_with('p') == of_people).map(|(_, v)| lasting_changes(v)).sum()
        };
        eprintln!(
            "{robot}: tracks change person {} times, people change track {} times",
            changes(false),
            changes(true)
        );
        let mut sorted: Vec<f64> = alone.iter().map(|(e, _)| e.abs().to_degrees()).collect();
        sorted.sort_by(f64::total_cmp);
        let q = |p: f64| sorted.get((p * sorted.len() as f64) as usize).copied().unwrap_or(f64::NAN);
        eprintln!(
            "{robot}: bearing rms {:.2}° mean {:.2}° median {:.2}° 90% {:.2}° 99% {:.2}°, NEES {:.2}, lateral rms {:.3} m; merged rms {:.2}° NEES {:.2}",
            rms(&alone.iter().map(|e| e.0).collect::<Vec<_>>()).to_degrees(),
            mean.to_degrees(),
            q(0.5),
            q(0.9),
            q(0.99),
            nees(&alone),
            rms(&widths.iter().map(|e| e.0).collect::<Vec<_>>()),
            rms(&group_errors.iter().map(|e| e.0).collect::<Vec<_>>()).to_degrees(),
            nees(&group_errors),
        );
        for state in [TrackState::Visible, TrackState::Merged] {
            for (name, pick) in [("support", 0), ("evidence", 1)] {
                let text: Vec<String> = [-9.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2]
                    .windows(2)
                    .map(|w| {
                        let value = |r: &&(f64, f64, f64, TrackState, f64)| if pick == 0 { r.0 } else { r.1 };
                        let rows: Vec<_> =
                            by_support.iter().filter(|r| r.3 == state && (w[0]..w[1]).contains(&value(r))).collect();
                        let n = rows.len().max(1) as f64;
                        let nis = rows.iter().map(|r| r.2 * r.2).sum::<f64>() / n;
                        let lateral = (rows.iter().map(|r| r.4 * r.4).sum::<f64>() / n).sqrt();
                        format!("<{}: {} NIS {nis:.2} {:.0} cm", w[1], rows.len(), lateral * 100.0)
                    })
                    .collect();
                eprintln!("{robot}: by {name} {state:?}: {}", text.join("; "));
            }
        }
        let range_pairs: Vec<(f64, f64)> = ranges.iter().map(|(e, s, _)| (*e, *s)).collect();
        let range_mean = range_pairs.iter().map(|e| e.0).sum::<f64>() / range_pairs.len().max(1) as f64;
        eprintln!(
            "{robot}: {} ranges, rms {:.2} m mean {range_mean:.2} m NEES {:.2}; least ms a frame: change {:.2} extract {:.2} track {:.2} learn {:.2}",
            ranges.len(),
            rms(&range_pairs.iter().map(|e| e.0).collect::<Vec<_>>()),
            nees(&range_pairs),
            spent[0] * 1e3,
            spent[1] * 1e3,
            spent[2] * 1e3,
            spent[3] * 1e3,
        );
    }
}
