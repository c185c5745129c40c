//! Finds painted cylinders in one picture: search, rings, outlines, verdict.
//!
//! ```text
//! panorama --search--> candidates --rings--> axis, distance, visible columns --outlines--> features --combine--> Peer
//!                                   |                                           |
//!                                   +- too few columns, odd height: nothing     +- not where the rings say: somebody else's edge
//! ```
//! An outline is reported only where the rings, which know nothing of the background, put it. Nearer robots that have been found
//! hide what is below their upper ends from the candidates behind them, which are searched for once more with that left out.

mod beside;
mod confirm;
pub(super) mod credible;

use nalgebra::{Matrix2, Matrix2x3, Matrix3};
use protocol::marker::Marker;
use protocol::message::observation::FeaturePart;
use protocol::time::Timestamp;

use super::bars::{self, Reading};
use super::combine::{self, Evidence, Mount};
use super::edges::{self, EdgeFit, Side};
use super::geometry::outline_rad;
use super::look::CylinderLook;
use super::near::{self, NearSearch, Reach, Rim};
use super::occluder::Occluder;
use super::rays::{PixelRays, Sample};
use super::refusals::Refusals;
use super::rings::{self, RingFit};
use super::search::{self, Candidate, Grid, Hider, Search};
use super::verdict::{Fit, Fits};
use super::{Before, Find, Peer, PeerFeature};
use crate::optics::MountedCamera;

/// What remains of the error of a ring edge's elevation when noise has averaged out: shading, sampling, the lens. Pixels.
const ELEVATION_FLOOR_PX: f64 = 0.03;

// Beyond these limits a fit is not worth a closer look; what remains is judged by all of its traits ([`credible`]).
/// Least share of the inner columns that show the rings.
const LEAST_VISIBLE: f64 = 0.35;
/// Least mean correlation of those columns.
const LEAST_CORRELATION: f64 = 0.93;
/// Sharper or softer than any lens that the rings were fitted through, pixels.
const BLUR_PX: [f64; 2] = [0.45, 1.35];
/// Most RMS difference of the fitted reflectances from the announced ones.
const WORST_PAINT: f64 = 0.12;
/// The rings bend as a cylinder's to within this share, beside noise.
const BEND_GATE: f64 = 0.1;

/// Least contrast of full reflectance over the residual noise.
const LEAST_CONTRAST: f64 = 4.0;
/// The announced heights must fit to this, metres, beside what the mounting leaves open.
const HEIGHT_GATE_M: f64 = 0.01;
/// Least share of an outline's information from rows that agree.
const LEAST_AGREEMENT: f64 = 0.5;
/// An outline that noise leaves more uncertain than this is none, pixels.
const WORST_EDGE_PX: f64 = 0.5;
/// A candidate this near that so many of its strips support is worth other starts, at these multiples of its range.
const STRONG_SUPPORT: f64 = 0.55;
const NEAR_M: f64 = 2.2;
const RETRY_RANGES: [f64; 4] = [0.95, 1.05, 0.9, 1.1];
/// A candidate before a body is the same one up to this ratio of their ranges; behind it, up to so many radii and such a share
/// of its range.
const SAME_RANGE: f64 = 1.4;
const SAME_PLACE: f64 = 1.5;
const SAME_SHARE: f64 = 0.03;
/// A candidate's range is right to this share.
const RANGE_SLACK: f64 = 1.05;
/// A patch reaches so far beside a body: a share of its half width, and radians. One in which what was found is further aside than
/// this is not centred on it.
const BESIDE_SHARE: f64 = 1.1;
const BESIDE_PATCH_RAD: f64 = 0.045;
const OFF_CENTRE_RAD: f64 = 0.005;
/// An upper end counts beside rings where it shows in this share of the columns, at the same distance to this share.
const LEAST_UPPER_END: f64 = 0.75;
const SAME_NEAR: f64 = 0.08;
/// It must not be further from the curve than this, RMS, pixels.
const MOST_END_STRAY_PX: f64 = 0.3;
/// An outline that is further than so many sigmas from where the rings put it may be somebody else's, and beyond the second so many
/// is as uncertain as it is far.
const OFF: [f64; 2] = [2.5, 4.0];
/// Places over a body's width that somebody may hide.
const WIDTH_PLACES: usize = 32;
/// An edge that is as near to a body before it is that one's, radians.
const BESIDE_RAD: f64 = 0.01;
/// A lone outline has nothing to contradict it: it may be half somebody else's. Pixels, beside noise and floor.
const LONE_EDGE_PX: f64 = 0.2;
/// Errors of outlines: so many times what noise and texture of independent pixels make (texture is alike along an outline), and what remains
/// where there is neither, pixels. Of 8,600 outlines in 1,600 rooms, by whether they are known from rings or from an upper end alone, e²/σ² is
/// 0.6 and 0.4 of bodies with rings alone, 1.0 and 0.7 of bodies with bars, where light and bars are hard to tell apart; it is the same from the
/// faintest to the clearest outlines to within a factor of two. One in 500 is beyond 4 σ.
const PLAIN_OUTLINE: Outline = Outline { times: 1.5, least_px: 0.03 };
const PLAIN_OUTLINE_OF_END: Outline = Outline { times: 1.5, least_px: 0.1 };
const BARRED_OUTLINE: Outline = Outline { times: 2.2, least_px: 0.1 };
const BARRED_OUTLINE_OF_END: Outline = Outline { times: 2.2, least_px: 0.14 };
/// What remains of a bar's error when noise has averaged out, whose two borders the light treats differently. Pixels.
const BAR_FLOOR_PX: f64 = 0.05;
/// Variances are so many times larger where an outline is missing: what hides it may have hidden more than shows. Of 400 pictures (seed 19000) four such
/// sightings were 5 to 6 sigmas off.
const HALF_HIDDEN: f64 = 2.0;
/// The same where, besides, the bars may be others: what seems to be the outline may be the border of one.
const UNCLEAR: f64 = 12.0;
/// Of a heading from bars that are too narrow to be measured one by one.
const HEADING_FLOOR_RAD: f64 = 0.01;
/// The middle by the bend of the rings is right to this when noise has averaged out, radians.
const MIDDLE_FLOOR_RAD: f64 = 0.002;
/// Most peers of one picture.
const MAX_PEERS: usize = 16;

