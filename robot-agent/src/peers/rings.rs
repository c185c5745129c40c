//! Range, bearing and height of a body from its painted rings, without its outline.
//!
//! Problem: the outline of a body is easily falsified by what stands before or beside it; a person's leg makes as sharp an edge.
//! Insight: between the outlines the announced rings are the only pattern, and their edges are curves that bend with the
//! distance to the surface. So the inside alone gives the distance (from the spacing), the middle (from the bend) and the height
//! (from the offset), free of any background. Each picture column has its own gain and offset, so lamps may light the
//! cylinder as they like, and columns that do not show the rings are left out: somebody stands there.
//! Algorithm: Gauss–Newton on (bearing, near distance, height offset, blur, reflectance errors), the two unknowns of each
//! column eliminated by their Schur complement (variable projection); columns are admitted by their correlation and the
//! fit repeated.

use nalgebra::{DMatrix, DVector};

use super::blur;
use super::geometry::Cylinder;
use super::look::{CylinderLook, MAX_RINGS};
use super::rays::Sample;

/// Nonlinear unknowns before the reflectance errors: bearing, near distance, height offset, blur, bend.
const SHAPE: usize = 5;
/// Prior of the blur of lens and pixel together, pixels.
pub const BLUR_PX: f64 = 0.85;
const BLUR_SIGMA_PX: f64 = 0.15;
/// Paint and light may differ from the announcement by this much of full scale between rings.
const REFLECTANCE_SIGMA: f64 = 0.06;
/// The camera's height over the peer's floor: mounting, tilt and floor together, metres.
const HEIGHT_SIGMA_M: f64 = 0.015;
/// The bend is held while the shape is fitted, and let go to test it.
const BEND_HELD: f64 = 1e-4;
const BEND_FREE: f64 = 2.0;
/// Nearer to the outline the rows are too steep, sine of the angle of incidence.
const WIDEST_SINE: f64 = 0.93;
/// Keeps blurred light from beyond the painted part out, in units of the blur.
const MARGIN: f64 = 2.6;
/// A column shows the rings when this much of its variance is theirs (as a correlation).
const LEAST_CORRELATION: f64 = 0.8;
const ROUNDS: usize = 4;
/// Most pixels of the first two rounds, and of the last.
const ROUGH_PIXELS: usize = 300;
const MOST_PIXELS: usize = 800;
/// A round that ends below this is not worth another. Of 71 robots with bars in 40 rooms the least were 0.86, 0.93 and 0.96;
/// shelves and blinds come to 0.8 … 0.95 and stay there.
const HOPELESS_CORRELATION: [f64; ROUNDS] = [0.8, 0.88, 0.92, 0.8];
const HOPELESS_VISIBLE: f64 = 0.25;
/// The same of the first one's beginning, 3 % beside the truth.
const HOPELESS_START: f64 = 0.12;
/// The same of the first round where bars may show the negative: either sign counts, so more looks like rings by chance.
const HOPELESS_BARRED: [f64; 3] = [0.85, 0.3, 0.2];
const STEPS: usize = 4;
/// A round ends once bearing (radians) and near distance (share) change by less: all but the last, and that.
const ROUGH_STEP: [f64; 2] = [2e-4, 6e-4];
const FINE_STEP: [f64; 2] = [1e-5, 3e-5];
/// Black is seen in columns as strong as this share of the strongest.
const BLACK_GAIN: f64 = 0.75;
/// A bar that is so many columns wide is told from the ground; mixed columns are hidden ones where there are so many of them, over more.
const RESOLVED_BAR: f64 = 2.5;
const LEAST_HIDDEN: usize = 3;
/// Sensor noise is never taken to be below this, grey levels (rounding alone is 0.29).
const LEAST_NOISE: f64 = 0.5;

