//! Following moving objects (report section VI, `MATHS.md` §7.10 and §7.11; golden groups `association`, `bhattacharyya`,
//! `distance.ground`).
//!
//! Objects come from [`crate::motion`] frame by frame, without names; a track keeps a name. In a panorama from a known height
//! it is found again by the figure that a person makes there (see `people`). Elsewhere optimal assignment on position, size
//! and aspect ratio finds it; when people meet, their one region is taken apart by what they looked like alone (see `group`),
//! and after they part, position and frozen appearance say who is who. What leaves here are bearings to the
//! body's axis with honest sigmas, elevation intervals whose ends say what they are, and ranges only from seen feet.

mod association;
mod body;
mod class;
mod expected;
mod extent;
mod figures;
mod filter;
mod group;
mod histogram;
mod looks;
mod lost;
mod pairs;
mod people;
mod proof;
mod range;
#[cfg(test)]
mod reality;
mod shade;
mod told;
mod track;
mod view;

use protocol::angle::{difference, wrap};
use protocol::appearance::Appearance;
use protocol::id::TrackId;
use protocol::message::observation::MAX_TRACKS;
use protocol::message::{AlarmKind, ElevationEnd, ObjectClass, SightedRange, TrackObservation, TrackState};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;

pub use association::{GATE, Shape, ShapeSigmas, assign, cost};
pub use class::PeerBearing;
pub use expected::Expected;
pub use extent::Extent;
use extent::Known;
pub use figures::bodily;
pub use filter::AxisFilter;
pub use histogram::{BINS, Histogram, bhattacharyya};
pub use range::{Range, from_ground_contact};
pub use view::View;

use crate::motion::{Arc, Holds, Object, Patch, Raster, Region, Scene};
use body::Body;
use figures::Figures;
use group::Sought;
use looks::Suspicions;
use lost::LostPeople;
use track::{Track, shape_of};

/// How tracks live.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerSettings {
    /// Spread of the differences of the assignment's cost.
    pub sigmas: ShapeSigmas,
    /// Sightings that make a track of a candidate.
    pub confirm_hits: u32,
    /// A track that nobody sees is lost after so long, seconds.
    pub hidden_s: f64,
    /// The same of one that others cover, seconds: as long as they do it cannot be seen.
    pub behind_s: f64,
    /// A hidden track is published for so long, seconds; one that others cover as long as it is kept.
    pub publish_hidden_s: f64,
    /// A track that has stopped is kept as an object for so long, seconds; then it belongs to the scene.
    pub hold_s: f64,
    /// A track in a group in which nothing speaks for it (it may be behind somebody) is kept for so long, seconds.
    pub unsupported_s: f64,
    /// Whether what is marked near people counts only as far as it is somebody's body and no shadow (see [`bodily`]). Off where that is learnt.
    pub doubts_shadows: bool,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            sigmas: ShapeSigmas::default(),
            confirm_hits: 4,
            hidden_s: 2.5,
            behind_s: 6.0,
            publish_hidden_s: 1.0,
            hold_s: 60.0,
            unsupported_s: 3.0,
            doubts_shadows: true,
        }
    }
}

/// A track as pictures and the offline command want it.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackView {
    /// Which.
    pub id: TrackId,
    /// How it is seen.
    pub state: TrackState,
    /// What it is.
    pub class: ObjectClass,
    /// Columns of its box; its own place in a group.
    pub arc: Arc,
    /// First and last row of the box.
    pub rows: [usize; 2],
    /// Pixels of its region; 0 while hidden.
    pub area_px: usize,
    /// Column of the axis of what is seen; of a body that the picture's side cuts its bearing lies beyond.
    pub axis_column: f64,
    /// To the axis, body frame, radians.
    pub bearing_rad: f64,
    /// One standard deviation.
    pub bearing_sigma_rad: f64,
    /// Elevation interval with its ends, and range.
    pub extent: Extent,
    /// Angular width of the box, radians.
    pub width_rad: f64,
    /// That it is a real moving object, 0 … 1.
    pub confidence: f64,
    /// It was with others of late, and may be somebody else than it was under this number before.
    pub doubtful: bool,
    /// What it looks like by height, in the frames in which it is published.
    pub appearance: Option<[u8; 16]>,
}