/// How far off an outline may be, beside noise and texture.
#[derive(Debug, Clone, Copy)]
struct Outline {
    times: f64,
    least_px: f64,
}

impl Outline {
    /// Of a body that bars may be on, fitted to rings or to an upper end.
    fn of(is_barred: bool, rings: &RingFit) -> Self {
        match (is_barred, &rings.end) {
            (false, None) => PLAIN_OUTLINE,
            (false, Some(_)) => PLAIN_OUTLINE_OF_END,
            (true, None) => BARRED_OUTLINE,
            (true, Some(_)) => BARRED_OUTLINE_OF_END,
        }
    }

    /// Standard deviation of what successive frames share, radians.
    fn lasting_rad(self, fit: &EdgeFit) -> f64 {
        let texture = (self.times * self.times - 1.0).sqrt() * fit.sigma_rad;
        texture.hypot(self.least_px / fit.px_per_rad)
    }
}

/// Finds cylinders of one look.
#[derive(Debug)]
pub struct CylinderFinder {
    look: CylinderLook,
    part: Part,
    search: Search,
    near_search: NearSearch,
    /// Where somebody was expected or an upper end may be in the picture at hand, and how many robots had been found in it when this was
    /// looked at: worth another look if one that was found later stands before it.
    hideable: Vec<(Candidate, usize)>,
    reach: Reach,
    samples: Vec<Sample>,
    /// Of the sensor in the picture at hand, squared grey levels.
    noise2: f64,
    /// What was fitted, where that is asked for.
    fits: Fits,
    refusals: Refusals,
    looks: usize,
}

/// Which part of a body a finder looks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// All of its rings.
    Whole,
    /// What shows over something that stands before it.
    Upper,
}

/// Why a candidate is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Missed {
    /// It shows no rings, no upper end.
    Nothing,
    /// It shows rings that do not suffice; with other noise they might.
    Hardly,
}

struct Found {
    rings: RingFit,
    reading: Option<Reading>,
    left: Option<EdgeFit>,
    right: Option<EdgeFit>,
    /// Share of the body's width that nobody hides who was found.
    unhidden: f64,
    /// Sides on which rings are shown up to where an outline should be that is not there, though nobody who was found hides it.
    open_sides: usize,
    /// Share of the columns beside the body in which what was fitted goes on.
    goes_on: f64,
}

impl Found {
    /// How many outlines are seen: 0, 1 or 2.
    fn outlines(&self) -> usize {
        usize::from(self.left.is_some()) + usize::from(self.right.is_some())
    }

    /// Whether bars are measured by themselves.
    fn has_bars(&self) -> bool {
        self.reading.as_ref().is_some_and(|reading| reading.whole_bars().next().is_some())
    }
}

impl CylinderFinder {
    /// Prepares the search for one look.
    pub fn new(camera: &MountedCamera, grid: Grid, look: CylinderLook, part: Part) -> Self {
        let lowest = camera.camera().elevation_rad()[0].tan();
        let search = Search::new(grid, &look, camera.viewpoint_body_m().z, lowest);
        let reach = Reach::new(&look, camera.viewpoint_body_m().z, lowest);
        let near_search = NearSearch::new(grid, &look, camera.viewpoint_body_m().z, &reach);
        let (hideable, samples) = (Vec::new(), Vec::new());
        let (fits, refusals) = (Fits::default(), Refusals::default());
        Self { look, part, search, near_search, hideable, reach, samples, noise2: 0.0, fits, refusals, looks: 0 }
    }

    /// Bytes of the panorama that the search expects.
    pub fn panorama_len(&self) -> usize {
        self.search.len()
    }

    /// What was fitted since the last call, robot or not; kept from the first call on.
    pub fn take_fits(&mut self) -> Vec<Fit> {
        self.fits.take()
    }

    /// Places that the last call looked at closely.
    pub fn looks(&self) -> usize {
        self.looks
    }

    #[cfg(test)]
    pub fn search_only(&mut self, panorama: &[u8]) -> usize {
        self.search.run(panorama).len()
    }

    /// The camera has moved.
    pub fn forget(&mut self) {
        self.refusals.forget();
    }

