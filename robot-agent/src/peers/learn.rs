//! A look learnt from pictures of the robot.
//!
//! Problem: nobody measures the rings of a robot that exists already, and what a lamp and a paint look like to a camera is not
//! what the tin says. Insight: at a known place every pixel of a round body has a height, and rings are a function of the height
//! alone; what else there is, is each column's own light. Algorithm: the picture is a product light(column) · paint(height), solved
//! by alternating least squares over all pictures; the paint is cut into the rings that explain it best (least squares over all
//! cuts); each cut is put where the paint passes half way between its two rings, which no blur moves. With what was learnt the
//! bearing is measured anew, since hands measure it badly, and the whole repeated.

use protocol::marker::{Look, Marker, Ring};

use super::geometry::Cylinder;
use super::look::{CylinderLook, MAX_RINGS};
use super::rays::{PixelRays, Sample};
use super::rings::{self, median};
use crate::optics::MountedCamera;

/// Heights are told apart to this, metres.
const BIN_M: f64 = 0.004;
/// Pixels so near to the outline (sine of the angle of incidence) or to the painted part's ends are left out: metres, pixels.
const WIDEST_SINE: f64 = 0.75;
const END_PX: f64 = 1.5;
/// Rounds of alternating least squares, and of measuring the bearing anew.
const ROUNDS: usize = 12;
const BEARINGS: usize = 3;
/// A ring is at least so high, metres and pixels of the picture that shows it best.
const LEAST_RING_M: f64 = 0.02;
const LEAST_RING_PX: f64 = 3.0;
/// A further ring explains at least this part of what rings can explain.
const LEAST_WORTH: f64 = 0.015;
/// Two rings side by side differ by this part of full scale, and the darkest and the brightest by this.
const LEAST_STEP: f64 = 0.08;
const LEAST_CONTRAST: f64 = 0.25;
/// What pixels differ from the rings, as a part of the contrast: beyond, the paint is another one further round.
const MOST_REST: f64 = 0.15;
/// Reflectance that the brightest ring is given: only ratios can be seen.
const BRIGHTEST: f64 = 0.85;
/// Least pixels of all pictures, and part of the heights that are seen at all.
const LEAST_PIXELS: usize = 200;
const LEAST_SEEN: f64 = 0.9;

/// A picture of the robot at a known place.
#[derive(Debug, Clone, Copy)]
pub struct KnownView<'a> {
    /// The camera's picture.
    pub raw: &'a [u8],
    /// To the robot's axis, body frame, radians; right to a few centimetres.
    pub bearing_rad: f64,
    /// To the axis along the floor, metres.
    pub range_m: f64,
}

/// What was learnt.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt {
    /// A cylinder with rings.
    pub marker: Marker,
    /// RMS difference of the pixels from the rings, as a part of the contrast.
    pub rest: f64,
    /// Bearing of each view as measured with the look, radians.
    pub bearings_rad: Vec<f64>,
}

/// Why nothing could be learnt.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// The painted part is not in the pictures, or the place is wrong.
    #[error(
        "only {pixels} pixels show heights from {:.2} to {:.2} m at the places given, and {:.0} % of these heights are seen; pictures \
         from further away would be right (2 to 3 m), all of the painted part in view",
        height_m[0], height_m[1], 100.0 * seen
    )]
    OutOfView {
        /// Of all pictures.
        pixels: usize,
        /// Share of the heights.
        seen: f64,
        /// What was asked for.
        height_m: [f64; 2],
    },
    /// One grey all over.
    #[error(
        "the body shows no rings: {contrast:.2} of full scale between its darkest and its brightest part; paint or tape in black and white would be right"
    )]
    NoRings {
        /// Of full scale.
        contrast: f64,
    },
    /// Not rings.
    #[error(
        "the body's paint is no rings: pixels of one height differ by {rest:.2} of the contrast; is the place right, does nobody stand before it, is it painted alike all round?"
    )]
    NotRound {
        /// RMS, as a part of the contrast.
        rest: f64,
    },
}

