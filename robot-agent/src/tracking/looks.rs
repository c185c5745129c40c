//! Who a track is, by what it looks like: whether people who were in one place went on under each other's numbers.
//!
//! Where somebody stands says who he is as long as nobody is near. In the picture people pass through each other, and which
//! figure goes on with which track is then a guess. So what a track looks like is learnt while it is apart from others; once
//! it has been with others (or unseen), it is in doubt until it has been apart again for some frames, and then compared: with
//! itself before, and with those who were in doubt with it.

use protocol::appearance::{Appearance, BAND_M, BANDS, Band};
use protocol::id::TrackId;

use super::View;
use super::track::Track;
use crate::motion::{Region, Scene};

/// Half of the breadth that is looked at, metres: no arms.
const HALF_M: f64 = 0.2;
/// Fewest pixels of a band that is seen.
const LEAST_PIXELS: f64 = 12.0;
/// Fewest pixels below another that tell of a band's grain.
const LEAST_PAIRS: f64 = 8.0;
/// Frames apart from which on somebody is known, and sights of somebody in doubt that are enough to decide.
const KNOWN_SIGHTS: u32 = 5;
const DECIDING_SIGHTS: u32 = 10;
/// Sights after which the partner of an exchange is not waited for any more.
const PATIENT_SIGHTS: u32 = 20;
/// How fast looks follow a sight, at least.
const FOLLOW_RECENT: f64 = 0.15;
const FOLLOW_KNOWN: f64 = 0.03;
const FOLLOW_AFOOT: f64 = 0.05;
/// What must speak for somebody who stands being whom he was as he walked, nats.
const AS_AFOOT: f64 = 0.5;
/// Gain of an exchange that is believed, nats.
const EXCHANGED: f64 = 1.0;
/// How much each of two who were exchanged looks like the other at least, nats.
const LEAST_LIKE_OTHER: f64 = -1.0;
/// Somebody so unlike himself before is somebody else, nats.
const SOMEBODY_ELSE: f64 = -5.0;
/// Sights at which what is known is told anew, and of somebody in doubt what comes out.
const TOLD_AT: [u32; 2] = [12, 40];
const TOLD_OUT_AT: [u32; 4] = [3, 7, 15, 31];

/// What an upright person looks like, whose axis and distance are known.
pub(super) fn appearance(region: &Region, scene: &Scene<'_>, view: &View, axis: f64, range_m: f64) -> Appearance {
    let width = scene.raster.width;
    let camera_m = view.height_m.map_or(0.6, |(h, _)| h);
    let mut sums = [[0.0; 3]; BANDS];
    // Pixels below another of somebody, and by how much they differ from it.
    let mut steps = [[0.0; 2]; BANDS];
    for (row, start, len) in region.spans() {
        let Some((_, elevation)) = view.angles_rad(axis, row as f64) else { continue };
        let band = (camera_m + range_m * elevation.tan()) / BAND_M;
        if !(0.0..BANDS as f64).contains(&band) {
            continue;
        }
        let half = HALF_M / range_m / view.steps_rad(axis, row as f64)[0];
        let first = scene.raster.column_difference(start as f64, axis);
        let skipped = (-half - first).ceil().max(0.0) as usize;
        let end = ((half - first).floor() + 1.0).clamp(0.0, len as f64) as usize;
        let (sum, steps) = (&mut sums[band as usize], &mut steps[band as usize]);
        for at in (row * width + start..).take(len).take(end).skip(skipped) {
            let p = f64::from(scene.picture[at]);
            for (s, v) in sum.iter_mut().zip([1.0, p, p * p]) {
                *s += v;
            }
            if let Some(above) = at.checked_sub(width).filter(|above| scene.mask[*above] != 0) {
                steps[0] += 1.0;
                steps[1] += (p - f64::from(scene.picture[above])).abs();
            }
        }
    }
    let mut bands = sums.into_iter().zip(steps).map(|([n, sum, squares], [pairs, steps])| {
        (n >= LEAST_PIXELS).then(|| {
            let mean = sum / n;
            let band = Band::of(mean, (squares / n - mean.powi(2)).max(0.0).sqrt());
            Band { grain: (pairs >= LEAST_PAIRS).then(|| steps / pairs / mean.max(1.0)), ..band }
        })
    });
    Appearance(std::array::from_fn(|_| bands.next().flatten()))
}