    /// The robots in a picture that nobody has found before: those expected at `known` places (bearing, range) and, if a panorama is
    /// given, all others. `stream` is when a picture of a stream was taken.
    pub fn find(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        panorama: Option<&[u8]>,
        stream: Option<Timestamp>,
        (known, before): Before<'_>,
    ) -> Vec<Find> {
        let mut candidates: Vec<Candidate> = known
            .iter()
            .map(|(bearing_rad, range_m)| Candidate {
                bearing_rad: *bearing_rad,
                range_m: *range_m,
                support: 1.0,
                seen_rad: [*bearing_rad; 2],
                known: true,
                rim: None,
                behind: None,
            })
            .collect();
        if let Some(panorama) = panorama {
            self.refusals.begin_search(stream);
            candidates.extend(self.search.run(panorama));
            if self.part == Part::Whole {
                candidates.extend(self.near_search.run(panorama));
            }
        }
        self.noise2 = rays.noise2();
        self.looks = 0;
        let mut accepted: Vec<Find> = Vec::new();
        let found = self.add_found(camera, rays, raw, &candidates, before, &mut accepted);
        let is_hideable = |(candidate, _): &(Candidate, usize)| candidate.known || candidate.rim.is_some();
        self.hideable = candidates.into_iter().zip(found).filter(is_hideable).collect();
        if self.part == Part::Whole {
            let all: Vec<Occluder> = before.iter().chain(&accepted).map(|find| occluder(camera, find)).collect();
            let later = |found: usize| all.get(before.len() + found..).unwrap_or_default();
            let behind = self.behind(Hider::Body, panorama.is_some(), &all, later);
            self.add_found(camera, rays, raw, &behind, before, &mut accepted);
        }
        accepted
    }

    /// The robots in the picture that [`CylinderFinder::find`] had last, with a panorama or without (`is_searched`), that nobody has found
    /// `before`, because those from `since` on, which others have found, stand before them.
    pub fn find_behind(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        is_searched: bool,
        (before, since): (&[Find], usize),
    ) -> Vec<Find> {
        let mut accepted = Vec::new();
        if self.part == Part::Whole {
            let all: Vec<Occluder> = before.iter().map(|find| occluder(camera, find)).collect();
            let behind = self.behind(Hider::Plate, is_searched, &all, |_| &all[since..]);
            self.add_found(camera, rays, raw, &behind, before, &mut accepted);
        }
        accepted
    }

