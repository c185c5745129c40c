//! What speaks for and against a plate's being a robot's ([`super::super::verdict`]).

use protocol::angle::difference;

use super::super::rays::Sample;
use super::super::verdict::{Basis, Traits, Weight};
use super::ends::End;
use super::plane::PlaneFit;
use super::rim::SideShown;
use super::{Height, PlateFinder, Posed};

/// Of plates of which stripes are seen.
pub(in super::super) const STRIPES: [Weight; 24] = [
    ("any", -6.631),
    // −ln of what the columns' median correlation lacks to 1.
    ("correlation", 1.187),
    // Gray level of black over white's less black's, 0 … 0.5: black paint is nearly black.
    ("black", -5.484),
    // The bend's squared distance from a plane's in sigmas, 0 … 16, and ln of its sigma: a test that could not fail says nothing.
    ("bend", -0.181),
    ("bend unknown", -0.781),
    // By how much χ² a cylinder fits worse, 0 … 25.
    ("flat", 0.033),
    // χ² of the width and of the height, 0 … 25 each.
    ("width", -0.186),
    ("height", -1.388),
    // Something may stand before one side; what is missing of the width then; another pair of sides is as good.
    ("half hidden", -2.104),
    ("missing", 1.501),
    ("torn", 0.324),
    // Shares of the columns in which a further stripe shows above or below, and stripes round a corner, and beside.
    ("further stripe", -4.042),
    ("corner", -2.056),
    ("beside", -1.398),
    // Share of the columns between the sides without stripes.
    ("unfilled", -1.252),
    // The sides' agreement of rows, 0 … 1 each, and ln of the larger sigma, pixels.
    ("sides agree", -1.299),
    ("sides' sigma", -0.744),
    // One edge between stripes is in view, with the upper end or as announced.
    ("by end", -0.569),
    ("as announced", -2.274),
    // Metres beyond 3 m, and the turn's square, radians squared.
    ("far", -0.470),
    ("turn", 2.542),
    // ln of contrast over noise.
    ("contrast", 0.176),
    // Shares of the columns in which the upper end is where it should be, and in which one is seen elsewhere.
    ("upper end", 2.251),
    ("end elsewhere", -3.515),
];
/// Of plates so near that their upper end alone is measured ([`super::rim`]).
pub(in super::super) const END: [Weight; 19] = [
    ("any", -0.848),
    // The bend's squared distance from a straight line's in sigmas, 0 … 16, and ln of its sigma.
    ("bend", -0.280),
    ("bend unknown", -0.532),
    // Front and back are told apart by so many of the columns that could tell, with black so black; or they cannot be, and the stripe in
    // view is as uneven as this, 0 … 3.
    ("side seen", 3.262),
    ("side unsure", -2.788),
    ("black", -3.101),
    ("uneven", -0.858),
    ("width", -1.527),
    ("half hidden", -0.944),
    ("missing", -1.006),
    ("torn", 0.929),
    // Share of the width by which the line falls short of a side, 0 … 0.5.
    ("short", -6.043),
    // The sides' agreement of rows, ln of the larger sigma, pixels, and ln of the fewer rows.
    ("sides agree", 0.124),
    ("sides' sigma", -1.977),
    ("rows", -1.149),
    // Share of the columns beside in which the line goes on, and how many sides go on above.
    ("goes on", -1.180),
    ("sides go on", -0.875),
    ("corner", -0.820),
    ("contrast", -0.726),
];

/// Least sigma of which the log is taken.
const LEAST_SIGMA: f64 = 0.02;
/// Most of a χ² that says anything.
const MOST_CHI2: f64 = 25.0;
const MOST_BEND_CHI2: f64 = 16.0;
/// A plate may bend like this, cylinders of its width.
const BENT: f64 = 0.04;
/// Beside a plate is no more of it: a box goes round its corner. This far out is looked, as a share of the plate's width.
const BESIDE_SHARE: f64 = 0.2;
/// From so far beside a side on, pixels.
const OUT_PX: f64 = 3.0;
const FAR_M: f64 = 3.0;

fn given(is: bool) -> f64 {
    f64::from(u8::from(is))
}

/// The bend's squared distance from a plane's, and ln of its sigma.
fn bend([bend, sigma]: [f64; 2]) -> [f64; 2] {
    let beyond = (bend.abs() - BENT).max(0.0);
    [(beyond / sigma.max(LEAST_SIGMA)).powi(2).min(MOST_BEND_CHI2), sigma.max(LEAST_SIGMA).ln()]
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
        let out = OUT_PX / samples.first().map_or(200.0, |s| f64::from(s.ray.px_per_bearing));
        let share = |from: f64, to: f64| self.share_of_stripes(samples, fit, from, to);
        let turn = difference(fit.plane.alpha, right + 0.5 * difference(left, right));
        let correlation = -(1.005 - fit.correlation).ln();
        let of_fit = [correlation, fit.black.clamp(0.0, 0.5)];
        let chi2 = [fit.flat_chi2(), posed.chi2, height_chi2].map(|chi2| chi2.clamp(0.0, MOST_CHI2));
        let around = [
            self.further_stripe(samples, fit, [right, left]),
            self.corner(samples, fit, [right, left]),
            share(right - out - beside, right - out).max(share(left + out, left + out + beside)),
            1.0 - share(right + out, left - out),
        ];
        let [agree, sigma, _] = sides(posed);
        let rest = [
            agree,
            sigma,
            given(height == Height::ByEnd),
            given(height == Height::Announced),
            (fit.plane.c - FAR_M).max(0.0),
            turn * turn,
            contrast(fit),
        ];
        let end = self.end_shown(samples, fit, [right, left]);
        let values = [&[1.0][..], &of_fit, &bend(fit.bend), &chi2, &hidden(posed), &around, &rest, &end].concat();
        Traits { basis: Basis::Stripes, values }
    }

    pub(super) fn end_traits(&self, samples: &[Sample], fit: &PlaneFit, posed: &Posed, side: SideShown) -> Traits {
        let ends = [posed.right.0, posed.left.0];
        let wide = difference(ends[1], ends[0]);
        let out = OUT_PX / samples.first().map_or(200.0, |s| f64::from(s.ray.px_per_bearing));
        let short = [difference(fit.seen_rad[0], ends[0]), difference(ends[1], fit.seen_rad[1])];
        let shown = match side {
            SideShown::By { share, black, .. } => [1.0, 1.0 - share, black.clamp(0.0, 0.5), 0.0],
            SideShown::Unseen | SideShown::Neither => [0.0, 0.0, 0.0, self.unevenness(samples, fit).min(3.0)],
        };
        let around = [
            self.rim_goes_on(samples, fit, ends, out),
            self.sides_beyond(samples, fit, ends, End::Upper) as f64,
            self.corner(samples, fit, ends),
            contrast(fit),
        ];
        let short = short.into_iter().fold(0.0, f64::max) / wide;
        let chi2 = [posed.chi2.min(MOST_CHI2)];
        let values = [
            &[1.0][..],
            &bend(fit.bend),
            &shown,
            &chi2,
            &hidden(posed),
            &[short.clamp(0.0, 0.5)],
            &sides(posed),
            &around,
        ]
        .concat();
        Traits { basis: Basis::PlateEnd, values }
    }
}