/// What the rings say.
#[derive(Debug, Clone)]
pub struct RingFit {
    /// Of the axis, radians.
    pub bearing_rad: f64,
    /// Along the floor to the near surface (range − radius), metres.
    pub near_m: f64,
    /// The body stands this much lower than announced, as the camera sees it, metres.
    pub lower_m: f64,
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Reflectances that fit, in the announced scale.
    pub reflectance: Vec<f64>,
    /// Covariance of (bearing, near distance, height offset).
    pub covariance: [[f64; 3]; 3],
    /// Residual of the visible columns, grey levels.
    pub noise: f64,
    /// Columns across the body, right to left by bearing, and half of what they are over, radians.
    pub columns: Vec<Column>,
    /// See `columns`.
    pub half_rad: f64,
    /// Share of the inner columns that show the rings.
    pub visible: f64,
    /// Mean correlation of the visible columns.
    pub correlation: f64,
    /// Median gain of the visible columns, grey levels per unit of reflectance.
    pub gain: f64,
    /// How much more the rings bend than a cylinder's, as a share (0: exactly so, −1: flat), and its standard deviation.
    pub bend: [f64; 2],
    /// Ring edges inside the field of view that the fit stands on.
    pub edges_seen: usize,
    /// From the marker's upper end alone (`super::near`), which looks like this.
    pub end: Option<EndFit>,
}

/// How the marker's upper end looks that was fitted alone.
#[derive(Debug, Clone, Copy)]
pub struct EndFit {
    /// RMS distance of its columns from the curve, noise taken out, pixels.
    pub stray_px: f64,
    /// Share of the columns in which its far side is where it should be.
    pub lid: f64,
    /// So many columns of the picture were taken together.
    pub together: f64,
}

/// One column of the body.
#[derive(Debug, Clone, Copy, Default)]
pub struct Column {
    /// Grey levels per unit of reflectance.
    pub gain: f64,
    /// Grey level of black.
    pub offset: f64,
    /// Of picture and rings, −1 … 1; 0 where nothing was measured.
    pub correlation: f64,
    /// Whether it shows the rings.
    pub visible: bool,
    /// On a body with bars: rings and their negative in one column, which says nothing.
    pub is_mixed: bool,
}

impl Column {
    /// Correlation and gain, without their sign where bars may show the negative.
    fn strength(&self, is_barred: bool) -> (f64, f64) {
        if is_barred { (self.correlation.abs(), self.gain.abs()) } else { (self.correlation, self.gain) }
    }
}

impl RingFit {
    /// The cylinder that was found.
    pub fn cylinder(&self, radius_m: f64) -> Cylinder {
        Cylinder::new(self.bearing_rad, self.near_m + radius_m, radius_m)
    }

    /// Gray level of black over white's less black's: the median of the columns that show rings. 0 for an upper end alone.
    pub fn black(&self, look: &CylinderLook) -> f64 {
        let of_negative = 2.0 * look.middle_reflectance();
        // Across the border of a bar there is no black.
        let strongest = self.columns.iter().filter(|c| c.visible).map(|c| c.gain.abs()).fold(0.0, f64::max);
        let shown = self.columns.iter().filter(|c| c.visible && c.gain.abs() > BLACK_GAIN * strongest);
        let black = |c: &Column| (c.offset + if c.gain < 0.0 { c.gain * of_negative } else { 0.0 }) / c.gain.abs();
        median(&mut shown.map(black).collect::<Vec<_>>())
    }

    /// RMS difference of the reflectances that fit from the announced ones.
    pub fn paint_error(&self, look: &CylinderLook) -> f64 {
        let sum: f64 = self.reflectance.iter().zip(&look.reflectance).map(|(a, b)| (a - b).powi(2)).sum();
        (sum / self.reflectance.len() as f64).sqrt()
    }
}

/// The rings as one pixel sees them: mean reflectance through the blur and its derivative by each ring's reflectance.
pub fn profile(look: &CylinderLook, reflectance: &[f64], height_m: f64, blur_m: f64, by_ring: &mut [f64]) -> f64 {
    let n = reflectance.len();
    let mut above = 1.0;
    let mut sum = 0.0;
    for k in 0..n {
        let next = if k + 1 < n { blur::step((height_m - look.edges_m[k + 1]) / blur_m) } else { 0.0 };
        by_ring[k] = above - next;
        sum += reflectance[k] * by_ring[k];
        above = next;
    }
    sum
}