    /// The places that somebody hides in part: of a panorama that was searched, and those of which nobody knew when they were looked at
    /// (`later` gives who was found after so many).
    fn behind<'a>(
        &mut self,
        hider: Hider,
        is_searched: bool,
        all: &[Occluder],
        later: impl Fn(usize) -> &'a [Occluder],
    ) -> Vec<Candidate> {
        let is_hidden = |(candidate, found): &&(Candidate, usize)| {
            let half = outline_rad(self.look.radius_m, candidate.range_m);
            later(*found).iter().any(|o| {
                o.range_m < candidate.range_m && o.hidden_share(candidate.bearing_rad, half) > search::LEAST_HIDDEN
            })
        };
        let mut behind = if is_searched { self.search.behind(all, hider) } else { Vec::new() };
        let hidden = self.hideable.iter().filter(is_hidden);
        behind.extend(hidden.map(|(candidate, _)| Candidate { behind: Some(hider), ..*candidate }));
        behind
    }

    /// Adds the robots that candidates are to those `accepted`; of two in one place the one that is surer stays. How many there were when
    /// each was looked at.
    fn add_found(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidates: &[Candidate],
        before: &[Find],
        accepted: &mut Vec<Find>,
    ) -> Vec<usize> {
        let mut found = Vec::with_capacity(candidates.len());
        let mut unread = Vec::new();
        for candidate in candidates {
            found.push(accepted.len());
            match self.look_at(camera, rays, raw, candidate, (before, accepted)) {
                Some((find, true)) => self.add((find, true), accepted),
                Some((find, false)) => unread.push(find),
                None => {}
            }
        }
        // Another candidate may have shown the bars.
        unread.into_iter().for_each(|find| self.add((find, false), accepted));
        found
    }

    /// Adds a robot to those accepted. One whose bars were not read gives way to whoever is there.
    fn add(&self, (find, is_read): (Find, bool), accepted: &mut Vec<Find>) {
        let twin = accepted.iter().position(|other| overlap(&other.peer, &find.peer, &self.look));
        match twin {
            Some(i) if !is_read || accepted[i].peer.confidence >= find.peer.confidence => {}
            Some(i) => accepted[i] = find,
            None if accepted.len() < MAX_PEERS => accepted.push(find),
            None => {}
        }
    }

    /// Whether the bars of a body were read, if it may have any.
    fn is_read(&self, found: &Found) -> bool {
        found.reading.is_some() || !self.look.is_barred()
    }

    /// How the upper end of a marker looks: in a team with bars it may be of either kind.
    fn worn(&self) -> Rim {
        if self.look.is_barred() { Rim::Barred } else { Rim::Plain }
    }

    /// The robot that a candidate is, unless it has been found already, and whether its bars were read if it may have any.
    fn look_at(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidate: &Candidate,
        (before, accepted): (&[Find], &[Find]),
    ) -> Option<(Find, bool)> {
        let all = || before.iter().chain(accepted);
        if all().any(|find| self.is_same(camera, find, candidate)) {
            return None;
        }
        let place = candidate.place();
        if !candidate.known && self.refusals.hold(&place) {
            return None;
        }
        self.looks += 1;
        let nearer = all().filter(|find| find.peer.range_m < candidate.range_m);
        let occluders: Vec<Occluder> = nearer.map(|find| occluder(camera, find)).collect();
        let found = self.look_closer(camera, rays, raw, candidate, &occluders);
        let seen = found.map(|found| (self.traits(camera, &found), found));
        let is_hopeless = match &seen {
            // Who passes by may make bars illegible for a moment.
            Ok((traits, found)) => traits.are_hopeless() && self.is_read(found),
            Err(missed) => *missed == Missed::Nothing,
        };
        if is_hopeless && !candidate.known {
            self.refusals.note(place);
        }
        let (traits, found) = seen.ok()?;
        let (is_taken, is_read) = (self.is_credible(&found, &traits), self.is_read(&found));
        if !is_taken && !self.fits.are_kept() {
            return None;
        }
        let peer = self.measured(camera, &found)?;
        let fit = Fit { peer, traits, is_taken };
        self.fits.keep(&fit);
        let (log_odds, peer) = (fit.traits.log_odds(), fit.peer);
        let stands = is_taken && !before.iter().any(|find| overlap(&find.peer, &peer, &self.look));
        let find = Find { log_odds, peer, half_m: self.look.radius_m, high_m: self.look.high_m() };
        stands.then_some((find, is_read))
    }

    /// What is there, with the whole of it in view: a candidate may show one half alone.
    fn look_closer(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidate: &Candidate,
        occluders: &[Occluder],
    ) -> Result<Found, Missed> {
        let found = self.look_from(camera, rays, raw, candidate, occluders)?;
        let outline = |range_m: f64| outline_rad(self.look.radius_m, range_m);
        let (bearing_rad, range_m) = (found.rings.bearing_rad, found.rings.near_m + self.look.radius_m);
        let aside = protocol::angle::difference(bearing_rad, candidate.bearing_rad).abs();
        if aside + outline(range_m) < BESIDE_SHARE * outline(candidate.range_m) + OFF_CENTRE_RAD {
            return Ok(found);
        }
        let rim = candidate.rim.filter(|_| found.rings.end.is_some());
        let centred = Candidate { bearing_rad, range_m, known: true, rim, ..*candidate };
        self.look_from(camera, rays, raw, &centred, occluders)
    }

    fn look_from(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidate: &Candidate,
        occluders: &[Occluder],
    ) -> Result<Found, Missed> {
        let radius = self.look.radius_m;
        let half = outline_rad(radius, candidate.range_m);
        let height = camera.viewpoint_body_m().z;
        let [lowest, highest] = camera.camera().elevation_rad();
        // The start may be 6 % off, the outline needs six pixels of background.
        let nearest = (candidate.range_m - radius) * 0.92;
        let farthest = candidate.range_m * 1.08;
        let end = |z: f64| {
            let drop = z - height;
            let (a, b) = (drop.atan2(nearest), drop.atan2(farthest));
            [a.min(b), a.max(b)]
        };
        let rim = candidate
            .rim
            .or(candidate.known.then_some(self.worn()))
            .filter(|_| candidate.range_m < RANGE_SLACK * self.reach.two_edges_m);
        let mut top = end(self.look.high_m())[1];
        if rim.is_some() {
            // The far side of the upper end is looked at, too.
            top = top.max((self.look.high_m() - height).atan2(farthest + radius));
        }
        let elevation = [
            (end(self.look.low_m())[0]).clamp(lowest, highest),
            (top + if candidate.range_m < NEAR_M { 0.03 } else { 0.01 }).clamp(lowest, highest),
        ];
        let mut samples = std::mem::take(&mut self.samples);
        rays.patch(camera, raw, candidate.bearing_rad, half * BESIDE_SHARE + BESIDE_PATCH_RAD, elevation, &mut samples);
        samples.retain(|sample| !occluders.iter().any(|occluder| occluder.hides(&sample.ray)));
        let mut found = Err(Missed::Nothing);
        if candidate.rim.is_none() {
            found = self.fit_best(&samples, camera, candidate, half, occluders);
        }
        let is_read = found.as_ref().is_ok_and(|found| self.is_read(found));
        if let Some(rim) = rim.filter(|_| !is_read) {
            let by_end = near::fit(&samples, &self.look, height, (candidate.bearing_rad, candidate.range_m), rim)
                .and_then(|rings| self.outlines(camera, &samples, rings, occluders));
            // An upper end that does not tell bars either says no more than rings do.
            if let Some(by_end) = by_end.filter(|by_end| found.is_err() || self.is_read(by_end)) {
                found = Ok(by_end);
            }
        }
        self.samples = samples;
        found
    }

    fn fit_best(
        &self,
        samples: &[Sample],
        camera: &MountedCamera,
        candidate: &Candidate,
        half: f64,
        occluders: &[Occluder],
    ) -> Result<Found, Missed> {
        let [right, left] = candidate.seen_rad;
        let seen = protocol::angle::difference(left, right);
        let mut starts = vec![candidate.bearing_rad];
        // Half hidden: the visible part may be either half of the body.
        if seen > 0.0 && seen < 1.2 * half {
            starts.push(right + half * 0.95);
            starts.push(left - half * 0.95);
        }
        let mut best = self.best_fit(samples, starts.iter().map(|b| (*b, candidate.range_m)), candidate.known);
        // The robot has moved since the last frame.
        if candidate.known && best.as_ref().is_none_or(|fit| !self.fits(fit, camera)) {
            best = self.best_fit(samples, starts.iter().map(|b| (*b, candidate.range_m)), false);
        }
        // Near at hand only one ring edge is in view and the search is coarse in range.
        if best.as_ref().is_none_or(|fit| !self.fits(fit, camera))
            && candidate.support > STRONG_SUPPORT
            && candidate.range_m < NEAR_M
        {
            // Either sign of the rings counts on bars: the search brings up more that is none.
            let most = if self.look.is_barred() { 2 } else { RETRY_RANGES.len() };
            let retries = RETRY_RANGES[..most].iter().map(|ratio| (candidate.bearing_rad, candidate.range_m * ratio));
            let retried = self.best_fit(samples, retries, false);
            best = retried.or(best);
        }
        let rings = best.ok_or(Missed::Nothing)?;
        if !self.fits(&rings, camera) {
            return Err(Missed::Hardly);
        }
        let rings = self.with_upper_end(camera, samples, rings);
        self.outlines(camera, samples, rings, occluders).ok_or(Missed::Hardly)
    }

    /// Whether a candidate is a body that was found already, or hidden by it.
    fn is_same(&self, camera: &MountedCamera, find: &Find, candidate: &Candidate) -> bool {
        let (peer, radius, height) = (&find.peer, self.look.radius_m, camera.viewpoint_body_m().z);
        let half = outline_rad(radius, peer.range_m);
        let half_candidate = outline_rad(radius, candidate.range_m);
        let apart = protocol::angle::difference(peer.bearing_rad, candidate.bearing_rad).abs();
        let behind_m = candidate.range_m - peer.range_m;
        // Two bodies are not in one place, and a candidate's range is not exact.
        let is_as_far =
            peer.range_m < SAME_RANGE * candidate.range_m && behind_m < SAME_PLACE * radius + SAME_SHARE * peer.range_m;
        let rings_from = self.look.edges_m[self.look.edges_m.len() - 2];
        let is_hidden = || !occluder(camera, find).is_below(rings_from, candidate.range_m - radius, height);
        apart < 0.5 * half.max(half_candidate) && is_as_far
            || behind_m > 0.0 && apart + 0.3 * half_candidate < half && is_hidden()
    }

    /// With one edge between rings in view they have their distance from their bend alone, which is worth a few per cent; the marker's
    /// upper end, if it is in view, may have it better ([`fused`]).
    fn with_upper_end(&self, camera: &MountedCamera, samples: &[Sample], rings: RingFit) -> RingFit {
        let start = (rings.bearing_rad, rings.near_m + self.look.radius_m);
        let end = (rings.edges_seen < 2)
            .then(|| near::fit(samples, &self.look, camera.viewpoint_body_m().z, start, self.worn()))
            .flatten()
            .filter(|fit| fit.end.is_some_and(|end| end.stray_px <= MOST_END_STRAY_PX))
            .filter(|end| end.visible >= LEAST_UPPER_END && (end.near_m / rings.near_m - 1.0).abs() < SAME_NEAR)
            .filter(|end| end.covariance[1][1] < rings.covariance[1][1]);
        match end {
            Some(end) => fused(rings, &end, self.look.radius_m),
            None => rings,
        }
    }

    /// Bars and outlines beside the rings.
    fn outlines(
        &self,
        camera: &MountedCamera,
        samples: &[Sample],
        rings: RingFit,
        occluders: &[Occluder],
    ) -> Option<Found> {
        let reading = match self.look.is_barred() {
            true => {
                let reading = bars::read(samples, &self.look, &rings, self.noise2, &Self::hidden_sectors(&rings));
                // Near at hand one ring alone is in view, which may say nothing of bars; of rings something may stand before too many.
                if reading.is_none() && rings.end.is_some() && rings.visible < credible::LEAST_LONE_RIM {
                    return None;
                }
                reading
            }
            false => None,
        };
        let half = rings.cylinder(self.look.radius_m).outline_rad;
        let height = camera.viewpoint_body_m().z;
        let hiding: Vec<&Occluder> =
            occluders.iter().filter(|o| !o.is_below(self.look.low_m(), rings.near_m, height)).collect();
        let is_hidden = |at: f64, sign: f64| {
            hiding.iter().any(|occluder| occluder.is_at(at) || occluder.is_at(at + sign * BESIDE_RAD))
        };
        let outline = |side, sign: f64| {
            self.outline(samples, &rings, reading.as_ref(), side).filter(|fit| {
                // Beside a nearer robot the edge is the other's.
                !is_hidden(rings.bearing_rad + sign * (half + fit.outwards_rad), sign)
            })
        };
        let (left, right) = (outline(Side::Left, 1.0), outline(Side::Right, -1.0));
        let reading = reading.map(|r| self.confirmed(samples, &rings, r, [left.is_some(), right.is_some()]));
        let is_open = |seen: bool, side: Side, sign: f64| {
            !seen && !is_hidden(rings.bearing_rad + sign * half, sign) && Self::shows_up_to(&rings, side)
        };
        let open = [is_open(left.is_some(), Side::Left, 1.0), is_open(right.is_some(), Side::Right, -1.0)];
        let open_sides = open.into_iter().filter(|is_open| *is_open).count();
        let places = (0..WIDTH_PLACES).map(|k| (2.0 * k as f64 + 1.0) / WIDTH_PLACES as f64 - 1.0);
        let is_free = |share: &f64| !hiding.iter().any(|occluder| occluder.is_at(rings.bearing_rad + share * half));
        let unhidden = places.filter(is_free).count() as f64 / WIDTH_PLACES as f64;
        let goes_on = self.goes_on(samples, &rings);
        Some(Found { rings, reading, left, right, unhidden, open_sides, goes_on })
    }

    fn best_fit(&self, samples: &[Sample], starts: impl Iterator<Item = (f64, f64)>, close: bool) -> Option<RingFit> {
        let score = |fit: &RingFit| fit.visible * fit.correlation;
        starts
            .filter_map(|start| rings::fit(samples, &self.look, start, self.noise2, close))
            .max_by(|a, b| score(a).total_cmp(&score(b)))
    }

    /// Whether what was fitted is a painted cylinder at all.
    fn fits(&self, rings: &RingFit, camera: &MountedCamera) -> bool {
        rings.visible >= LEAST_VISIBLE
            && (BLUR_PX[0]..=BLUR_PX[1]).contains(&rings.blur_px)
            && rings.paint_error(&self.look) <= WORST_PAINT
            && rings.correlation >= LEAST_CORRELATION
            && rings.gain >= LEAST_CONTRAST * rings.noise
            && rings.lower_m.abs() <= HEIGHT_GATE_M + 3.0 * height_sigma_m(rings, camera)
            // A flat poster, or two legs in striped trousers, bend otherwise than a cylinder of the announced radius.
            && rings.bend[0].abs() <= BEND_GATE + 3.5 * rings.bend[1]
    }

    /// An outline that lies where the rings put it, in columns that show the rings.
    fn outline(&self, samples: &[Sample], rings: &RingFit, bars: Option<&Reading>, side: Side) -> Option<EdgeFit> {
        let measured: Vec<bool> =
            rings.columns.iter().filter(|c| c.correlation != 0.0).map(|c| c.visible || c.is_mixed).collect();
        let beside = 3.min(measured.len());
        let shown = match side {
            Side::Left => measured.iter().rev().take(beside).filter(|v| **v).count(),
            Side::Right => measured.iter().take(beside).filter(|v| **v).count(),
        };
        if shown + 1 < beside || beside == 0 {
            return None;
        }
        let fit = edges::fit(samples, &self.look, rings, bars.map(|reading| &reading.signal), side)?;
        let sign = if side == Side::Left { 1.0 } else { -1.0 };
        let range = rings.near_m + self.look.radius_m;
        let by_near = -sign * self.look.radius_m / (range * (range * range - self.look.radius_m.powi(2)).sqrt());
        let c = &rings.covariance;
        let predicted = (c[0][0] + 2.0 * by_near * c[0][1] + by_near * by_near * c[1][1]).max(0.0).sqrt();
        let gate = (0.35 / fit.px_per_rad + 4.0 * predicted.hypot(fit.sigma_rad)).min(1.5 / fit.px_per_rad);
        let fine = fit.agreement >= LEAST_AGREEMENT
            && fit.rows >= 2
            && fit.sigma_rad * fit.px_per_rad <= WORST_EDGE_PX
            && fit.outwards_rad.abs() <= gate;
        let lasting = Outline::of(self.is_barred(bars), rings).lasting_rad(&fit);
        let expected = predicted.hypot(fit.sigma_rad).hypot(lasting);
        let doubt = ((fit.outwards_rad.abs() / expected - OFF[0]) / (OFF[1] - OFF[0])).clamp(0.0, 1.0);
        fine.then_some(EdgeFit { sigma_rad: fit.sigma_rad.hypot(doubt * fit.outwards_rad), ..fit })
    }

    /// Whether bars may be on a body on which this was read.
    fn is_barred(&self, reading: Option<&Reading>) -> bool {
        reading.map_or(self.look.is_barred(), |reading| !self.look.patterns[reading.pattern].bars.is_empty())
    }

    /// The robot that a fit would be.
    fn measured(&self, camera: &MountedCamera, found: &Found) -> Option<Peer> {
        let rings = &found.rings;
        let mount = mount(camera);
        let look = &self.look;
        let body = rings.cylinder(look.radius_m);
        let half = body.outline_rad;
        let (seen, has_bars) = (found.outlines(), found.has_bars());
        let outline = Outline::of(self.is_barred(found.reading.as_ref()), rings);
        let edge = |fit: &Option<EdgeFit>, sign: f64| {
            fit.map(|fit| {
                let bearing = protocol::angle::wrap(rings.bearing_rad + sign * (half + fit.outwards_rad));
                let alone = if seen == 1 { LONE_EDGE_PX } else { 0.0 };
                let lasting = outline.lasting_rad(&fit).hypot(alone / fit.px_per_rad);
                (bearing, fit.sigma_rad, lasting)
            })
        };
        let (left, right) = (edge(&found.left, 1.0), edge(&found.right, -1.0));
        let (elevation_rad, elevation_covariance, elevation_floor) = self.elevations(camera, rings, mount.height_m);
        let floor2 = elevation_floor * elevation_floor;
        let evidence = Evidence {
            left: left.map(|(b, s, f)| [b, s.hypot(f)]),
            right: right.map(|(b, s, f)| [b, s.hypot(f)]),
            middle: [rings.bearing_rad, rings.covariance[0][0].sqrt().hypot(MIDDLE_FLOOR_RAD)],
            elevation_rad,
            elevation_covariance: elevation_covariance + Matrix2::identity() * floor2,
            bars: self.bar_evidence(found.reading.as_ref()),
        };
        let heading = found.reading.as_ref().map_or(0.0, |reading| reading.heading_rad[0]);
        let start = (rings.bearing_rad, body.range_m, heading);
        let position = combine::combine(&evidence, look.radius_m, look.ends_m, &mount, start)?;
        // One sigma for both ends: the larger axis of their covariance, so that nobody takes them for better than they are.
        let white = elevation_covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
        let mut elevation = Some((elevation_rad, white.hypot(elevation_floor), elevation_floor));
        // Without both outlines the rest must carry the answer, and is as doubtful as it fits badly.
        let widening = match seen {
            2 => 1.0,
            _ => {
                let bend = rings.bend[0] / rings.bend[1].max(0.5 * BEND_GATE);
                let by_bars = match &found.reading {
                    Some(reading) if reading.is_clear => reading.misfit.max(1.0),
                    Some(reading) => reading.misfit.max(UNCLEAR),
                    None if look.is_barred() => UNCLEAR,
                    None => 1.0,
                };
                by_bars.max(HALF_HIDDEN) * (0.5 * bend).powi(2).max(1.0)
            }
        };
        let wide = widening.sqrt();
        let mut features = Vec::new();
        for (part, edge) in [(FeaturePart::Right, right), (FeaturePart::Left, left)] {
            if let Some((bearing_rad, white, floor)) = edge {
                let elevation = elevation.take();
                features.push(PeerFeature {
                    part,
                    bearing_rad,
                    sigma_rad: wide * white.hypot(floor),
                    floor_rad: wide * floor,
                    elevation_rad: elevation.map(|e| e.0),
                    elevation_sigma_rad: elevation.map_or(0.0, |e| wide * e.1),
                    elevation_floor_rad: elevation.map_or(0.0, |e| wide * e.2),
                });
            }
        }
        features.splice(features.len().min(1)..features.len().min(1), self.bar_features(found.reading.as_ref()));
        let evidence_share = [0.6, 0.85, 1.0][seen];
        let pattern = found.reading.as_ref().map(|reading| (&look.patterns[reading.pattern], reading));
        Some(Peer {
            kind: pattern.map_or(look.plainest_kind(), |(pattern, _)| pattern.kind),
            robot: pattern.filter(|(_, reading)| reading.is_named).and_then(|(pattern, _)| pattern.robot),
            bearing_rad: position.bearing_rad,
            range_m: position.range_m,
            covariance: position.covariance.fixed_view::<2, 2>(0, 0).into_owned() * widening,
            heading_rad: found.reading.as_ref().filter(|reading| reading.has_heading).map(|reading| match has_bars {
                true => [position.heading_rad, (position.covariance[(2, 2)] * widening).sqrt()],
                false => [reading.heading_rad[0], reading.heading_rad[1].hypot(HEADING_FLOOR_RAD)],
            }),
            confidence: (rings.visible.min(1.0) * rings.correlation).sqrt() * evidence_share,
            features,
        })
    }

    /// Whole bars that were measured by themselves: azimuth, bearing, standard deviation.
    fn bar_evidence(&self, reading: Option<&Reading>) -> Vec<[f64; 3]> {
        // Bars of another pattern, or of another side, would put the body elsewhere.
        let Some(reading) = reading.filter(|reading| reading.is_clear) else { return Vec::new() };
        let bars = &self.look.patterns[reading.pattern].bars;
        let sight = |s: &bars::BarSight| {
            [bars[s.bar].azimuth_rad, s.bearing_rad, s.sigma_rad.hypot(BAR_FLOOR_PX / s.px_per_rad)]
        };
        reading.whole_bars().map(sight).collect()
    }

    /// The same as raw features, with the bar's number where the heading is known.
    fn bar_features(&self, reading: Option<&Reading>) -> Vec<PeerFeature> {
        let feature = |s: &bars::BarSight, is_known: bool| {
            let floor_rad = BAR_FLOOR_PX / s.px_per_rad;
            PeerFeature {
                part: FeaturePart::Bar(u8::try_from(s.bar).ok().filter(|_| is_known)),
                bearing_rad: s.bearing_rad,
                sigma_rad: s.sigma_rad.hypot(floor_rad),
                floor_rad,
                elevation_rad: None,
                elevation_sigma_rad: 0.0,
                elevation_floor_rad: 0.0,
            }
        };
        let reading = reading.filter(|reading| reading.is_clear);
        reading.map_or(Vec::new(), |reading| reading.whole_bars().map(|s| feature(s, reading.has_heading)).collect())
    }

    /// Elevations of the marker's ends on the near surface as from the viewpoint, their covariance, and the bias floor.
    fn elevations(&self, camera: &MountedCamera, rings: &RingFit, height_m: f64) -> ([f64; 2], Matrix2<f64>, f64) {
        let near = rings.near_m;
        let mut jacobian = Matrix2x3::zeros();
        let mut elevation = [0.0; 2];
        for k in 0..2 {
            let drop = self.look.ends_m[k] - height_m - rings.lower_m;
            let square = near * near + drop * drop;
            elevation[k] = drop.atan2(near);
            jacobian[(k, 1)] = -drop / square;
            jacobian[(k, 2)] = -near / square;
        }
        let covariance = Matrix3::from_fn(|i, j| rings.covariance[i][j]);
        let middle = (0.5 * (elevation[0] + elevation[1])).max(camera.camera().elevation_rad()[0]);
        let scale = camera.resolution(rings.bearing_rad, middle).map_or(200.0, |r| r.elevation_px_per_rad);
        (elevation, jacobian * covariance * jacobian.transpose(), ELEVATION_FLOOR_PX / scale)
    }
}