/// Follows moving objects from frame to frame.
#[derive(Debug)]
pub struct Tracker {
    raster: Raster,
    view: View,
    settings: TrackerSettings,
    tracks: Vec<Track>,
    areas: Vec<(TrackId, usize)>,
    next_id: u32,
    last: Option<Timestamp>,
    holds: Holds,
    events: Vec<AlarmKind>,
    lost: LostPeople,
    expected: Vec<Expected>,
    suspicions: Suspicions,
    /// Where a person can be told by where he stands; objects are followed by their regions elsewhere.
    figures: Option<Figures>,
}

/// Rows a column of the most slender thing that becomes a track: people have at most nine.
const MOST_SLENDER: f64 = 12.0;
/// How well a figure must fit for its lowest marks to be feet.
const LEAST_SUPPORT_OF_FEET: f64 = 0.7;
/// A figure that has not moved for so long stands and is kept out of the background, seconds; where people walk, the
/// background may go on to learn between them.
const STANDS_S: f64 = 0.3;
/// The same of one beside whom others move, so that what he is seen in moves. Sooner, and what the first frames took for background
/// beside and behind him stays for so much longer.
const STAYS_S: f64 = 3.0;
/// Of a body's box: the least that may be all that is seen of it.
const LEAST_SHARE: f64 = 0.15;
/// Of how far an axis lies beyond what the picture's side leaves of a body, the part that is not known: on average 0.7 to 1.05 of what
/// is computed was found (600 sights at the side of a 60° camera, four mixed teams).
const BEYOND_SIGMA: f64 = 0.6;
/// Breadth of shoulders to the height.
const SHOULDERS_TO_HEIGHT: f64 = 0.25;
/// A track that has never come anywhere and does not move is none after so long, seconds.
const STUCK_S: f64 = 2.0;
/// A new track that is not seen twice is none, but of a fast camera not before so long, seconds.
const TENTATIVE_GAP_S: f64 = 0.15;

/// Who was seen in which object of the frame.
struct Assignment {
    /// For each object the tracks in it (indices).
    members: Vec<Vec<usize>>,
}

impl Tracker {
    /// Nobody is followed yet.
    pub fn new(raster: Raster, view: View, settings: TrackerSettings) -> Self {
        Self {
            figures: Figures::new(&view, &raster),
            raster,
            view,
            settings,
            tracks: Vec::new(),
            areas: Vec::new(),
            next_id: 1,
            last: None,
            holds: Holds::default(),
            events: Vec::new(),
            lost: LostPeople::default(),
            expected: Vec::new(),
            suspicions: Suspicions::default(),
        }
    }

    /// A frame's objects. `peers`: where the peer detector sees fellow robots, now or in the last frame.
    pub fn step(&mut self, scene: &Scene<'_>, capture: Timestamp, peers: &[PeerBearing]) {
        let dt_s = self.last.map_or(0.0, |last| capture.seconds_since(last)).clamp(0.0, 2.0);
        self.last = Some(capture);
        self.lost.forget(capture);
        for track in &mut self.tracks {
            track.predict(dt_s, &self.raster);
        }
        if self.figures.is_some() {
            self.step_people(scene, capture, dt_s, peers);
        } else {
            self.step_regions(scene, capture);
        }
        self.vouch(capture);
        self.measure_extents(scene, peers, capture);
        self.end_tracks(capture);
        self.update_holds(capture);
    }

