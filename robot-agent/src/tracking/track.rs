//! One track: its identity, its filter and its life.
//!
//! ```text
//!            seen CONFIRM_HITS times                    alone again
//! tentative ───────────────────────▶ visible ◀──────────────────────── merged
//!     │ missed twice                   │   ▲ seen again   one region      ▲
//!     ▼                     not seen   ▼   │              with others     │
//!   gone                             hidden ──── HIDDEN_S ───▶ lost       │
//!                                      └──────────────────────────────────┘
//! ```

use protocol::appearance::Appearance;
use protocol::id::TrackId;
use protocol::message::{ObjectClass, TrackState};
use protocol::time::Timestamp;

use super::association::Shape;
use super::body::{Body, Strip};
use super::class::Votes;
use super::extent::Extent;
use super::figures::{Shape as FigureShape, Sought};
use super::filter::AxisFilter;
use super::group::Placed;
use super::histogram::Histogram;
use super::looks::Looks;
use super::lost::Stand;
use super::people::SHOULDERS_M;
use super::proof::Proof;
use super::shade::Shaded;
use super::told::{Agreement, Manner};
use crate::motion::{Arc, Patch, Raster};

/// Who moves aside by less than this part of his shoulders' breadth in a second stands.
const STANDING_RATE: f64 = 0.4;
/// Part of the usual acceleration that is expected of who stands.
const STEADY: f64 = 0.25;
/// Sightings in which somebody stands out of the background, after which he has come from somewhere: born as he stopped.
const SOLID_HITS: u32 = 8;
/// Sightings that are no shadow, after which it has a body.
const BODILY_HITS: u32 = 5;

/// A moving object that is followed.
#[derive(Debug, Clone)]
pub(super) struct Track {
    pub(super) id: TrackId,
    pub(super) confirmed: bool,
    pub(super) state: TrackState,
    pub(super) filter: AxisFilter,
    /// Smoothed centre row, width and height; x is not used.
    pub(super) shape: Shape,
    /// Where it was last seen, alone or in a group.
    pub(super) arc: Arc,
    pub(super) rows: [usize; 2],
    /// It is not seen, and others cover where it should be.
    pub(super) behind: bool,
    /// Columns of its trunk when it was last alone.
    pub(super) trunk_width: f64,
    /// Its strip when it was last alone, and the axis' offset in it.
    pub(super) template: Strip,
    pub(super) axis_offset: f64,
    pub(super) histogram: Histogram,
    pub(super) looks: Looks,
    /// Where it stood when it was last seen apart from others, standing.
    pub(super) stand: Option<Stand>,
    /// When and in which column it was last seen apart from others.
    pub(super) last_apart: (Timestamp, f64),
    /// Column of the axis and its sigma as published for this frame.
    pub(super) axis: f64,
    pub(super) axis_sigma: f64,
    /// How far the body's axis lies beyond `axis`, columns, where the picture's side cuts through it.
    pub(super) beyond: f64,
    pub(super) extent: Option<Extent>,
    pub(super) votes: Votes,
    pub(super) hits: u32,
    pub(super) misses: u32,
    /// When the team last saw it, too, and in how many sightings.
    pub(super) vouched: Timestamp,
    pub(super) vouched_hits: u32,
    /// Sightings in which it stood, nobody in front, with an outline that is in the picture and not in the background.
    pub(super) solid_hits: u32,
    /// Sights of it that were no shadow, however little spoke for one.
    bodily_hits: u32,
    /// Whether it is known to have a body.
    pub(super) proof: Proof,
    /// Sightings in which it moved and was no ghost.
    pub(super) moving_hits: u32,
    /// When something in a picture last spoke for it.
    pub(super) supported: Timestamp,
    pub(super) born: Timestamp,
    /// Where it was born: how far has it come?
    pub(super) born_at: f64,
    pub(super) travelled: f64,
    /// Row of its middle where it was born, and how far it has come along columns and rows (by regions only).
    pub(super) born_row: f64,
    pub(super) gone: f64,
    pub(super) seen: Timestamp,
    pub(super) moved: Timestamp,
    /// Where it stays, and since when: others who pass it move, it does not.
    stays: (f64, Timestamp),
    /// Since when it has been in groups without a break.
    pub(super) merged_since: Option<Timestamp>,
    /// Width of the group it was in when it was last seen there.
    pub(super) group_width: f64,
    /// Frame of its last birth, merge or split: then its appearance is sent.
    pub(super) turning_point: Option<Timestamp>,
    pub(super) announced: bool,
    /// How well its figure fits the marks that are its own: 1 as an average person would.
    pub(super) support: f64,
    /// A fellow robot may stand before its feet.
    pub(super) feet_hidden: bool,
    /// Its upper end is as narrow as a head.
    pub(super) head: bool,
    /// How its figures agree with each other.
    pub(super) agreement: Agreement,
    /// It looked, last, as it did while it walked.
    pub(super) as_afoot: bool,
    /// Logarithm of the distance in metres that its figure has, and its sigma.
    pub(super) log_range: f64,
    pub(super) log_range_sigma: f64,
    /// How far away an average person would be who is seen like it; unknown in the company of others.
    pub(super) average_m: Option<f64>,
    pub(super) figure_shape: FigureShape,
    /// What its figures explained of late that no senior did, 0 … about 1.
    pub(super) evidence: f64,
}

