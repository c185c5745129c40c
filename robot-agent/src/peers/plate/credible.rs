//! What speaks for and against a plate's being a robot's ([`super::super::verdict`]).

use protocol::angle::difference;

use super::super::rays::Sample;
use super::super::verdict::{Basis, Traits, given, lack, net};
use super::ends::End;
use super::plane::PlaneFit;
use super::rim::SideShown;
use super::{Height, PlateFinder, Posed};

/// Of plates of which stripes are seen.
pub(in super::super) const STRIPES: [&str; 25] = [
    // −ln of what the columns' median correlation lacks to 1.
    "correlation",
    // Gray level of black over white's less black's: black paint is nearly black.
    "black",
    // The bend's squared distance from a plane's in sigmas, and ln of its sigma: a test that could not fail says nothing.
    "bend",
    "bend unknown",
    // By how much χ² a cylinder fits worse.
    "flat",
    // χ² of the width and of the height.
    "width",
    "height",
    // Something may stand before one side; what is missing of the width then; another pair of sides is as good.
    "half hidden",
    "missing",
    "torn",
    // Shares of the columns in which a further stripe shows above or below, and stripes round a corner, and beside.
    "further stripe",
    "corner",
    "beside",
    // Share of the columns between the sides without stripes.
    "unfilled",
    // The sides' agreement of rows, 0 … 1 each, ln of the larger sigma, pixels, and ln of the fewer rows.
    "sides agree",
    "sides' sigma",
    "rows",
    // One edge between stripes is in view, with the upper end or as announced.
    "by end",
    "as announced",
    // Metres, ln of its width, pixels, and the turn, radians.
    "distance",
    "columns",
    "turn",
    // ln of contrast over noise.
    "contrast",
    // Shares of the columns in which the upper end is where it should be, and in which one is seen elsewhere.
    "upper end",
    "end elsewhere",
];
/// Of plates so near that their upper end alone is measured ([`super::rim`]).
pub(in super::super) const END: [&str; 21] = [
    // The bend's squared distance from a straight line's in sigmas, and ln of its sigma; by how many pixels (RMS) columns are elsewhere.
    "bend",
    "bend unknown",
    "stray",
    // Front and back are told apart by so many of the columns that could tell, with black so black; or they cannot be, and the stripe in
    // view is as uneven as this.
    "side seen",
    "side unsure",
    "black",
    "uneven",
    "width",
    "half hidden",
    "missing",
    "torn",
    // Share of the width by which the line falls short of a side.
    "short",
    // The sides' agreement of rows, ln of the larger sigma, pixels, and ln of the fewer rows.
    "sides agree",
    "sides' sigma",
    "rows",
    // Share of the columns beside in which the line goes on, and how many sides go on above.
    "goes on",
    "sides go on",
    "corner",
    // Metres, the turn, radians, and ln of contrast over noise.
    "distance",
    "turn",
    "contrast",
];

/// Least sigma of which the log is taken.
const LEAST_SIGMA: f64 = 0.02;
/// More uneven than this, or not to be told.
const MOST_UNEVEN: f64 = 9.0;
/// A plate may bend like this, cylinders of its width.
const BENT: f64 = 0.04;
/// Beside a plate is no more of it: a box goes round its corner. This far out is looked, as a share of the plate's width.
const BESIDE_SHARE: f64 = 0.2;
/// From so far beside a side on, pixels.
const OUT_PX: f64 = 3.0;

/// The bend's squared distance from a plane's, and ln of its sigma.
fn bend([bend, sigma]: [f64; 2]) -> [f64; 2] {
    let beyond = (bend.abs() - BENT).max(0.0);
    [(beyond / sigma.max(LEAST_SIGMA)).powi(2), sigma.max(LEAST_SIGMA).ln()]
}

/// The sides' agreement, ln of the larger sigma and ln of the fewer rows.
fn sides(posed: &Posed) -> [f64; 3] {
    let (right, left) = (&posed.right.1, &posed.left.1);
    let px = |edge: &super::EdgeFit| edge.sigma_rad * edge.px_per_rad;
    [
        right.agreement + left.agreement,
        px(right).max(px(left)).max(LEAST_SIGMA).ln(),
        (right.rows.min(left.rows) as f64).max(1.0).ln(),
    ]
}