/// As [`profile`], with its derivatives by height and by the blur.
fn profile_slopes(
    look: &CylinderLook,
    reflectance: &[f64],
    height_m: f64,
    blur_m: f64,
    by_ring: &mut [f64],
) -> (f64, f64, f64) {
    let n = reflectance.len();
    let (mut above, mut sum, mut by_height, mut by_blur) = (1.0, 0.0, 0.0, 0.0);
    let per_blur = 1.0 / blur_m;
    for k in 0..n {
        let mut next = 0.0;
        if k + 1 < n {
            let y = (height_m - look.edges_m[k + 1]) * per_blur;
            let steep = (reflectance[k + 1] - reflectance[k]) * blur::bell(y) * per_blur;
            next = blur::step(y);
            by_height += steep;
            by_blur -= steep * y;
        }
        by_ring[k] = above - next;
        sum += reflectance[k] * by_ring[k];
        above = next;
    }
    (sum, by_height, by_blur)
}

struct State {
    bearing_rad: f64,
    near_m: f64,
    lower_m: f64,
    blur_px: f64,
    reflectance: Vec<f64>,
}

struct Pixel {
    column: usize,
    sample: usize,
}

/// Of each column the sums over (1, profile, gray, derivatives…, rings…): the upper triangle of their Gram matrix.
#[derive(Default)]
struct Grams {
    /// Rows and columns of a matrix.
    size: usize,
    /// Pixels of each column.
    counts: Vec<usize>,
    sums: Vec<f64>,
}

/// Where the gray values, the derivatives and the rings' shares begin.
const GRAY: usize = 2;
const DERIVATIVES: usize = 3;
const RINGS: usize = DERIVATIVES + SHAPE;

impl Grams {
    fn clear(&mut self, columns: usize, size: usize) {
        self.size = size;
        self.counts.clear();
        self.counts.resize(columns, 0);
        self.sums.clear();
        self.sums.resize(columns * size * size, 0.0);
    }

    /// Adds a pixel: what its row begins with, the rest up to [`RINGS`] being zero, and its share of each ring.
    fn add<const N: usize>(&mut self, column: usize, head: [f64; N], rings: &[f64]) {
        self.counts[column] += 1;
        let size = self.size;
        let sums = &mut self.sums[column * size * size..][..size * size];
        for (i, value) in head.iter().enumerate() {
            let Some(of_row) = sums[i * size..].first_chunk_mut::<N>() else { return };
            for j in i..N {
                of_row[j] += value * head[j];
            }
        }
        for (k, share) in rings.iter().enumerate().filter(|(_, share)| **share != 0.0) {
            for (i, value) in head.iter().enumerate() {
                sums[i * size + RINGS + k] += value * share;
            }
            for (l, other) in rings.iter().enumerate().skip(k) {
                sums[(RINGS + k) * size + RINGS + l] += share * other;
            }
        }
    }

    fn of(&self, column: usize) -> Gram<'_> {
        let n = self.size * self.size;
        Gram { size: self.size, sums: &self.sums[column * n..][..n] }
    }
}

/// The sums of one column.
#[derive(Clone, Copy)]
struct Gram<'a> {
    size: usize,
    sums: &'a [f64],
}

impl Gram<'_> {
    fn at(&self, i: usize, j: usize) -> f64 {
        self.sums[i.min(j) * self.size + i.max(j)]
    }
}