/// Learns the rings of a body of this radius whose painted part is between two heights, metres.
///
/// # Errors
/// [`LearnError`], which says what other pictures would be right.
pub fn learn(
    camera: &MountedCamera,
    views: &[KnownView<'_>],
    radius_m: f64,
    height_m: [f64; 2],
) -> Result<Learnt, LearnError> {
    let mut rays = PixelRays::new(camera.image_size_px());
    let mut bearings_rad: Vec<f64> = views.iter().map(|view| view.bearing_rad).collect();
    let mut learnt = None;
    for _ in 0..BEARINGS {
        let sheets: Vec<Sheet> = views
            .iter()
            .zip(&bearings_rad)
            .map(|(view, bearing)| Sheet::new(camera, &mut rays, view, *bearing, radius_m, height_m))
            .collect();
        let (rings, rest) = rings_of(&sheets, height_m)?;
        let look = Some(Look { rings, bar_width_deg: None, beacon: None });
        let marker = Marker::Cylinder { radius_m, height_m, look };
        if let Ok(look) = CylinderLook::from_marker(&marker, None) {
            for (sheet, (view, bearing)) in sheets.iter().zip(views.iter().zip(&mut bearings_rad)) {
                let fit = rings::fit(&sheet.samples, &look, (*bearing, view.range_m), 0.0, false);
                *bearing = fit.map_or(*bearing, |fit| fit.bearing_rad);
            }
        }
        learnt = Some((marker, rest));
    }
    match learnt {
        Some((_, rest)) if rest > MOST_REST => Err(LearnError::NotRound { rest }),
        Some((marker, rest)) => Ok(Learnt { marker, rest, bearings_rad }),
        None => Err(LearnError::NoRings { contrast: 0.0 }),
    }
}

/// The body's surface in one picture.
struct Sheet {
    samples: Vec<Sample>,
    /// Column, bin of height, grey level.
    pixels: Vec<(usize, usize, f64)>,
    columns: usize,
    /// Height of a pixel, metres.
    m_per_px: f64,
}

impl Sheet {
    fn new(
        camera: &MountedCamera,
        rays: &mut PixelRays,
        view: &KnownView<'_>,
        bearing_rad: f64,
        radius_m: f64,
        [low, high]: [f64; 2],
    ) -> Self {
        let cylinder = Cylinder::new(bearing_rad, view.range_m.max(1.01 * radius_m), radius_m);
        let near = cylinder.range_m - radius_m;
        let camera_m = camera.viewpoint_body_m().z;
        let [lowest, highest] = camera.camera().elevation_rad();
        let ends = [(low - camera_m).atan2(near), (low - camera_m).atan2(cylinder.range_m)];
        let tops = [(high - camera_m).atan2(near), (high - camera_m).atan2(cylinder.range_m)];
        let elevation = [
            (ends[0].min(ends[1]) - 0.02).clamp(lowest, highest),
            (tops[0].max(tops[1]) + 0.02).clamp(lowest, highest),
        ];
        let mut samples = Vec::new();
        let [w, h] = camera.image_size_px();
        if view.raw.len() == w as usize * h as usize {
            rays.patch(camera, view.raw, bearing_rad, 1.2 * cylinder.outline_rad + 0.03, elevation, &mut samples);
        }
        let mut sheet = Self { samples: Vec::new(), pixels: Vec::new(), columns: 0, m_per_px: f64::INFINITY };
        for sample in &samples {
            let met = cylinder.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(met.distance_m);
            let end_m = END_PX * m_per_px;
            if met.sine.abs() > WIDEST_SINE || met.height_m < low + end_m || met.height_m > high - end_m {
                continue;
            }
            let column = ((met.aside_rad + cylinder.outline_rad) * f64::from(sample.ray.px_per_bearing)) as usize;
            sheet.columns = sheet.columns.max(column + 1);
            sheet.m_per_px = sheet.m_per_px.min(m_per_px);
            sheet.pixels.push((column, ((met.height_m - low) / BIN_M) as usize, sample.gray));
        }
        sheet.samples = samples;
        sheet
    }
}

/// The paint by height: how much of the light it gives back, and how many pixels say so.
struct Paint {
    level: Vec<f64>,
    weight: Vec<f64>,
}

/// Rings that explain the pictures, and what they leave unexplained as a part of the contrast.
fn rings_of(sheets: &[Sheet], height_m: [f64; 2]) -> Result<(Vec<Ring>, f64), LearnError> {
    let bins = ((height_m[1] - height_m[0]) / BIN_M).ceil().max(1.0) as usize;
    let pixels: usize = sheets.iter().map(|sheet| sheet.pixels.len()).sum();
    let (paint, light) = product(sheets, bins);
    // What the ends of the painted part hide by their blur is not asked for.
    let m_per_px = sheets.iter().map(|sheet| sheet.m_per_px).fold(f64::INFINITY, f64::min);
    let hidden = (2.0 * END_PX * m_per_px / BIN_M).ceil().min(bins as f64) as usize + 1;
    let seen = paint.weight.iter().filter(|w| **w > 0.0).count() as f64 / bins.saturating_sub(hidden).max(1) as f64;
    if pixels < LEAST_PIXELS || seen < LEAST_SEEN {
        return Err(LearnError::OutOfView { pixels, seen: seen.min(1.0), height_m });
    }
    let shortest = ((LEAST_RING_M.max(LEAST_RING_PX * m_per_px)) / BIN_M).ceil() as usize;
    let mut cuts = cuts(&paint, shortest);
    let mut levels = levels(&paint, &cuts, shortest);
    let full = levels.iter().copied().fold(0.0, f64::max).max(1e-9);
    // Neighbours that hardly differ are one ring.
    while let Some(k) = (1..levels.len()).find(|k| (levels[*k] - levels[k - 1]).abs() < LEAST_STEP * full) {
        cuts.remove(k);
        levels = self::levels(&paint, &cuts, shortest);
    }
    let darkest = levels.iter().copied().fold(f64::INFINITY, f64::min);
    let contrast = 1.0 - darkest / full;
    if levels.len() < 2 || contrast < LEAST_CONTRAST {
        return Err(LearnError::NoRings { contrast: if levels.len() < 2 { 0.0 } else { contrast } });
    }
    let mut edges_m = vec![height_m[0]];
    edges_m.extend((1..levels.len()).map(|k| height_m[0] + BIN_M * half_way(&paint, &cuts, &levels, k)));
    edges_m.push(height_m[1]);
    let ring = |k: usize| Ring {
        height_m: [edges_m[k], edges_m[k + 1]].map(|m| (1e4 * m).round() / 1e4),
        reflectance: (1e3 * BRIGHTEST * levels[k] / full).round() / 1e3,
    };
    let rest = rest(sheets, &light, &cuts, &levels, m_per_px) / (full - darkest);
    Ok(((0..levels.len()).map(ring).collect(), rest))
}

/// Light of each column of each picture (mean 1) and paint of each height by alternating least squares.
fn product(sheets: &[Sheet], bins: usize) -> (Paint, Vec<Vec<f64>>) {
    let mut light: Vec<Vec<f64>> = sheets.iter().map(|sheet| vec![1.0; sheet.columns]).collect();
    let mut paint = Paint { level: vec![0.0; bins], weight: vec![0.0; bins] };
    for _ in 0..ROUNDS {
        let (mut sums, mut squares) = (vec![0.0; bins], vec![0.0; bins]);
        paint.weight.fill(0.0);
        for (sheet, light) in sheets.iter().zip(&light) {
            for (column, bin, gray) in &sheet.pixels {
                let bin = (*bin).min(bins - 1);
                sums[bin] += light[*column] * gray;
                squares[bin] += light[*column] * light[*column];
                paint.weight[bin] += 1.0;
            }
        }
        for ((level, sum), square) in paint.level.iter_mut().zip(&sums).zip(&squares) {
            *level = if *square > 0.0 { sum / square } else { 0.0 };
        }
        for (sheet, light) in sheets.iter().zip(&mut light) {
            let mut sums = vec![[0.0; 2]; sheet.columns];
            for (column, bin, gray) in &sheet.pixels {
                let level = paint.level[(*bin).min(bins - 1)];
                sums[*column][0] += level * gray;
                sums[*column][1] += level * level;
            }
            for (light, [sum, square]) in light.iter_mut().zip(sums) {
                *light = if square > 0.0 { sum / square } else { 1.0 };
            }
            let mean = light.iter().sum::<f64>() / light.len().max(1) as f64;
            light.iter_mut().for_each(|light| *light /= mean.max(1e-9));
        }
    }
    (paint, light)
}

/// Where rings begin (bins), from the bottom up, the first at 0: least squares over all cuts with no piece shorter than `shortest`,
/// as many as are worth it.
fn cuts(paint: &Paint, shortest: usize) -> Vec<usize> {
    let n = paint.level.len();
    let mut sums = vec![[0.0; 3]; n + 1];
    for (k, (level, weight)) in paint.level.iter().zip(&paint.weight).enumerate() {
        let of = [*weight, weight * level, weight * level * level];
        sums[k + 1] = [0, 1, 2].map(|i| sums[k][i] + of[i]);
    }
    let cost = |from: usize, to: usize| {
        let [w, s, q] = [0, 1, 2].map(|i| sums[to][i] - sums[from][i]);
        if w > 0.0 { (q - s * s / w).max(0.0) } else { 0.0 }
    };
    let shortest = shortest.max(1);
    let mut best: Vec<Vec<(f64, usize)>> = vec![(0..=n).map(|to| (cost(0, to), 0)).collect()];
    for pieces in 1..MAX_RINGS {
        let before = &best[pieces - 1];
        let next = (0..=n)
            .map(|to| {
                let from = (pieces * shortest..(to + 1).saturating_sub(shortest))
                    .map(|from| (before[from].0 + cost(from, to), from));
                from.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0))
            })
            .collect();
        best.push(next);
    }
    let whole = best[0][n].0;
    let worth = |k: &usize| best[k - 1][n].0 - best[*k][n].0 > LEAST_WORTH * whole;
    let count = (1..MAX_RINGS).take_while(|k| best[*k][n].0.is_finite()).filter(worth).last().unwrap_or(0);
    let mut cuts = vec![0; count + 1];
    let mut to = n;
    for k in (1..=count).rev() {
        to = best[k][to].1;
        cuts[k] = to;
    }
    cuts
}