    /// A frame whose objects are somebody else's detections: each is one body whole, and nothing is joined or taken apart.
    pub fn step_detections(&mut self, scene: &Scene<'_>, capture: Timestamp) {
        let dt_s = self.last.map_or(0.0, |last| capture.seconds_since(last)).clamp(0.0, 2.0);
        self.last = Some(capture);
        for track in &mut self.tracks {
            track.predict(dt_s, &self.raster);
        }
        let bodies: Vec<Body> = scene.objects.iter().map(|o| Body::of_box(&o.region, scene)).collect();
        let looks: Vec<Histogram> = scene.objects.iter().map(|o| Histogram::of(&o.region, scene)).collect();
        let mut members = vec![Vec::new(); bodies.len()];
        // A detector's boxes are where people are: to a pixel and a part of their size.
        let sigmas = ShapeSigmas { x: 1.0, y: 1.0, ..self.settings.sigmas };
        // Who was seen last comes first: a new track must not take an old one's place.
        let (now, before): (Vec<usize>, Vec<usize>) = (0..self.tracks.len()).partition(|&t| self.tracks[t].misses == 0);
        let mut seen = vec![false; self.tracks.len()];
        for group in [now, before] {
            let free: Vec<usize> = (0..bodies.len()).filter(|&o| members[o].is_empty()).collect();
            let some_bodies: Vec<Body> = free.iter().map(|&o| bodies[o].clone()).collect();
            let some_looks: Vec<Histogram> = free.iter().map(|&o| looks[o].clone()).collect();
            let mut some = vec![Vec::new(); free.len()];
            self.match_tracks(&group, &some_bodies, &some_looks, &sigmas, &mut some);
            for (&object, found) in free.iter().zip(some) {
                members[object] = found;
            }
        }
        self.areas.clear();
        for (o, members) in members.iter().enumerate() {
            let area = scene.objects[o].region.area;
            match members[..] {
                [t, ..] => {
                    seen[t] = true;
                    self.areas.push((self.tracks[t].id, area));
                    self.tracks[t].see(&bodies[o], &looks[o], true, capture, &self.raster);
                }
                [] => self.give_birth(&bodies[o], &looks[o], area, capture),
            }
        }
        for (track, seen) in self.tracks.iter_mut().zip(seen) {
            if !seen {
                track.miss();
            }
        }
        self.measure_extents(scene, &[], capture);
        // A detector is believed at once.
        for track in &mut self.tracks {
            track.confirmed = true;
            track.travelled = track.travelled.max(track.shape.w + 1.0);
        }
        self.end_tracks(capture);
    }

    /// A frame in which objects are what their regions are.
    fn step_regions(&mut self, scene: &Scene<'_>, capture: Timestamp) {
        // Whether each moves, and whether it is a ghost.
        let mut traits = Vec::new();
        let mut regions: Vec<Region> = Vec::new();
        for object in self.usable_objects(scene) {
            let bodies = pairs::bodies(&object.region, &self.raster);
            traits.extend(bodies.iter().map(|_| (object.moves, object.is_ghost())));
            regions.extend(bodies);
        }
        let mut bodies: Vec<Body> = regions.iter().map(|r| Body::measure(r, scene)).collect();
        let looks: Vec<Histogram> = regions.iter().map(|r| Histogram::of(r, scene)).collect();

        let assignment = self.assign_objects(&bodies, &looks);
        let leftover = self.join_pieces(&assignment, &mut regions, &mut bodies, scene);
        let mut seen = vec![false; self.tracks.len()];
        self.areas.clear();
        for (object, members) in assignment.members.iter().enumerate() {
            for &t in members {
                seen[t] = true;
                self.areas.push((self.tracks[t].id, regions[object].area));
            }
            match members[..] {
                [] => {}
                [t] if !self.is_more_than(t, &bodies[object]) => {
                    let (moves, _) = traits[object];
                    self.tracks[t].see(&bodies[object], &looks[object], moves, capture, &self.raster);
                }
                _ => self.see_group(members, &bodies[object], capture),
            }
        }
        for (track, seen) in self.tracks.iter_mut().zip(&seen) {
            if !seen {
                track.miss();
            }
        }
        for object in leftover {
            if traits[object] == (true, false) {
                self.give_birth(&bodies[object], &looks[object], regions[object].area, capture);
            }
        }
    }

    /// The robot moves, or there is no background: all tracks end.
    pub fn suspend(&mut self, capture: Timestamp) {
        self.last = Some(capture);
        self.reset();
    }

    /// Forget all tracks, as on a command. Numbers are not used again.
    pub fn reset(&mut self) {
        self.keep_tracks(|_| false);
        self.lost.clear();
        self.areas.clear();
        self.holds = Holds::default();
    }