/// Fits the rings from a start (bearing, range to the axis). `noise2` is the sensor's. A `close` start (the
/// last frame's answer) needs no search for the right valley. `None` where the picture does not show the rings there.
pub fn fit(samples: &[Sample], look: &CylinderLook, start: (f64, f64), noise2: f64, close: bool) -> Option<RingFit> {
    let m = SHAPE + look.reflectance.len();
    let [hopeless_correlation, hopeless_visible, hopeless_start] = match look.is_barred() {
        true => HOPELESS_BARRED,
        false => [HOPELESS_CORRELATION[0], HOPELESS_VISIBLE, HOPELESS_START],
    };
    let mut state = State {
        bearing_rad: start.0,
        near_m: start.1 - look.radius_m,
        lower_m: 0.0,
        blur_px: BLUR_PX,
        reflectance: look.reflectance.clone(),
    };
    let mut grams = Grams::default();
    let mut result = None;
    for (round, hopeless) in HOPELESS_CORRELATION.into_iter().enumerate().skip(if close { 2 } else { 0 }) {
        // The first round starts up to 3 % off: a wide blur takes it into the right valley.
        let blunt = if round == 0 { 1.6 } else { 0.0 };
        let most = if round < 2 { ROUGH_PIXELS } else { MOST_PIXELS };
        let (pixels, columns) = select(samples, look, &state, most)?;
        let mut normal = None;
        if round == 0 {
            // Most candidates show no ring at all.
            accumulate(samples, &pixels, columns, look, &state, blunt, Sums::Shown, &mut grams);
            if judge(&grams, noise2, round, bar_columns(look, &state, columns)).visible < hopeless_start {
                return None;
            }
        }
        for step in 0..STEPS {
            accumulate(samples, &pixels, columns, look, &state, blunt, Sums::All, &mut grams);
            let shown = judge(&grams, noise2, round, bar_columns(look, &state, columns));
            let solved = solve(&grams, &shown.columns, &state, look, m, BEND_HELD)?;
            let free = !(round == 0 && step < 2);
            let scale = if free { 1.0 } else { 0.7 };
            state.bearing_rad += scale * solved.delta[0].clamp(-0.05, 0.05);
            state.near_m += scale * solved.delta[1].clamp(-0.06 * state.near_m, 0.06 * state.near_m);
            state.lower_m += scale * solved.delta[2].clamp(-0.03, 0.03);
            if round > 0 {
                state.blur_px = (state.blur_px + solved.delta[3]).clamp(0.4, 1.6);
                for (r, d) in state.reflectance.iter_mut().zip(solved.delta.iter().skip(SHAPE)) {
                    *r += d.clamp(-0.05, 0.05);
                }
            }
            let [fine_rad, fine_share] = if round + 1 < ROUNDS { ROUGH_STEP } else { FINE_STEP };
            let small = solved.delta[0].abs() < fine_rad && solved.delta[1].abs() < fine_share * state.near_m;
            normal = Some((shown, solved.inverse));
            if small || !(state.near_m > 0.05 && state.near_m < 30.0) {
                break;
            }
        }
        if !(state.near_m > 0.05 && state.near_m < 30.0 && state.lower_m.abs() < 0.2) {
            return None;
        }
        if (state.near_m + look.radius_m) / start.1 > 1.25 || start.1 / (state.near_m + look.radius_m) > 1.25 {
            return None;
        }
        if let Some((shown, inverse)) = normal {
            if shown.visible_count == 0
                || shown.correlation < hopeless_correlation.max(hopeless)
                || shown.visible < hopeless_visible
            {
                return None;
            }
            result = Some((shown, inverse));
        }
    }
    let (shown, inverse) = result?;
    let noise2 = shown.noise * shown.noise;
    // The last sums again, with the bend let go: a cylinder needs none.
    let free = solve(&grams, &shown.columns, &state, look, m, BEND_FREE)?;
    let bend = [free.delta[4], free.inverse[(4, 4)].sqrt() * shown.noise];
    let mut covariance = [[0.0; 3]; 3];
    for (i, row) in covariance.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = inverse[(i, j)] * noise2;
        }
    }
    let edges_seen = edges_in_view(samples, look, &state);
    Some(RingFit {
        bearing_rad: protocol::angle::wrap(state.bearing_rad),
        near_m: state.near_m,
        lower_m: state.lower_m,
        blur_px: state.blur_px,
        reflectance: state.reflectance,
        covariance,
        noise: shown.noise,
        visible: shown.visible,
        correlation: shown.correlation,
        gain: shown.gain,
        columns: shown.columns,
        half_rad: Cylinder::new(state.bearing_rad, state.near_m + look.radius_m, look.radius_m).outline_rad,
        bend,
        edges_seen,
        end: None,
    })
}

/// Ring edges between two rings that the samples reach on both sides.
fn edges_in_view(samples: &[Sample], look: &CylinderLook, state: &State) -> usize {
    let cylinder = Cylinder::new(state.bearing_rad, state.near_m + look.radius_m, look.radius_m);
    let lowest = samples
        .iter()
        .map(|s| cylinder.meet(&s.ray))
        .filter(|m| m.sine.abs() < 0.5)
        .map(|m| m.height_m)
        .fold(f64::INFINITY, f64::min);
    let inner = &look.edges_m[1..look.edges_m.len() - 1];
    inner.iter().filter(|edge| **edge > lowest + 0.02).count()
}