/// Level of each ring: of its inner half where it is high enough, so that blur does not count.
fn levels(paint: &Paint, cuts: &[usize], shortest: usize) -> Vec<f64> {
    let ends = cuts.iter().skip(1).copied().chain([paint.level.len()]);
    let level = |(from, to): (usize, usize)| {
        let inside = (shortest / 3).min((to - from) / 4);
        let bins = from + inside..to - inside;
        let mut seen: Vec<f64> = bins.filter(|k| paint.weight[*k] > 0.0).map(|k| paint.level[k]).collect();
        median(&mut seen)
    };
    cuts.iter().copied().zip(ends).map(level).collect()
}

/// Bin (with its part) in which the paint passes half way from ring `k − 1` to ring `k`, near their cut.
fn half_way(paint: &Paint, cuts: &[usize], levels: &[f64], k: usize) -> f64 {
    let half = 0.5 * (levels[k - 1] + levels[k]);
    let rises = levels[k] > levels[k - 1];
    let seen: Vec<usize> = (0..paint.level.len()).filter(|n| paint.weight[*n] > 0.0).collect();
    let crossing = |pair: &[usize]| {
        let [a, b] = [pair[0], pair[1]].map(|n| if rises { paint.level[n] - half } else { half - paint.level[n] });
        (a <= 0.0 && b > 0.0).then(|| pair[0] as f64 + 0.5 - a / (b - a) * (pair[1] - pair[0]) as f64)
    };
    let away = |x: &f64| (x - cuts[k] as f64).abs();
    let crossings = seen.windows(2).filter_map(crossing);
    crossings.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(cuts[k] as f64)
}