/// Rings with the distance of the upper end of their marker. What either says of the bearing is weighed, and as uncertain as they differ.
fn fused(rings: RingFit, end: &RingFit, radius_m: f64) -> RingFit {
    let [by_rings, by_end] = [rings.covariance[0][0], end.covariance[0][0]];
    let sum = by_rings + by_end;
    let apart = protocol::angle::difference(end.bearing_rad, rings.bearing_rad);
    let doubt = (apart * apart / (sum + MIDDLE_FLOOR_RAD * MIDDLE_FLOOR_RAD)).max(1.0);
    let bearing_var = by_rings * by_end / sum * doubt;
    // Of the end, distance and bearing go together.
    let per_rad = end.covariance[0][1] / by_end;
    let near_m = end.near_m - per_rad * by_end / sum * apart;
    let mut covariance = end.covariance;
    covariance[1][1] += per_rad * per_rad * (bearing_var - by_end);
    covariance[0][0] = bearing_var;
    (covariance[0][1], covariance[1][0]) = (per_rad * bearing_var, per_rad * bearing_var);
    RingFit {
        bearing_rad: protocol::angle::wrap(rings.bearing_rad + by_rings / sum * apart),
        near_m,
        lower_m: end.lower_m,
        covariance,
        half_rad: outline_rad(radius_m, near_m + radius_m),
        ..rings
    }
}