/// The pixels inside outline and painted part, by column of one pixel's width.
fn select(samples: &[Sample], look: &CylinderLook, state: &State, most: usize) -> Option<(Vec<Pixel>, usize)> {
    let cylinder = Cylinder::new(state.bearing_rad, state.near_m + look.radius_m, look.radius_m);
    let half = cylinder.outline_rad;
    let mut pixels = Vec::with_capacity(samples.len());
    let mut scale = 0.0;
    for (i, sample) in samples.iter().enumerate() {
        // Most pixels of the patch are beside the body.
        if cylinder.sine(&sample.ray).abs() > WIDEST_SINE {
            continue;
        }
        let met = cylinder.meet(&sample.ray);
        let ppb = f64::from(sample.ray.px_per_bearing);
        let inside_px = (half - met.aside_rad.abs()) * ppb;
        if inside_px < MARGIN * BLUR_PX {
            continue;
        }
        let m_per_px = sample.ray.m_per_px(met.distance_m);
        let height = met.height_m + state.lower_m;
        let margin = MARGIN * BLUR_PX * m_per_px;
        if height < look.low_m() + margin || height > look.high_m() - margin {
            continue;
        }
        scale += ppb;
        pixels.push(Pixel { column: 0, sample: i });
    }
    if pixels.len() < 12 {
        return None;
    }
    scale /= pixels.len() as f64;
    let columns = ((2.0 * half * scale).ceil() as usize).max(3);
    let column_rad = 2.0 * half / columns as f64;
    for pixel in &mut pixels {
        let met = cylinder.meet(&samples[pixel.sample].ray);
        pixel.column = (((met.aside_rad + half) / column_rad) as usize).min(columns - 1);
    }
    // A body near at hand has more pixels than the fit needs: every n-th column is as good.
    let every = pixels.len().div_ceil(most);
    if every > 1 {
        pixels.retain(|pixel| pixel.column % every == 0);
    }
    Some((pixels, columns))
}

/// Which sums are wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sums {
    /// Of gray and profile: all that [`judge`] asks for, at a tenth of the cost.
    Shown,
    All,
}

#[allow(clippy::too_many_arguments)]
fn accumulate(
    samples: &[Sample],
    pixels: &[Pixel],
    columns: usize,
    look: &CylinderLook,
    state: &State,
    blunt_px: f64,
    sums: Sums,
    grams: &mut Grams,
) {
    let rings = state.reflectance.len();
    grams.clear(columns, RINGS + rings);
    let body = Cylinder::new(state.bearing_rad, state.near_m + look.radius_m, look.radius_m);
    let mut by_ring = [0.0; MAX_RINGS];
    let blur_px = state.blur_px.hypot(blunt_px);
    for pixel in pixels {
        let sample = &samples[pixel.sample];
        let met = body.meet(&sample.ray);
        let m_per_px = sample.ray.m_per_px(met.distance_m);
        let height = met.height_m + state.lower_m;
        if sums == Sums::Shown {
            let value = profile(look, &state.reflectance, height, blur_px * m_per_px, &mut by_ring);
            grams.add(pixel.column, [1.0, value, sample.gray], &[]);
            continue;
        }
        let (value, by_height, by_blur) =
            profile_slopes(look, &state.reflectance, height, blur_px * m_per_px, &mut by_ring);
        let seen = [1.0, value, sample.gray];
        // Between two edges the picture tells of the paint alone.
        if by_height == 0.0 && by_blur == 0.0 {
            grams.add(pixel.column, seen, &by_ring[..rings]);
            continue;
        }
        let slope = f64::from(sample.ray.slope);
        let [by_bearing, by_range] = body.distance_slopes(&sample.ray, &met);
        let derivatives: [f64; SHAPE] = [
            by_height * slope * by_bearing,
            by_height * slope * by_range,
            by_height,
            by_blur * m_per_px,
            // A stronger bend about the nearest line, which itself stays.
            by_height * slope * (met.distance_m - state.near_m),
        ];
        let mut head = [0.0; RINGS];
        head[..DERIVATIVES].copy_from_slice(&seen);
        head[DERIVATIVES..].copy_from_slice(&derivatives);
        grams.add(pixel.column, head, &by_ring[..rings]);
    }
}