/// A person in a frame.
#[derive(Debug, Clone)]
pub(super) struct Sighting {
    /// Column of the axis and its sigma.
    pub(super) axis: f64,
    pub(super) axis_sigma: f64,
    pub(super) arc: Arc,
    pub(super) rows: [usize; 2],
    /// Distance at which the figure fits; of no meaning where there are none.
    pub(super) range_m: f64,
    /// Columns of shoulders at that distance.
    pub(super) trunk_width: f64,
    /// Nobody in front; nobody in front, behind or beside.
    pub(super) alone: bool,
    pub(super) apart: bool,
    pub(super) moves: bool,
    /// It stands and its outline is in the picture, not in the background.
    pub(super) solid: bool,
    /// How well the figure fits: 1 as an average person.
    pub(super) support: f64,
    /// A fellow robot may stand before the feet.
    pub(super) feet_hidden: bool,
    /// The upper end is as narrow as a head.
    pub(super) head: bool,
    pub(super) appearance: Appearance,
    pub(super) manner: Manner,
}

impl Sighting {
    /// How well this frame tells the distance (sigma of its logarithm): worse where others stand behind, and not at all where they
    /// are in front.
    fn log_range_sigma(&self) -> Option<f64> {
        const APART: f64 = 0.2;
        const IN_FRONT: f64 = 0.35;
        self.alone.then_some(if self.apart { APART } else { IN_FRONT })
    }

    /// Centre row, width and height of the box.
    fn shape(&self) -> [f64; 3] {
        let [top, bottom] = self.rows.map(|r| r as f64);
        [(top + bottom) / 2.0, self.arc.width as f64, bottom - top + 1.0]
    }
}

impl Track {
    /// Somebody new, by the region.
    pub(super) fn new(id: TrackId, body: &Body, histogram: Histogram, now: Timestamp, raster: &Raster) -> Self {
        let sighting = Sighting {
            axis: body.axis,
            axis_sigma: sigma_alone(body.trunk_width, shape_of(body).h),
            arc: body.arc,
            rows: body.rows,
            range_m: 1.0,
            trunk_width: body.trunk_width,
            alone: true,
            apart: true,
            moves: true,
            solid: false,
            support: 1.0,
            feet_hidden: false,
            head: true,
            appearance: Appearance::default(),
            manner: Manner::default(),
        };
        Self {
            shape: shape_of(body),
            template: body.strip.clone(),
            axis_offset: body.axis_offset(raster),
            histogram,
            ..Self::of_figure(id, &sighting, now)
        }
    }