/// How much lower or higher than announced a body may seem, standard deviation: mounting, tilt and fit.
fn height_sigma_m(rings: &RingFit, camera: &MountedCamera) -> f64 {
    let mount = mount(camera);
    mount.height_sigma_m.hypot(mount.tilt_sigma_rad * rings.near_m).hypot(rings.covariance[2][2].sqrt())
}

fn mount(camera: &MountedCamera) -> Mount {
    let sigma = camera.mounting().sigma;
    Mount {
        height_m: camera.viewpoint_body_m().z,
        height_sigma_m: sigma.position_m.z,
        tilt_sigma_rad: sigma.rotation_rpy_rad[0].max(sigma.rotation_rpy_rad[1]),
    }
}

/// What a body that was found hides.
fn occluder(camera: &MountedCamera, find: &Find) -> Occluder {
    let (peer, height_m) = (&find.peer, camera.viewpoint_body_m().z);
    match peer.features[..] {
        // A plate whose sides were measured, the right one first.
        [right, left] if peer.kind == Marker::RECTANGLE => {
            Occluder::sheet([right.bearing_rad, left.bearing_rad], peer.range_m, find.high_m, height_m)
        }
        _ => Occluder::new(peer.bearing_rad, peer.range_m, [find.half_m, find.high_m], height_m),
    }
}