/// What a track looks like.
#[derive(Debug, Clone, Default)]
pub(super) struct Looks {
    known: Appearance,
    sights: u32,
    /// Since it was last with others.
    recent: Appearance,
    recent_sights: u32,
    doubtful: bool,
    /// In doubt, since most of it was last hidden, beside others or not.
    out: (Appearance, u32),
    /// While it moved, apart from others, and in how many sights: no ghost looks like this.
    afoot: (Appearance, u32),
}

impl Looks {
    /// A sight apart from others. Whether what is known should be told.
    pub(super) fn see(&mut self, now: &Appearance) -> bool {
        self.recent_sights += 1;
        self.recent.follow(now, (1.0 / f64::from(self.recent_sights)).max(FOLLOW_RECENT));
        if self.doubtful {
            return false;
        }
        self.sights += 1;
        self.known.follow(now, (1.0 / f64::from(self.sights)).max(FOLLOW_KNOWN));
        TOLD_AT.contains(&self.sights)
    }

    /// The same of somebody who moves.
    pub(super) fn see_afoot(&mut self, now: &Appearance) {
        let (looks, sights) = &mut self.afoot;
        *sights += 1;
        looks.follow(now, (1.0 / f64::from(*sights)).max(FOLLOW_AFOOT));
    }

    /// The same of somebody in doubt, beside others or not; `None` where most of it is hidden. Whether that should be told.
    pub(super) fn see_out(&mut self, now: Option<&Appearance>) -> bool {
        let (looks, sights) = &mut self.out;
        let Some(now) = now.filter(|_| self.doubtful) else {
            self.out = Default::default();
            return false;
        };
        *sights += 1;
        looks.follow(now, (1.0 / f64::from(*sights)).max(FOLLOW_RECENT));
        TOLD_OUT_AT.contains(sights)
    }

    /// Whether it looks as it did while it walked: what is left in the background by somebody who stood there would not.
    pub(super) fn is_as_afoot(&self, now: &Appearance) -> bool {
        let (looks, sights) = &self.afoot;
        *sights >= DECIDING_SIGHTS && looks.log_ratio(now) > AS_AFOOT
    }

    /// It is with others, or not seen: it may go on as somebody else.
    pub(super) fn doubt(&mut self) {
        self.doubtful = self.sights >= KNOWN_SIGHTS;
        if !self.doubtful {
            (self.known, self.sights) = (Appearance::default(), 0);
        }
        (self.recent, self.recent_sights) = (Appearance::default(), 0);
    }

    /// It is not seen at all.
    pub(super) fn hide(&mut self) {
        self.doubt();
        self.out = Default::default();
    }

    /// What is known of it; `None` where that is too little to be told.
    pub(super) fn known(&self) -> Option<&Appearance> {
        (self.known.seen() >= 2).then_some(&self.known)
    }

    /// The same where it was seen apart for long enough to be told from others.
    pub(super) fn firm(&self) -> Option<&Appearance> {
        self.known().filter(|_| self.sights >= KNOWN_SIGHTS)
    }

    /// What is told of it: in doubt what comes out, which tells others who it is.
    pub(super) fn told(&self) -> Option<&Appearance> {
        if self.doubtful { Some(&self.out.0).filter(|out| out.seen() >= 2) } else { self.known() }
    }

    /// Whether it may be somebody else than it was.
    pub(super) fn in_doubt(&self) -> bool {
        self.doubtful
    }

    fn is_seen(&self) -> bool {
        self.recent_sights >= DECIDING_SIGHTS
    }

    fn settle(&mut self) {
        self.doubtful = false;
        self.known.follow(&self.recent, 0.1);
    }
}

/// Mean gain of an exchange over the last frames that is believed, nats, and how fast it follows a frame.
const SURELY_EXCHANGED: f64 = 2.2;
const FOLLOW_GAIN: f64 = 0.5;
/// The same in the first frames that show both, after one of them was covered: who is who was a guess then, and a wrong one costs
/// as much as a wrong exchange.
const LIKELY_EXCHANGED: f64 = 0.8;
const FIRST_SIGHTS: u32 = 3;