    /// Somebody new, by the figure.
    pub(super) fn of_figure(id: TrackId, s: &Sighting, now: Timestamp) -> Self {
        let [y, w, h] = s.shape();
        Self {
            id,
            confirmed: false,
            state: TrackState::Visible,
            filter: AxisFilter::new(s.axis, s.axis_sigma, 2.0 * s.trunk_width),
            shape: Shape { x: 0.0, y, w, h },
            arc: s.arc,
            rows: s.rows,
            behind: false,
            trunk_width: s.trunk_width,
            template: Strip { start: 0, filled: Vec::new(), gray: Vec::new() },
            axis_offset: 0.0,
            histogram: Histogram::default(),
            looks: Looks::default(),
            stand: None,
            last_apart: (now, s.axis),
            axis: s.axis,
            axis_sigma: s.axis_sigma,
            beyond: 0.0,
            extent: None,
            votes: Votes::default(),
            hits: 1,
            misses: 0,
            moving_hits: 1,
            supported: now,
            vouched: Timestamp::default(),
            vouched_hits: 0,
            solid_hits: 0,
            bodily_hits: 1,
            proof: Proof::default(),
            born: now,
            born_at: s.axis,
            travelled: 0.0,
            born_row: y,
            gone: 0.0,
            seen: now,
            moved: now,
            stays: (s.axis, now),
            merged_since: None,
            group_width: 0.0,
            turning_point: None,
            announced: false,
            support: s.support,
            feet_hidden: s.feet_hidden,
            head: s.head,
            agreement: Agreement::of(s.manner),
            as_afoot: false,
            log_range: s.range_m.ln(),
            log_range_sigma: 0.3,
            average_m: None,
            figure_shape: FigureShape::default(),
            evidence: 0.5,
        }
    }

    /// It comes out from behind others, beside where it was thought to be.
    pub(super) fn comes_out(&mut self, s: &Sighting, now: Timestamp, raster: &Raster) {
        self.filter = AxisFilter::new(s.axis, s.axis_sigma, 2.0 * s.trunk_width);
        self.evidence = self.evidence.max(0.5);
        self.see_figure(s, now, raster);
    }

    /// It is somebody who was followed before, and stands where he stood.
    pub(super) fn returns(&mut self, looks: Looks) {
        self.looks = looks;
        self.travelled = f64::INFINITY;
        self.bodily_hits = BODILY_HITS;
    }