/// RMS difference of pixels from their ring in the mean light, away from the cuts.
fn rest(sheets: &[Sheet], light: &[Vec<f64>], cuts: &[usize], levels: &[f64], m_per_px: f64) -> f64 {
    let beside = (2.0 * m_per_px / BIN_M).ceil() as usize;
    let (mut sum, mut n) = (0.0, 0.0);
    for (sheet, light) in sheets.iter().zip(light) {
        let beside = beside.max((2.0 * sheet.m_per_px / BIN_M).ceil() as usize);
        for (column, bin, gray) in &sheet.pixels {
            let ring = cuts.partition_point(|cut| cut <= bin) - 1;
            if cuts.iter().skip(1).all(|cut| cut.abs_diff(*bin) > beside) {
                sum += (gray / light[*column].max(0.05) - levels[ring]).powi(2);
                n += 1.0;
            }
        }
    }
    (sum / f64::max(n, 1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use protocol::angle::difference;

    use super::super::PeerDetector;
    use super::super::test_scene::{self, Paint as TestPaint, Pillar, Scene};
    use super::super::tests::{camera, grid, marker};
    use super::*;

    /// Robots at two places each with an error of the hand's measurement, 1.5 cm across.
    fn pictures(side: Option<TestPaint>) -> Vec<(Vec<u8>, f64, f64)> {
        let place = |(x, y, seed): (f64, f64, u64)| {
            let scene = Scene::room(seed, 0.7).with_walls(5.0);
            let mut pillars = test_scene::robot(x, y);
            if let Some(side) = side {
                pillars[0] = Pillar { side, ..pillars[0] };
            }
            let scene = Scene { pillars, ..scene };
            (scene.picture(2.0, seed), f64::atan2(y, x) + 0.015 / f64::hypot(x, y), f64::hypot(x, y))
        };
        [(1.6, 0.4, 5), (-0.8, 1.9, 6), (-1.5, -2.0, 7)].map(place).to_vec()
    }

    fn views(pictures: &[(Vec<u8>, f64, f64)]) -> Vec<KnownView<'_>> {
        pictures
            .iter()
            .map(|(raw, bearing_rad, range_m)| KnownView { raw, bearing_rad: *bearing_rad, range_m: *range_m })
            .collect()
    }

    #[test]
    fn the_rings_of_a_robot_are_learnt_and_find_it_elsewhere() {
        let pictures = pictures(None);
        let learnt = learn(&camera(), &views(&pictures), 0.2, [0.1, 0.5]).unwrap();
        let rings = &learnt.marker.look().unwrap().rings;
        assert_eq!(rings.len(), 4, "{rings:?}");
        for (ring, (low, bright)) in rings.iter().zip([(0.1, true), (0.2, false), (0.3, true), (0.4, false)]) {
            assert!((ring.height_m[0] - low).abs() < 0.004, "{rings:?}");
            assert_eq!(ring.reflectance > 0.6, bright, "{rings:?}");
            assert!(bright || ring.reflectance < 0.2, "{rings:?}");
        }
        for (measured, (_, told, range_m)) in learnt.bearings_rad.iter().zip(&pictures) {
            let error_m = (difference(*measured, *told) * range_m + 0.015).abs();
            assert!(error_m < 0.004, "the hand's error is {error_m} m after it");
        }
        let scene = Scene { pillars: test_scene::robot(2.6, -0.9), ..Scene::room(40, 0.5).with_walls(6.0) };
        let raw = scene.picture(2.0, 1);
        let found = PeerDetector::new(&camera(), grid(), &[learnt.marker]).detect(&raw, &test_scene::panorama(&raw));
        assert_eq!(found.len(), 1);
        assert!((found[0].range_m - 2.6f64.hypot(0.9)).abs() < 4.0 * found[0].range_sigma_m().max(0.01), "{found:?}");
        let announced = PeerDetector::new(&camera(), grid(), &[marker()]).detect(&raw, &test_scene::panorama(&raw));
        assert!((found[0].range_m / announced[0].range_m - 1.0).abs() < 0.01);
    }

    #[test]
    fn what_is_no_rings_is_said() {
        let plain = pictures(Some(TestPaint::Plain(0.5)));
        assert!(matches!(learn(&camera(), &views(&plain), 0.2, [0.1, 0.5]), Err(LearnError::NoRings { .. })));
        let motley = pictures(Some(TestPaint::Texture(3, 0.4, 0.8, 25.0)));
        let refused = learn(&camera(), &views(&motley), 0.2, [0.1, 0.5]);
        assert!(matches!(refused, Err(LearnError::NoRings { .. } | LearnError::NotRound { .. })), "{refused:?}");
        let mut far = pictures(None);
        far.iter_mut().for_each(|picture| picture.2 = 0.4);
        let refused = learn(&camera(), &views(&far), 0.2, [0.1, 0.5]);
        assert!(matches!(refused, Err(LearnError::OutOfView { .. })), "{refused:?}");
    }
}