/// Of tracks that are in doubt together, how much speaks for their going on under each other's numbers, of late since they were
/// beside each other: who has exchanged places with whom shows as soon as both come out, long before either is apart from
/// everybody. Frames err alike, where a part of somebody is hidden or somebody else's: that many of them say so tells little more
/// than that one does, and a sum over them would in the end believe any small gain.
#[derive(Debug, Clone, Default)]
pub(super) struct Suspicions {
    pairs: Vec<Suspicion>,
    frame: u32,
}

#[derive(Debug, Clone)]
struct Suspicion {
    pair: [TrackId; 2],
    /// Mean gain.
    mean: f64,
    /// The last frame that showed both, and how many in a row did until then.
    frame: u32,
    sights: u32,
}

impl Suspicions {
    /// Begins a frame. Those who are not in doubt are not suspected.
    pub(super) fn keep(&mut self, in_doubt: impl Fn(TrackId) -> bool) {
        self.frame = self.frame.wrapping_add(1);
        self.pairs.retain(|s| s.pair.iter().all(|t| in_doubt(*t)));
    }

    /// A frame that shows two tracks, which are `beside` each other or not, and looks by `nats` more like their being each
    /// other than like their being themselves; `clearly` it shows both, 0 to 1. Whether they were exchanged.
    pub(super) fn weigh(&mut self, a: TrackId, b: TrackId, beside: bool, nats: f64, clearly: f64) -> bool {
        let pair = [a.min(b), a.max(b)];
        let known = self.pairs.iter().position(|s| s.pair == pair);
        let Some(k) = known.or_else(|| {
            beside.then(|| self.pairs.push(Suspicion { pair, mean: 0.0, frame: self.frame, sights: 0 }))?;
            Some(self.pairs.len() - 1)
        }) else {
            return false;
        };
        let Suspicion { mean, frame, sights, .. } = &mut self.pairs[k];
        *sights = if self.frame.wrapping_sub(*frame) > 1 { 1 } else { sights.saturating_add(1) };
        *frame = self.frame;
        // A part of the other is easily taken for somebody's own as he comes out.
        let (weight, believed) =
            if *sights <= FIRST_SIGHTS { (clearly, LIKELY_EXCHANGED) } else { (1.0, SURELY_EXCHANGED) };
        let follow = if *sights == 1 { 1.0 } else { FOLLOW_GAIN };
        *mean += follow * (weight * nats - *mean);
        let exchanged = *mean > believed;
        if exchanged {
            *mean = -SURELY_EXCHANGED;
        }
        exchanged
    }
}

/// By how much two sights look more like each other's owners than like their own, nats; where one of them does not look like the
/// other's owner at all, a third person is in it, and nothing speaks for an exchange.
pub(super) fn exchange_gain(now: [&Appearance; 2], known: [&Appearance; 2]) -> f64 {
    let fit = |a: usize, b: usize| now[a].log_ratio(known[b]);
    let gain = fit(0, 1) + fit(1, 0) - fit(0, 0) - fit(1, 1);
    if fit(0, 1).min(fit(1, 0)) < LEAST_LIKE_OTHER { gain.min(0.0) } else { gain }
}

/// What became of a track in doubt.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Verdict {
    /// It is who it was.
    Same,
    /// It and this other go on under each other's number.
    Exchanged(usize),
    /// Nobody that is known.
    SomebodyElse,
}

/// Decides on a track that has been in doubt and is seen apart again; `None` while that is too early. `all`: the looks of all
/// tracks and whether they are confirmed.
fn judge(all: &[(&Looks, bool)], t: usize) -> Option<Verdict> {
    let me = all[t].0;
    if !me.doubtful || !me.is_seen() {
        return None;
    }
    let same = me.recent.log_ratio(&me.known);
    let in_doubt_too = || all.iter().enumerate().filter(|(o, (you, confirmed))| *o != t && you.doubtful && *confirmed);
    let gain = |you: &Looks| exchange_gain([&me.recent, &you.recent], [&me.known, &you.known]);
    let seen = in_doubt_too().filter(|(_, (you, _))| you.is_seen()).map(|(o, (you, _))| (o, gain(you)));
    if let Some((o, _)) = seen.filter(|(_, gain)| *gain > EXCHANGED).max_by(|a, b| a.1.total_cmp(&b.1)) {
        return Some(Verdict::Exchanged(o));
    }
    if me.recent_sights < PATIENT_SIGHTS && in_doubt_too().any(|(_, (you, _))| !you.is_seen()) {
        return None;
    }
    Some(if same < SOMEBODY_ELSE { Verdict::SomebodyElse } else { Verdict::Same })
}