    /// Where its figure should be.
    pub(super) fn sought(&self) -> Sought<'_> {
        Sought {
            column: self.filter.column,
            column_sigma: match self.state {
                // Where others hide a part of somebody, the same error is made frame after frame.
                TrackState::Merged => self.filter.sigma().hypot(self.axis_sigma),
                _ => self.filter.sigma().hypot(0.15 * self.trunk_width),
            }
            .max(1.0),
            range_m: self.log_range.exp(),
            log_range_sigma: self.log_range_sigma,
            known_range: false,
            shape: &self.figure_shape,
            seniority: self.hits,
            looks: self.looks.firm(),
        }
    }

    /// Whether it shows a shadow and nobody. What was a body for some time must surely be a shadow.
    pub(super) fn is_shadow(&mut self, now: Shaded) -> bool {
        self.bodily_hits = self.bodily_hits.saturating_add(u32::from(now == Shaded::No));
        now == Shaded::Surely || now == Shaded::Perhaps && self.bodily_hits < BODILY_HITS
    }

    /// What this frame says about its existence.
    pub(super) fn weigh(&mut self, evidence: f64, dt_s: f64) {
        const MEMORY_S: f64 = 0.7;
        self.evidence += (1.0 - (-dt_s / MEMORY_S).exp()) * (evidence.clamp(-0.5, 1.0) - self.evidence);
    }

    /// Seen as a figure.
    pub(super) fn see_figure(&mut self, s: &Sighting, now: Timestamp, raster: &Raster) {
        let sigma = s.axis_sigma;
        let column_m = SHOULDERS_M / self.trunk_width.max(1.0);
        let innovation_m = raster.column_difference(s.axis, self.filter.column) * column_m;
        self.agreement.see(s.manner, innovation_m);
        self.as_afoot = self.looks.is_as_afoot(&s.appearance);
        self.filter.update(s.axis, sigma, raster);
        /// Nobody comes nearer or goes away by so much between frames.
        const ANOTHER: f64 = 0.5;
        if (s.range_m.ln() - self.log_range).abs() > ANOTHER {
            // It was taken for a nearer one, or for two.
            (self.log_range, self.log_range_sigma) = (s.range_m.ln(), 0.3);
            self.figure_shape = FigureShape::default();
        } else if let Some(sigma) = s.log_range_sigma() {
            let gain = self.log_range_sigma.powi(2) / (self.log_range_sigma.powi(2) + sigma * sigma);
            self.log_range += gain * (s.range_m.ln() - self.log_range);
            self.log_range_sigma *= (1.0 - gain).sqrt();
        }
        for (old, new) in [&mut self.shape.y, &mut self.shape.w, &mut self.shape.h].into_iter().zip(s.shape()) {
            *old += 0.4 * (new - *old);
        }
        if s.alone {
            (self.axis, self.axis_sigma) = (s.axis, sigma);
        } else {
            (self.axis, self.axis_sigma) = (self.filter.column, self.filter.sigma().hypot(sigma));
        }
        (self.arc, self.rows, self.trunk_width) = (s.arc, s.rows, s.trunk_width);
        let parted = s.alone != (self.merged_since.is_none());
        if parted {
            self.turning_point = Some(now);
            self.merged_since = (!s.alone).then_some(now);
        }
        if s.apart {
            self.last_apart = (now, self.axis);
            let stands = self.filter.rate.abs() < STANDING_RATE * s.trunk_width;
            self.stand =
                stands.then(|| Stand { at: now, column: self.axis, log_range: self.log_range, patch: self.patch() });
            if s.moves {
                self.looks.see_afoot(&s.appearance);
            }
            if self.looks.see(&s.appearance) {
                self.turning_point = Some(now);
            }
        } else {
            self.looks.doubt();
        }
        self.state = if s.alone { TrackState::Visible } else { TrackState::Merged };
        (self.support, self.feet_hidden, self.head) = (s.support, s.feet_hidden, s.head);
        self.supported = now;
        let aside = raster.column_difference(self.axis, self.born_at).abs();
        self.travelled = self.travelled.max(aside);
        self.solid_hits = self.solid_hits.saturating_add(u32::from(s.solid && s.alone));
        self.note_seen(s.moves, now, raster);
    }

    /// The time goes on.
    pub(super) fn predict(&mut self, dt_s: f64, raster: &Raster) {
        // 1.5 m/s² on shoulders half a metre broad.
        // Who stood when others came before or beside him probably goes on standing.
        let steady = if self.stand.is_some() && self.looks.in_doubt() { STEADY } else { 1.0 };
        let acceleration = 3.0 * steady * self.trunk_width.max(4.0);
        self.filter.predict(dt_s, acceleration, raster);
        /// Somebody at two metres comes nearer by a metre a second.
        const LOG_RANGE_RATE: f64 = 0.35;
        self.log_range_sigma = self.log_range_sigma.hypot(LOG_RANGE_RATE * dt_s).clamp(0.08, 0.5);
        if self.state == TrackState::Hidden {
            self.filter.damp((-dt_s / 0.7).exp());
        }
    }

    pub(super) fn predicted_shape(&self) -> Shape {
        Shape { x: self.filter.column, ..self.shape }
    }

    /// The columns where it should be.
    pub(super) fn predicted_arc(&self, raster: &Raster) -> Arc {
        let width = (self.shape.w.round().max(1.0) as usize).min(raster.width);
        let start = self.filter.column - self.shape.w / 2.0;
        if raster.wraps {
            let start = start.round().rem_euclid(raster.width as f64) as usize % raster.width;
            return Arc { start, width };
        }
        let first = start.round().clamp(0.0, raster.width as f64 - 1.0) as usize;
        Arc { start: first, width: width.min(raster.width - first) }
    }

    /// Seen alone.
    pub(super) fn see(&mut self, body: &Body, histogram: &Histogram, moves: bool, now: Timestamp, raster: &Raster) {
        let split = self.state == TrackState::Merged || self.merged_since.is_some();
        let sigma = sigma_alone(body.trunk_width, shape_of(body).h) * if body.both_cut { UNSURE } else { 1.0 };
        self.filter.update(body.axis, sigma, raster);
        let found = shape_of(body);
        let follow = |old: f64, new: f64| if split { new } else { old + 0.4 * (new - old) };
        self.shape.y = follow(self.shape.y, found.y);
        self.shape.w = follow(self.shape.w, found.w);
        self.shape.h = follow(self.shape.h, found.h);
        (self.axis, self.axis_sigma) = (body.axis, sigma);
        (self.arc, self.rows, self.trunk_width) = (body.arc, body.rows, body.trunk_width);
        self.template.clone_from(&body.strip);
        self.axis_offset = body.axis_offset(raster);
        self.histogram.blend(histogram, 0.1);
        self.state = TrackState::Visible;
        self.merged_since = None;
        if split {
            self.turning_point = Some(now);
        }
        self.supported = now;
        self.travelled = self.travelled.max(raster.column_difference(self.axis, self.born_at).abs());
        self.gone = self.gone.max(self.travelled.hypot(found.y - self.born_row));
        self.note_seen(moves, now, raster);
    }

    /// Seen in a group.
    pub(super) fn see_merged(
        &mut self,
        placed: &Placed,
        group: Arc,
        rows: [usize; 2],
        now: Timestamp,
        raster: &Raster,
    ) {
        let Placed { axis, alone, support } = *placed;
        if support > LEAST_SUPPORT {
            self.supported = now;
        }
        let sigma = (2.0 * sigma_alone(self.trunk_width, self.shape.h)).hypot((1.0 - alone) * 0.5 * self.trunk_width);
        self.filter.update(axis, sigma, raster);
        // Nobody is outside of the group.
        let centre = group.centre();
        let offset = raster.column_difference(self.filter.column, centre);
        let half = group.width as f64 / 2.0;
        self.filter.column = raster.wrap_column(centre + offset.clamp(-half, half));
        // Errors in a group last as long as it does: the filter's own sigma, which trusts in their averaging, is no bound.
        self.axis = self.filter.column;
        self.axis_sigma = self
            .filter
            .sigma()
            .hypot(2.0 * sigma_alone(self.trunk_width, self.shape.h))
            .hypot((1.0 - alone) * 0.3 * self.trunk_width);
        // Its own place in the group, as far as that reaches.
        self.arc = self.predicted_arc(raster);
        let half = self.shape.h / 2.0;
        let inside = |row: f64| row.round().clamp(rows[0] as f64, rows[1] as f64) as usize;
        self.rows = [inside(self.shape.y - half), inside(self.shape.y + half - 1.0)];
        self.group_width = group.width as f64;
        if self.merged_since.is_none() {
            self.merged_since = Some(now);
            self.turning_point = Some(now);
        }
        self.state = TrackState::Merged;
        self.note_seen(true, now, raster);
    }

    /// Not seen.
    pub(super) fn miss(&mut self) {
        self.misses += 1;
        self.behind = false;
        self.looks.hide();
        self.state = TrackState::Hidden;
        (self.axis, self.axis_sigma) = (self.filter.column, self.filter.sigma().hypot(0.3 * self.trunk_width));
    }

    /// Not seen, and where he should be others cover him: he goes where they go, for elsewhere he would be seen.
    pub(super) fn stays_behind(&mut self, column: f64, within: f64, raster: &Raster) {
        self.filter.update(column, within, raster);
        self.miss();
        self.behind = true;
    }

    fn note_seen(&mut self, moves: bool, now: Timestamp, raster: &Raster) {
        if raster.column_difference(self.filter.column, self.stays.0).abs() > STAYS * self.trunk_width {
            self.stays = (self.filter.column, now);
        }
        self.hits += 1;
        self.misses = 0;
        self.behind = false;
        self.seen = now;
        if moves {
            self.moved = now;
            self.moving_hits += 1;
        }
    }

    /// For how long it has stayed where it is, seconds.
    pub(super) fn stayed_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.stays.1)
    }

    /// Whether it has been seen to move by its own breadth, or to stand out of the background for long: what has not may be the trace of
    /// somebody who left.
    pub(super) fn has_come(&self) -> bool {
        self.travelled > self.shape.w.min(40.0) || self.is_solid()
    }

    /// Whether it has stood out of the background for long.
    pub(super) fn is_solid(&self) -> bool {
        self.solid_hits >= SOLID_HITS
    }

    /// Whether it has come by a part of its size: what flickers stays where it is, the smaller the surer.
    pub(super) fn goes_somewhere(&self) -> bool {
        const LEAST_PX: f64 = 6.0;
        self.gone > (0.5 * self.shape.w).clamp(LEAST_PX, 20.0)
    }

    /// Whether it was going out of a picture that does not wrap when it was last seen.
    pub(super) fn has_left(&self, raster: &Raster) -> bool {
        const BORDER: f64 = 2.0;
        let half = self.shape.w / 2.0;
        let (left, right) = (self.axis - half, self.axis + half);
        let outwards = |speed: f64| speed > 0.0;
        !raster.wraps
            && (left < BORDER && outwards(-self.filter.rate)
                || right > raster.width as f64 - 1.0 - BORDER && outwards(self.filter.rate))
    }

    pub(super) fn patch(&self) -> Patch {
        Patch { arc: self.arc, rows: self.rows }
    }

    /// That it is a real moving object.
    pub(super) fn confidence(&self) -> f64 {
        let seen = match self.state {
            TrackState::Visible => 1.0,
            TrackState::Merged => 0.8,
            TrackState::Hidden => 0.5,
        };
        self.evidence_of_age() * seen
    }

    /// What having been seen for so long says for a real object, 0 to 1.
    pub(super) fn evidence_of_age(&self) -> f64 {
        1.0 - (-f64::from(self.hits) / 6.0).exp()
    }

    pub(super) fn class(&self) -> ObjectClass {
        self.votes.winner()
    }
}

/// Who goes aside by this part of the breadth of shoulders does not stay.
const STAYS: f64 = 0.5;
/// Support below which nothing speaks for a body in a group.
const LEAST_SUPPORT: f64 = 0.1;

/// More of it where neither head nor feet are seen: legs alone, or two people so near that they look like one.
pub(super) const UNSURE: f64 = 2.5;

/// Of the axis of a body seen alone, columns: pixels, and the body itself, which sways and swings by a part of its breadth.
/// What is far too slender for its height (rows) is a part of a body, and its axis may be beside it.
pub(super) fn sigma_alone(trunk_width: f64, height: f64) -> f64 {
    const BREADTH: f64 = 0.12;
    let body = trunk_width.max(BREADTH * height);
    let part = (BREADTH * height - trunk_width).max(0.0);
    0.5f64.hypot(0.07 * body).hypot(0.5 * part)
}

pub(super) fn shape_of(body: &Body) -> Shape {
    Shape {
        x: body.axis,
        y: (body.rows[0] + body.rows[1]) as f64 / 2.0,
        w: body.arc.width as f64,
        h: (body.rows[1] - body.rows[0] + 1) as f64,
    }
}