struct Shown {
    columns: Vec<Column>,
    visible_count: i32,
    visible: f64,
    correlation: f64,
    gain: f64,
    noise: f64,
}

/// The narrowest bar of a team that wears bars, in the middle of the body, columns of which so many lie over it.
fn bar_columns(look: &CylinderLook, state: &State, columns: usize) -> Option<f64> {
    let worn = look.patterns.iter().filter(|pattern| !pattern.bars.is_empty());
    let narrowest_rad = worn.map(|pattern| pattern.narrowest_rad).min_by(f64::total_cmp)?;
    let half = Cylinder::new(state.bearing_rad, state.near_m + look.radius_m, look.radius_m).outline_rad;
    Some(narrowest_rad * look.radius_m / state.near_m * columns as f64 / (2.0 * half))
}

/// Which columns show the rings; on a body with bars, of which the narrowest is so many columns wide, also their negative, and a column on
/// a bar's border shows neither.
fn judge(grams: &Grams, noise2: f64, round: usize, bar_columns: Option<f64>) -> Shown {
    let is_barred = bar_columns.is_some();
    let mut columns = vec![Column::default(); grams.counts.len()];
    let mut measured = 0i32;
    let least = if round == 0 { LEAST_CORRELATION - 0.2 } else { LEAST_CORRELATION };
    let mut gains = Vec::new();
    let mut residuals = vec![0.0; columns.len()];
    for (c, _) in grams.counts.iter().enumerate().filter(|(_, n)| **n >= 4) {
        let s = grams.of(c);
        let n = s.at(0, 0);
        let pp = s.at(1, 1) - s.at(0, 1) * s.at(0, 1) / n;
        let pi = s.at(1, GRAY) - s.at(0, 1) * s.at(0, GRAY) / n;
        let ii = s.at(GRAY, GRAY) - s.at(0, GRAY) * s.at(0, GRAY) / n;
        // A column without a ring edge inside says nothing either way.
        if pp < 1e-3 * n {
            continue;
        }
        measured += 1;
        let column = &mut columns[c];
        column.gain = pi / pp;
        column.offset = (s.at(0, GRAY) - column.gain * s.at(0, 1)) / n;
        column.correlation = pi / (pp * without_noise(ii, n, noise2).max(pi * pi / pp)).sqrt();
        residuals[c] = ((ii - pi * pi / pp).max(0.0) / (n - 2.0).max(1.0)).sqrt();
        let (correlation, gain) = column.strength(is_barred);
        column.visible = correlation > least;
        if column.visible {
            gains.push(gain);
        }
    }
    let gain = median(&mut gains);
    let (mut count, mut sum, mut rests) = (0i32, 0.0, Vec::new());
    for (column, rest) in columns.iter_mut().zip(&residuals) {
        let (correlation, own) = column.strength(is_barred);
        column.visible &= own > 0.35 * gain && own < 2.5 * gain;
        if column.visible {
            count += 1;
            sum += correlation;
            rests.push(*rest);
        }
    }
    let noise = median(&mut rests);
    let typical = noise.max(LEAST_NOISE);
    if let Some(bar_columns) = bar_columns {
        for (column, rest) in columns.iter_mut().zip(&residuals) {
            column.is_mixed = column.correlation != 0.0 && !column.visible && *rest <= 3.0 * typical;
        }
        hide_what_no_border_mixes(&mut columns, bar_columns);
        measured -= columns.iter().filter(|column| column.is_mixed).count() as i32;
    }
    // A column that an occluder or a shadow touches fits worse than its fellows.
    for (column, rest) in columns.iter_mut().zip(&residuals) {
        if column.visible && *rest > 3.0 * typical {
            column.visible = false;
            count -= 1;
            sum -= column.strength(is_barred).0;
        }
    }
    Shown {
        visible_count: count,
        visible: f64::from(count) / f64::from(measured.max(1)),
        correlation: sum / f64::from(count.max(1)),
        gain,
        noise: typical,
        columns,
    }
}