/// Whether two peers cannot both be there.
fn overlap(a: &Peer, b: &Peer, look: &CylinderLook) -> bool {
    a.apart_m(b) < 1.5 * look.radius_m
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(bearing_rad: f64, sigma_rad: f64, by_distance: f64) -> RingFit {
        let (var, both) = (sigma_rad * sigma_rad, by_distance * sigma_rad * sigma_rad);
        let distance = by_distance * both + 1e-4;
        RingFit {
            bearing_rad,
            near_m: 1.0,
            lower_m: 0.0,
            blur_px: 0.85,
            reflectance: Vec::new(),
            covariance: [[var, both, 0.0], [both, distance, 0.0], [0.0, 0.0, 1e-6]],
            noise: 2.0,
            columns: Vec::new(),
            half_rad: 0.17,
            visible: 1.0,
            correlation: 0.99,
            gain: 80.0,
            bend: [0.0, 0.1],
            edges_seen: 1,
            end: None,
        }
    }

    #[test]
    fn rings_and_upper_end_that_agree_are_surer_and_those_that_differ_cover_both() {
        let fuse = |apart_rad: f64| fused(seen(0.0, 0.004, 0.0), &seen(apart_rad, 0.003, 2.0), 0.2);
        let agreed = fuse(0.001);
        assert!(agreed.covariance[0][0].sqrt() < 0.003 && (0.0..0.001).contains(&agreed.bearing_rad));
        let torn = fuse(0.03);
        for truth_rad in [0.0, 0.03] {
            assert!((torn.bearing_rad - truth_rad).abs() < 2.0 * torn.covariance[0][0].sqrt(), "{torn:?}");
        }
        // The end's distance goes with its bearing, and as unsure.
        let moved_m = torn.near_m - 1.0;
        assert!((moved_m - 2.0 * (torn.bearing_rad - 0.03)).abs() < 1e-12);
        assert!(moved_m.abs() < 3.0 * torn.covariance[1][1].sqrt());
    }
}