    /// Where the background must not, or must, learn.
    pub fn holds(&self) -> &Holds {
        &self.holds
    }

    /// Who came and who left since the last call.
    pub fn take_events(&mut self) -> Vec<AlarmKind> {
        std::mem::take(&mut self.events)
    }

    /// The cells of the last frame in which something was marked, where people are followed by their figures.
    pub fn marked_cells(&self) -> Vec<bodily::MarkedCell> {
        self.figures.iter().flat_map(Figures::marked_cells).collect()
    }

    /// The angles of the picture.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The tracks of the last frame that are sure enough to be published, the surest first, at most
    /// [`MAX_TRACKS`].
    pub fn tracks(&self) -> Vec<TrackView> {
        let now = self.last.unwrap_or_default();
        let mut views: Vec<TrackView> = self
            .tracks
            .iter()
            .filter(|t| t.confirmed)
            .filter(|t| {
                let is_recent = now.seconds_since(t.seen) <= self.settings.publish_hidden_s;
                t.state != TrackState::Hidden || t.behind || is_recent
            })
            .filter_map(|t| self.view_of(t))
            .collect();
        views.sort_by(|a, b| b.confidence.total_cmp(&a.confidence).then(a.id.cmp(&b.id)));
        views.truncate(MAX_TRACKS);
        views
    }

    /// The same for the wire.
    pub fn observations(&self) -> Vec<TrackObservation> {
        self.tracks().iter().map(observation).collect()
    }

    fn view_of(&self, track: &Track) -> Option<TrackView> {
        let extent = track.extent?;
        let middle = (track.rows[0] + track.rows[1]) as f64 / 2.0;
        // Where it was at the capture time, if its rows or columns were read sooner or later.
        let delay_s = self.view.delay_s(track.axis, middle);
        let axis = self.raster.wrap_column(track.axis - track.filter.rate * delay_s);
        let (seen_rad, _) = self.view.angles_rad(axis, middle)?;
        let step = self.view.steps_rad(track.axis, middle)[0];
        let axis_sigma = if self.figures.is_some() {
            self.told_sigma_m(track, &extent, self.last.unwrap_or_default()) / (step * track.log_range.exp())
        } else {
            track.axis_sigma
        };
        // Where the axis lies beyond what is seen there may be no angles: as far the other way there are.
        let inside_rad = self.view.angles_rad(axis - track.beyond, middle).map_or(seen_rad, |(inside, _)| inside);
        let bearing_rad = wrap(seen_rad + difference(seen_rad, inside_rad));
        let axis_sigma = axis_sigma.hypot(BEYOND_SIGMA * track.beyond);
        let area_px = self.areas.iter().find(|(id, _)| *id == track.id).map_or(0, |(_, a)| *a);
        Some(TrackView {
            id: track.id,
            state: track.state,
            class: track.class(),
            arc: if track.state == TrackState::Hidden { track.predicted_arc(&self.raster) } else { track.arc },
            rows: track.rows,
            area_px,
            axis_column: axis,
            bearing_rad,
            bearing_sigma_rad: step * axis_sigma.hypot(track.filter.rate_sigma() * delay_s),
            extent,
            width_rad: track.shape.w * step,
            confidence: track.confidence(),
            doubtful: track.looks.in_doubt(),
            appearance: track.looks.told().filter(|_| track.turning_point == self.last).map(Appearance::to_bytes),
        })
    }