fn hidden(posed: &Posed) -> [f64; 3] {
    let is_narrow = posed.shown < 1.0;
    [given(is_narrow), 1.0 - posed.shown, given(posed.is_torn && !is_narrow)]
}

/// How far it is turned from the line of sight to its middle, radians.
fn turn(fit: &PlaneFit, [right, left]: [f64; 2]) -> f64 {
    difference(fit.plane.alpha, right + 0.5 * difference(left, right)).abs()
}

fn contrast(fit: &PlaneFit) -> f64 {
    (fit.gain.max(0.1) / fit.noise.max(0.3)).ln()
}

impl PlateFinder {
    pub(super) fn stripe_traits(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        posed: &Posed,
        (height, height_chi2): (Height, f64),
    ) -> Traits {
        let [right, left] = [posed.right.0, posed.left.0];
        let beside = BESIDE_SHARE * difference(left, right);
        let px_per_rad = samples.first().map_or(200.0, |s| f64::from(s.ray.px_per_bearing));
        let out = OUT_PX / px_per_rad;
        let share = |from: f64, to: f64| self.share_of_stripes(samples, fit, from, to);
        let of_fit = [lack(fit.correlation), fit.black];
        let chi2 = [fit.flat_chi2(), posed.chi2, height_chi2];
        let around = [
            self.further_stripe(samples, fit, [right, left]),
            self.corner(samples, fit, [right, left]),
            share(right - out - beside, right - out).max(share(left + out, left + out + beside)),
            1.0 - share(right + out, left - out),
        ];
        let columns = difference(left, right) * px_per_rad;
        let rest = [
            given(height == Height::ByEnd),
            given(height == Height::Announced),
            fit.plane.c,
            columns.max(1.0).ln(),
            turn(fit, [right, left]),
            contrast(fit),
        ];
        let end = self.end_shown(samples, fit, [right, left]);
        let values =
            [&of_fit[..], &bend(fit.bend), &chi2, &hidden(posed), &around, &sides(posed), &rest, &end].concat();
        Traits::new(Basis::Stripes, values, || self.picture(samples, fit, [right, left]))
    }

    pub(super) fn end_traits(&self, samples: &[Sample], fit: &PlaneFit, posed: &Posed, side: SideShown) -> Traits {
        let ends = [posed.right.0, posed.left.0];
        let wide = difference(ends[1], ends[0]);
        let out = OUT_PX / samples.first().map_or(200.0, |s| f64::from(s.ray.px_per_bearing));
        let short = [difference(fit.seen_rad[0], ends[0]), difference(ends[1], fit.seen_rad[1])];
        let shown = match side {
            SideShown::By { share, black, .. } => [1.0, 1.0 - share, black, 0.0],
            SideShown::Unseen | SideShown::Neither => [0.0, 0.0, 0.0, self.unevenness(samples, fit).min(MOST_UNEVEN)],
        };
        let around = [
            self.rim_goes_on(samples, fit, ends, out),
            self.sides_beyond(samples, fit, ends, End::Upper) as f64,
            self.corner(samples, fit, ends),
            fit.plane.c,
            turn(fit, ends),
            contrast(fit),
        ];
        let short = short.into_iter().fold(0.0, f64::max) / wide;
        let values = [
            &bend(fit.bend)[..],
            &[fit.stray_px],
            &shown,
            &[posed.chi2],
            &hidden(posed),
            &[short],
            &sides(posed),
            &around,
        ]
        .concat();
        Traits::new(Basis::PlateEnd, values, || self.picture(samples, fit, ends))
    }

    /// What the plate and what is about it look like in the plane of the fit ([`Traits::picture`]).
    fn picture(&self, samples: &[Sample], fit: &PlaneFit, sides: [f64; 2]) -> Vec<i16> {
        let plane = &fit.plane;
        let middle_m = 0.5 * (plane.along(sides[0]) + plane.along(sides[1]));
        let half_m = 0.5 * self.look.width_m;
        net::picture(samples.iter().map(|sample| {
            let aside_m = plane.along(f64::from(sample.ray.bearing_rad)) - middle_m;
            ([aside_m / half_m, plane.meet(&sample.ray).1 + plane.lower_m], sample.gray)
        }))
    }
}