/// The border of a bar mixes a column or two; where more of them show neither rings nor their negative, though the bars are wide enough to be
/// told apart there, something without a pattern of its own stands before the body.
fn hide_what_no_border_mixes(columns: &mut [Column], bar_columns: f64) {
    let n = columns.len() as f64;
    let is_resolved = |c: &&usize| {
        let sine = 2.0 * (**c as f64 + 0.5) / n - 1.0;
        bar_columns * (1.0 - sine * sine).sqrt() >= RESOLVED_BAR
    };
    let is_too_long = |run: &&[usize]| {
        let resolved: Vec<&usize> = run.iter().filter(is_resolved).collect();
        let over = resolved.first().zip(resolved.last()).map_or(0, |(first, last)| *last - *first);
        resolved.len() >= LEAST_HIDDEN && over >= LEAST_HIDDEN
    };
    let measured: Vec<usize> = (0..columns.len()).filter(|c| columns[*c].correlation != 0.0).collect();
    let runs = measured.chunk_by(|a, b| columns[*a].is_mixed && columns[*b].is_mixed);
    let hidden: Vec<usize> = runs.filter(is_too_long).flatten().copied().collect();
    hidden.into_iter().for_each(|c| columns[c].is_mixed = false);
}

/// Correlation of n pixels with the rings, what noise has in them taken out, from the squares about the means: of the rings, of both, and of the
/// pixels.
pub(super) fn correlation([pp, pg, gg]: [f64; 3], n: f64, noise2: f64) -> f64 {
    let shown = without_noise(gg, n, noise2).max(pg * pg / pp);
    pg / (pp * shown).max(1e-12).sqrt()
}

/// Squares about the mean of n pixels less what noise has in them, as far as it is known; never less than a small noise.
pub(super) fn without_noise(squares: f64, n: f64, noise2: f64) -> f64 {
    squares - (n - 2.0).max(0.0) * noise2 + LEAST_NOISE * LEAST_NOISE * n
}

pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

struct Solved {
    delta: DVector<f64>,
    inverse: DMatrix<f64>,
}

fn solve(
    grams: &Grams,
    columns: &[Column],
    state: &State,
    look: &CylinderLook,
    m: usize,
    bend_sigma: f64,
) -> Option<Solved> {
    let mut h = DMatrix::<f64>::zeros(m, m);
    let mut g = DVector::<f64>::zeros(m);
    let mut noise2: f64 = 0.0;
    let mut dof: f64 = 0.0;
    for (c, column) in columns.iter().enumerate().filter(|(_, column)| column.visible) {
        let gram = grams.of(c);
        let at = |i: usize, j: usize| gram.at(i, j);
        let n = at(0, 0);
        let pp = at(1, 1) - at(0, 1) * at(0, 1) / n;
        // Inner products after the column's offset and gain are taken out.
        let free = |i: usize, j: usize| {
            let centred = at(i, j) - at(0, i) * at(0, j) / n;
            let (pi, pj) = (at(1, i) - at(0, 1) * at(0, i) / n, at(1, j) - at(0, 1) * at(0, j) / n);
            centred - pi * pj / pp
        };
        for i in 0..m {
            for j in 0..=i {
                h[(i, j)] += column.gain * column.gain * free(DERIVATIVES + i, DERIVATIVES + j);
            }
            g[i] += column.gain * free(DERIVATIVES + i, GRAY);
        }
        noise2 += free(GRAY, GRAY).max(0.0);
        dof += (n - 2.0).max(0.0);
    }
    if dof < 4.0 {
        return None;
    }
    let noise2 = (noise2 / dof).max(LEAST_NOISE * LEAST_NOISE);
    let mut prior = |i: usize, value: f64, mean: f64, sigma: f64| {
        h[(i, i)] += noise2 / (sigma * sigma);
        g[i] += noise2 * (mean - value) / (sigma * sigma);
    };
    prior(0, 0.0, 0.0, 0.1);
    prior(1, 0.0, 0.0, 0.5 * state.near_m);
    prior(2, state.lower_m, 0.0, HEIGHT_SIGMA_M);
    prior(3, state.blur_px, BLUR_PX, BLUR_SIGMA_PX);
    prior(4, 0.0, 0.0, bend_sigma);
    for (k, (r, announced)) in state.reflectance.iter().zip(&look.reflectance).enumerate() {
        prior(SHAPE + k, *r, *announced, REFLECTANCE_SIGMA);
    }
    let factor = h.cholesky()?;
    Some(Solved { delta: factor.solve(&g), inverse: factor.inverse() })
}