    /// Objects that move, or that lie where somebody is followed (who may have stopped). A ghost counts only as somebody who
    /// has come a long way.
    fn usable_objects<'a>(&self, scene: &Scene<'a>) -> Vec<&'a Object> {
        scene
            .objects
            .iter()
            .filter(|o| {
                let near = |t: &&Track| t.predicted_arc(&self.raster).overlap(&o.region.arc, &self.raster) > 0;
                if o.is_ghost() && !o.moves {
                    return self.tracks.iter().filter(near).any(|t| t.confirmed && t.travelled > t.shape.w);
                }
                o.moves || self.tracks.iter().any(|t| near(&t))
            })
            .collect()
    }

    fn assign_objects(&self, bodies: &[Body], looks: &[Histogram]) -> Assignment {
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); bodies.len()];
        let sure: Vec<usize> = (0..self.tracks.len()).filter(|&t| self.tracks[t].confirmed).collect();
        let mut alone = self.match_tracks(&sure, bodies, looks, &self.settings.sigmas, &mut members);
        // Whoever found no object of its own may be in one with somebody else, or have changed its shape.
        for t in alone.drain(..) {
            let track = &self.tracks[t];
            if !track.has_come() {
                continue;
            }
            let arc = track.predicted_arc(&self.raster);
            let share = |b: &Body| {
                let rows = (b.rows[1].min(track.rows[1]) + 1).saturating_sub(b.rows[0].max(track.rows[0]));
                // A scrap where somebody was is not somebody.
                let size = |w: f64, h: f64| w * h;
                let found = shape_of(b);
                let scrap = size(found.w, found.h) < LEAST_SHARE * size(track.shape.w, track.shape.h);
                if rows == 0 || scrap { 0.0 } else { arc.overlap(&b.arc, &self.raster) as f64 / arc.width as f64 }
            };
            let best = (0..bodies.len()).map(|o| (o, share(&bodies[o]))).max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((object, share)) = best
                && share > 0.5
            {
                members[object].push(t);
            }
        }
        // Candidates take what is left.
        let candidates: Vec<usize> = (0..self.tracks.len()).filter(|&t| !self.tracks[t].confirmed).collect();
        let free: Vec<usize> = (0..bodies.len()).filter(|&o| members[o].is_empty()).collect();
        let some_bodies: Vec<Body> = free.iter().map(|&o| bodies[o].clone()).collect();
        let some_looks: Vec<Histogram> = free.iter().map(|&o| looks[o].clone()).collect();
        let mut some_members = vec![Vec::new(); free.len()];
        self.match_tracks(&candidates, &some_bodies, &some_looks, &self.settings.sigmas, &mut some_members);
        for (&object, found) in free.iter().zip(some_members) {
            members[object] = found;
        }
        for list in &mut members {
            list.sort_unstable();
        }
        Assignment { members }
    }

    /// Optimal assignment of some tracks; returns those that found nothing.
    fn match_tracks(
        &self,
        tracks: &[usize],
        bodies: &[Body],
        looks: &[Histogram],
        base: &ShapeSigmas,
        members: &mut [Vec<usize>],
    ) -> Vec<usize> {
        let costs: Vec<Vec<f64>> = tracks
            .iter()
            .map(|&t| {
                let track = &self.tracks[t];
                let parted = track.merged_since.is_some() || track.state == TrackState::Hidden;
                let shape = track.predicted_shape();
                let unsure = if track.merged_since.is_some() { 0.35 * track.group_width } else { 0.0 };
                let sigmas = ShapeSigmas {
                    // Small things are not taken for each other across several times their size.
                    x: base.x.min(0.5 * shape.w + 1.0).max(0.25 * shape.w).hypot(track.filter.sigma()).hypot(unsure),
                    y: base.y.min(0.25 * shape.h + 1.0).max(0.12 * shape.h),
                    ..*base
                };
                bodies
                    .iter()
                    .zip(looks)
                    .map(|(body, look)| {
                        let unlike = if parted { track.histogram.distance(look) / 0.15 } else { 0.0 };
                        cost(&shape, &shape_of(body), &sigmas, &self.raster) + unlike * unlike
                    })
                    .collect()
            })
            .collect();
        let gate = |t: usize| if self.tracks[t].merged_since.is_some() { 2.0 * GATE } else { GATE };
        // One gate for all keeps the assignment optimal; those with a wider one have their costs scaled.
        let scaled: Vec<Vec<f64>> =
            costs.iter().zip(tracks).map(|(row, &t)| row.iter().map(|c| c * GATE / gate(t)).collect()).collect();
        let mut lonely = Vec::new();
        for (&t, object) in tracks.iter().zip(assign(&scaled, GATE)) {
            match object {
                Some(object) => members[object].push(t),
                None => lonely.push(t),
            }
        }
        lonely
    }

    /// Whether an object is so much broader than the track that there must be something else in it.
    fn is_more_than(&self, t: usize, body: &Body) -> bool {
        let track = &self.tracks[t];
        track.confirmed && body.arc.width as f64 > 1.5 * track.shape.w + 4.0
    }

    /// Objects that nobody was assigned: pieces of somebody are joined to them, the others are returned.
    fn join_pieces(
        &self,
        assignment: &Assignment,
        regions: &mut [Region],
        bodies: &mut [Body],
        scene: &Scene<'_>,
    ) -> Vec<usize> {
        let mut leftover = Vec::new();
        for piece in 0..regions.len() {
            if !assignment.members[piece].is_empty() {
                continue;
            }
            let owner = (0..regions.len()).find(|&o| {
                let [t] = assignment.members[o][..] else { return false };
                let track = &self.tracks[t];
                let joint = regions[o].arc.union(&regions[piece].arc, &self.raster);
                track.confirmed
                    && regions[piece].area < regions[o].area
                    && (joint.width as f64) < 1.25 * track.shape.w + 2.0
                    && track.predicted_arc(&self.raster).overlap(&regions[piece].arc, &self.raster) > 0
            });
            match owner {
                Some(o) => {
                    regions[o] = Region::joined(&[&regions[o], &regions[piece]], &self.raster);
                    bodies[o] = Body::measure(&regions[o], scene);
                }
                None => leftover.push(piece),
            }
        }
        leftover
    }

    fn see_group(&mut self, members: &[usize], body: &Body, now: Timestamp) {
        let placed = {
            let sought: Vec<Sought<'_>> = members
                .iter()
                .map(|&t| {
                    let track = &self.tracks[t];
                    Sought {
                        template: &track.template,
                        axis_offset: track.axis_offset,
                        predicted: track.filter.column,
                        sigma: track.filter.sigma().max(1.0),
                    }
                })
                .collect();
            group::place(&body.strip, &sought, &self.raster)
        };
        for (&t, placed) in members.iter().zip(placed) {
            self.tracks[t].see_merged(&placed, body.arc, body.rows, now, &self.raster);
        }
    }

    fn give_birth(&mut self, body: &Body, look: &Histogram, area: usize, now: Timestamp) {
        let shape = shape_of(body);
        if self.tracks.len() >= association::MAX_SIDE || shape.h > MOST_SLENDER * shape.w {
            return;
        }
        let id = self.next_track_id();
        self.tracks.push(Track::new(id, body, look.clone(), now, &self.raster));
        self.areas.push((id, area));
    }

    fn next_track_id(&mut self) -> TrackId {
        let id = TrackId(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        id
    }

    fn measure_extents(&mut self, scene: &Scene<'_>, peers: &[PeerBearing], now: Timestamp) {
        for track in &mut self.tracks {
            if track.state == TrackState::Hidden {
                track.beyond = 0.0;
                // What was measured is now a bound at best.
                if let Some(extent) = &mut track.extent {
                    extent.ends = extent.ends.map(|e| if e == ElevationEnd::Seen { ElevationEnd::Hidden } else { e });
                    extent.range = None;
                }
                continue;
            }
            let shared = track.state == TrackState::Merged;
            let middle = (track.rows[0] + track.rows[1]) as f64 / 2.0;
            let step = self.view.steps_rad(track.axis, middle)[0];
            let width_rad = if shared { track.shape.w } else { track.arc.width as f64 } * step;
            let trunk_rad = track.trunk_width * step;
            let figure_m = self.figures.is_some().then(|| track.average_m.unwrap_or(track.log_range.exp()));
            let feet = figure_m.is_none() || (!track.feet_hidden && track.support > LEAST_SUPPORT_OF_FEET);
            let person = !matches!(track.class(), ObjectClass::Robot | ObjectClass::Other);
            let known = Known { width_rad: trunk_rad.min(width_rad), shared, person, figure_m, feet, head: track.head };
            let extent = extent::measure(scene, &self.view, track.axis, track.rows, &known);
            track.extent = Some(extent);
            let breadth = if figure_m.is_some() {
                track.trunk_width
            } else {
                track.trunk_width.max(SHOULDERS_TO_HEIGHT * track.shape.h)
            };
            track.beyond = extent::beyond_side(scene, track.axis, 0.5 * breadth, &track.patch());
            if !shared && let Some((bearing, _)) = self.view.angles_rad(track.axis, middle) {
                track.votes.add(class::of_one_sight(bearing, width_rad, &extent, &self.view, peers));
            }
            // Ghosts and flicker stay where they are born; people do not.
            let comes = track.moving_hits >= self.settings.confirm_hits || track.looks.in_doubt() && track.has_come();
            let comes = comes && (self.figures.is_some() || track.goes_somewhere());
            let comes = comes || track.vouched_hits >= self.settings.confirm_hits || track.is_solid();
            if !track.confirmed && track.hits >= self.settings.confirm_hits && comes {
                track.confirmed = true;
                track.turning_point = Some(now);
            }
            if track.confirmed && !track.announced && track.class() == ObjectClass::Person {
                track.announced = true;
                self.events.push(AlarmKind::PersonAppeared(track.id));
            }
        }
    }

    fn end_tracks(&mut self, now: Timestamp) {
        let TrackerSettings { hidden_s, behind_s, unsupported_s, .. } = self.settings;
        let raster = self.raster;
        self.keep_tracks(|t| {
            if t.confirmed {
                let left = t.misses > 0 && t.has_left(&raster);
                let most_s = match (t.has_come(), t.behind) {
                    (true, true) => [behind_s, behind_s],
                    (true, false) => [hidden_s, unsupported_s],
                    (false, _) => [hidden_s, 0.5],
                };
                !left
                    && now.seconds_since(t.seen) <= most_s[0]
                    && now.seconds_since(t.supported) <= most_s[1]
                    && (t.has_come() || now.seconds_since(t.moved.max(t.vouched)) <= STUCK_S)
            } else {
                let missed = t.misses >= 2 && now.seconds_since(t.seen) >= TENTATIVE_GAP_S;
                !missed && now.seconds_since(t.born) <= STUCK_S
            }
        });
    }

    /// Ends the other tracks, and says so of those that were announced.
    fn keep_tracks(&mut self, keep: impl Fn(&Track) -> bool) {
        let (events, lost) = (&mut self.events, &mut self.lost);
        let now = self.last.unwrap_or_default();
        self.tracks.retain(|t| {
            let keep = keep(t);
            if !keep {
                lost.note(t, now);
            }
            if !keep && t.announced {
                events.push(AlarmKind::PersonLeft(t.id));
            }
            keep
        });
    }

    fn update_holds(&mut self, now: Timestamp) {
        let Holds { keep, recognised, release } = &mut self.holds;
        for patches in [&mut *keep, recognised, release] {
            patches.clear();
        }
        keep.extend(self.lost.patches());
        for track in self.tracks.iter().filter(|t| t.confirmed) {
            let patch: Patch = track.patch();
            if track.has_come() && track.as_afoot && track.state != TrackState::Hidden {
                recognised.push(patch);
            }
            if now.seconds_since(track.moved) > self.settings.hold_s {
                release.push(patch);
            } else if now.seconds_since(track.seen) <= 1.0
                && track.has_come()
                && (self.figures.is_none()
                    || now.seconds_since(track.moved) > STANDS_S
                    || track.stayed_s(now) > STAYS_S)
            {
                keep.push(patch);
            }
        }
    }
}

fn observation(view: &TrackView) -> TrackObservation {
    TrackObservation {
        track: view.id,
        state: view.state,
        bearing: Angle16::from_rad(view.bearing_rad),
        bearing_sigma: LogSigma::from_value(view.bearing_sigma_rad),
        elevation: view.extent.elevation_rad.map(Angle16::from_rad),
        elevation_sigma: LogSigma::from_value(view.extent.sigma_rad),
        ends: view.extent.ends,
        width: Angle16::from_rad(view.width_rad),
        range: view
            .extent
            .range
            .map(|r| SightedRange { range: Millimetres::from_m(r.range_m), sigma: LogSigma::from_value(r.sigma_m) }),
        class: view.class,
        confidence: Fraction8::from_value(view.confidence),
        doubtful: view.doubtful,
        appearance: view.appearance,
    }
}