/// Acts on the verdicts; gives the tracks whose looks should be told. `new_id` numbers who is nobody that was known.
pub(super) fn settle(tracks: &mut [Track], mut new_id: impl FnMut() -> TrackId) -> Vec<usize> {
    let mut told = Vec::new();
    for t in 0..tracks.len() {
        let all: Vec<(&Looks, bool)> = tracks.iter().map(|t| (&t.looks, t.confirmed)).collect();
        match judge(&all, t) {
            None => continue,
            Some(Verdict::Same) => {}
            Some(Verdict::Exchanged(o)) => {
                exchange(tracks, t, o);
                tracks[o].looks.settle();
                told.push(o);
            }
            Some(Verdict::SomebodyElse) => {
                let track = &mut tracks[t];
                track.id = new_id();
                track.looks.known = track.looks.recent;
                track.looks.sights = track.looks.recent_sights;
                track.looks.afoot = (Appearance::default(), 0);
                track.announced = false;
            }
        }
        tracks[t].looks.settle();
        told.push(t);
    }
    told
}

/// Numbers and what belongs to a person and not to a place.
pub(super) fn exchange(tracks: &mut [Track], a: usize, b: usize) {
    let [a, b] = {
        let (low, high) = (a.min(b), a.max(b));
        let (left, right) = tracks.split_at_mut(high);
        [&mut left[low], &mut right[0]]
    };
    std::mem::swap(&mut a.id, &mut b.id);
    std::mem::swap(&mut a.announced, &mut b.announced);
    std::mem::swap(&mut a.figure_shape, &mut b.figure_shape);
    std::mem::swap(&mut a.looks.known, &mut b.looks.known);
    std::mem::swap(&mut a.looks.sights, &mut b.looks.sights);
    std::mem::swap(&mut a.looks.afoot, &mut b.looks.afoot);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clothes(trousers: f64, shirt: f64) -> Appearance {
        Appearance(std::array::from_fn(|i| Some(Band::of(if i < 4 { trousers } else { shirt }, 10.0))))
    }

    /// Somebody who is known, was with others, and has been seen apart again for some frames.
    fn met(before: &Appearance, after: &Appearance, frames: u32) -> Looks {
        let mut looks = Looks::default();
        for _ in 0..20 {
            looks.see(before);
        }
        looks.doubt();
        for _ in 0..frames {
            looks.see(after);
        }
        looks
    }

    #[test]
    fn who_goes_on_as_whom_is_told_by_the_clothes() {
        let (dark, bright) = (clothes(25.0, 60.0), clothes(60.0, 150.0));
        let judged = |pairs: [(&Appearance, &Appearance); 2], frames| {
            let [a, b] = pairs.map(|(before, after)| met(before, after, frames));
            judge(&[(&a, true), (&b, true)], 0)
        };
        assert_eq!(judged([(&dark, &dark), (&bright, &bright)], 12), Some(Verdict::Same));
        assert_eq!(judged([(&dark, &bright), (&bright, &dark)], 12), Some(Verdict::Exchanged(1)));
        assert_eq!(judged([(&dark, &bright), (&bright, &dark)], 3), None, "too early");
        // Two who look alike keep their numbers.
        assert_eq!(judged([(&dark, &dark), (&dark, &dark)], 12), Some(Verdict::Same));
        // In brighter light he may look so; in a bright skirt and a dark shirt not.
        let stranger = met(&dark, &clothes(90.0, 30.0), 12);
        assert_eq!(judge(&[(&stranger, true)], 0), Some(Verdict::SomebodyElse));
    }

    #[test]
    fn who_comes_out_under_another_s_number_is_found_out_at_once() {
        let (dark, bright) = (clothes(25.0, 60.0), clothes(60.0, 150.0));
        let [a, b] = [TrackId(1), TrackId(2)];
        let (own, others) =
            (exchange_gain([&dark, &bright], [&dark, &bright]), exchange_gain([&bright, &dark], [&dark, &bright]));
        let mut suspicions = Suspicions::default();
        let mut frame = |beside, nats| {
            suspicions.keep(|_| true);
            suspicions.weigh(a, b, beside, nats, 1.0)
        };
        assert!(!frame(false, others), "they were never beside each other");
        assert!((0..50).all(|_| !frame(true, own)));
        let frames = (1..10).find(|_| frame(false, others));
        assert!(frames.is_some_and(|n| n <= 3), "{frames:?}");
        // Whoever looks alike is not exchanged, nor who looks a little like the other for ever so long.
        let alike = exchange_gain([&dark, &dark], [&dark, &dark]);
        for nats in [alike, 0.9 * SURELY_EXCHANGED] {
            assert!((0..50).all(|_| !frame(true, nats)), "{nats}");
        }
    }

    #[test]
    fn who_is_who_is_decided_anew_after_one_was_covered_by_frames_that_show_both() {
        let [a, b] = [TrackId(1), TrackId(2)];
        let exchanged = |frames: &[(f64, f64)]| {
            let mut suspicions = Suspicions::default();
            for _ in 0..20 {
                suspicions.keep(|_| true);
                assert!(!suspicions.weigh(a, b, true, -4.0, 1.0));
            }
            // One covers the other.
            suspicions.keep(|_| true);
            frames.iter().position(|(nats, clearly)| {
                suspicions.keep(|_| true);
                suspicions.weigh(a, b, true, *nats, *clearly)
            })
        };
        // Far less than what it takes while both are seen all the time.
        assert_eq!(exchanged(&[(1.2, 1.0)]), Some(0));
        // Somebody of whom a part comes out has some of the other in it.
        assert_eq!(exchanged(&[(2.6, 0.2), (-0.1, 0.8), (-0.7, 1.0), (-1.5, 1.0)]), None);
        assert_eq!(exchanged(&[(0.8, 0.5), (2.8, 1.0)]), Some(1));
        // Later it is not a guess any more.
        assert_eq!(exchanged(&[(-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0), (1.2, 1.0), (1.2, 1.0), (1.2, 1.0)]), None);
    }

    #[test]
    fn two_are_not_exchanged_where_one_of_them_is_a_third_person() {
        let (dark, bright, striped) = (clothes(25.0, 60.0), clothes(60.0, 150.0), clothes(160.0, 30.0));
        let known = [&dark, &bright];
        assert!(exchange_gain([&bright, &dark], known) > SURELY_EXCHANGED);
        // The first looks like the second was, but the second like neither.
        assert!(exchange_gain([&bright, &striped], known) <= 0.0);
    }

    #[test]
    fn in_doubt_it_tells_what_comes_out_and_not_what_it_was() {
        let (dark, bright) = (clothes(25.0, 60.0), clothes(60.0, 150.0));
        let mut looks = Looks::default();
        for _ in 0..20 {
            looks.see(&dark);
            assert!(!looks.see_out(Some(&dark)), "beyond doubt that is told by what is known");
        }
        let resembles = |looks: &Looks, whom: &Appearance| looks.told().map(|told| told.log_ratio(whom) > 1.0);
        assert_eq!(resembles(&looks, &dark), Some(true));
        looks.doubt();
        assert_eq!(looks.told(), None);
        let told = (1..=8).filter(|_| looks.see_out(Some(&bright))).count();
        assert_eq!(told, 2, "after three sights and after seven");
        assert_eq!((resembles(&looks, &bright), resembles(&looks, &dark)), (Some(true), Some(false)));
        // Hidden again, the next who comes out may be another.
        looks.hide();
        assert_eq!(looks.told(), None);
    }

    #[test]
    fn who_was_hardly_seen_before_has_no_past() {
        let (dark, bright) = (clothes(25.0, 60.0), clothes(60.0, 150.0));
        let mut looks = Looks::default();
        looks.see(&dark);
        looks.doubt();
        for _ in 0..12 {
            looks.see(&bright);
        }
        assert!(!looks.in_doubt());
        assert!(looks.known().unwrap().log_ratio(&bright) > 1.0);
    }
}
