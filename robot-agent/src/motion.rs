//! What moves in a picture (report section VI, `MATHS.md` §7, golden groups `median` … `alarm`).
//!
//! The stage works on one 8-bit gray picture, a panorama whose columns close to a ring or a plain image, and knows no
//! optics. A frame passes three calls, so that a shell can look at its clock between them:
//!
//! ```text
//! change   own motion · background bootstrap · |C − B| against noise · alarm     → Change
//! extract  whole bodies from faint marks · regions over the seam · ghosts, gate  → Scene (mask, objects)
//! learn    running average and noise outside objects and held tracks
//! ```
//!
//! Thresholds follow each pixel's noise. Faint marks (1.6 σ) make bodies by majority in a window, strong ones (4 σ) decide
//! whether a body is there at all, so that somebody dressed like the wall is found whole and noise is not found.

mod background;
mod bodies;
mod drawing;
mod filter;
mod floor;
mod gain;
mod gate;
mod ghost;
mod halo;
mod holes;
pub mod kernel;
mod marking;
mod marks;
mod own_motion;
mod raster;
mod regions;
mod sensor;
mod shadow;
mod work;

use std::ops::Range;

use protocol::message::{AlarmKind, Motion};
use protocol::time::Timestamp;

use background::Learnt;
pub use background::{Background, BackgroundMode, LearningRate};
pub use drawing::{Canvas, Drawing};
pub use gate::{region_moves, scene_changed};
pub use ghost::Outline;
pub use raster::{Arc, Raster};
pub(crate) use regions::Run;
pub use regions::{MAX_RUNS, Region, group};
pub use work::Work;
pub(crate) use work::{COLUMNS as CELL_COLUMNS, ROWS as CELL_ROWS};

use filter::Majority;
use halo::Halo;
use holes::Holes;
use marks::Marks;
use own_motion::{Anchor, OwnMotion};
use regions::Grouping;
use shadow::Shadow;
use work::Learning;

/// Most objects of one frame; the smallest are left out.
pub const MAX_OBJECTS: usize = 128;

/// Why a picture cannot be worked on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MotionError {
    /// A raster or mask that cannot be.
    #[error("a picture of {width}×{height} pixels cannot be tested; at least 16×16 and at most 2³² pixels are needed")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A picture or mask of another size.
    #[error("{what} holds {found} pixels; {wanted} were expected")]
    Length {
        /// "the picture" or "the mask".
        what: &'static str,
        /// How many came.
        found: usize,
        /// How many there should be.
        wanted: usize,
    },
}

/// How motion is found. The defaults suit a standing robot indoors and a fixed camera outdoors alike.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionSettings {
    /// How the background comes about.
    pub background: BackgroundMode,
    /// The running average takes 1/2^k of each frame at 10 Hz (k 1 … 8; 4 is the report's 1/16), and is as fast in
    /// time at other rates.
    pub rate_shift: u32,
    /// Least change that marks faintly and strongly, grey levels, however quiet the camera.
    pub floor_levels: [f64; 2],
    /// A change below this share of the strongest one beside it (within 8 to 16 pixels) is its halo.
    pub halo_share: f64,
    /// Half size of the majority window (columns, rows).
    pub window_reach: [usize; 2],
    /// Half the distance (columns, rows) that joins pixels to one region.
    pub gap: [usize; 2],
    /// Smallest object, pixels.
    pub min_area_px: usize,
    /// Rows between two pieces of one body, as a share of their joint height.
    pub max_gap_share: f64,
    /// Row that whoever stands on the floor reaches above: the horizon of a camera below people's hips. What stays below it
    /// (shadows on the floor, robots) is then never one object with somebody. `None` where people may be below it.
    pub upright_row: Option<usize>,
    /// Whether the camera is on a robot that may drive. Off for a fixed camera.
    pub own_motion: bool,
    /// Whether cells of the picture that show what they showed before may be left out (see [`Work`]).
    pub rests: bool,
}

impl Default for MotionSettings {
    fn default() -> Self {
        Self {
            background: BackgroundMode::Live { bootstrap_s: 0.8 },
            rate_shift: 4,
            floor_levels: [2.0, 6.0],
            halo_share: 0.16,
            window_reach: [2, 3],
            gap: [1, 2],
            min_area_px: 30,
            max_gap_share: 0.12,
            upright_row: None,
            own_motion: true,
            rests: true,
        }
    }
}

/// How the background stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BackgroundState {
    /// The robot moves, or it is not known yet that it stands.
    Suspended,
    /// Frames are being collected.
    Building,
    /// It can be subtracted.
    Ready,
}

/// What [`MotionStage::change`] found out.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// What the robot itself does.
    pub motion: Motion,
    /// Whether the other stages can run.
    pub background: BackgroundState,
    /// Set in the frame in which it began.
    pub alarm: Option<AlarmKind>,
}

/// A region that differs from the background.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// Where.
    pub region: Region,
    /// Whether it passes the change gate: it differs from the frame before.
    pub moves: bool,
    /// What its outline is an edge of.
    pub outline: Outline,
}

impl Object {
    /// Whether its outline belongs to the background: somebody has left.
    pub fn is_ghost(&self) -> bool {
        self.outline == Outline::Background
    }
}

/// What the tracker sees of a frame.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Size and topology.
    pub raster: &'a Raster,
    /// The picture.
    pub picture: &'a [u8],
    /// What is behind, 8.8 fixed point; empty where nobody knows.
    pub background: &'a [u16],
    /// 1 where something is that does not belong to the background.
    pub mask: &'a [u8],
    /// How much each pixel differs from the background, grey levels.
    pub magnitude: &'a [u8],
    /// 0 where nothing is ever tested, else 1.
    pub valid: &'a [u8],
    /// The regions of the mask that are objects.
    pub objects: &'a [Object],
}

#[cfg(test)]
impl<'a> Scene<'a> {
    /// Of marks alone, which stand for the picture too.
    pub(crate) fn of_marks(raster: &'a Raster, marks: &'a [u8], valid: &'a [u8]) -> Self {
        Self { raster, picture: marks, background: &[], mask: marks, magnitude: marks, valid, objects: &[] }
    }
}

/// A rectangle of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patch {
    /// Columns.
    pub arc: Arc,
    /// First and last row.
    pub rows: [usize; 2],
}

impl Patch {
    /// Whether most of another lies in it.
    fn holds(&self, other: &Self, raster: &Raster) -> bool {
        10 * self.shared(other, raster) > 7 * other.area()
    }

    /// Pixels in both.
    fn shared(&self, other: &Self, raster: &Raster) -> usize {
        let rows = (self.rows[1].min(other.rows[1]) + 1).saturating_sub(self.rows[0].max(other.rows[0]));
        self.arc.overlap(&other.arc, raster) * rows
    }

    pub(crate) fn area(&self) -> usize {
        self.arc.width * (self.rows[1] - self.rows[0] + 1)
    }
}

/// What the tracker wants of the background: keep out of some patches, take over others.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Holds {
    /// Somebody stands there: never learnt.
    pub keep: Vec<Patch>,
    /// Somebody is seen there who looks as he did when he walked: no ghost is.
    pub recognised: Vec<Patch>,
    /// Somebody has stood there for so long that it belongs to the scene now.
    pub release: Vec<Patch>,
}

/// Finds what moves. See the module for the order of calls.
#[derive(Debug)]
pub struct MotionStage {
    raster: Raster,
    settings: MotionSettings,
    valid: Vec<u8>,
    /// The same as marks.
    valid_marks: Marks,
    valid_count: usize,
    /// Bands of rows (see `halo`) in which not every pixel is valid.
    partly_valid: Vec<bool>,
    background: Background,
    own_motion: OwnMotion,
    majority: Majority,
    state: BackgroundState,
    motion: Motion,
    picture: Vec<u8>,
    /// The frame before; empty before there was one.
    before: Vec<u8>,
    /// The frame that (6-1) compares with, unless that is `before`; empty before there was one.
    previous: Vec<u8>,
    previous_is_before: bool,
    /// Where the next picture is drawn.
    next: Vec<u8>,
    /// The first frame, while the background is being built.
    first: Vec<u8>,
    halo: Halo,
    shadow: Shadow,
    magnitude: Vec<u8>,
    faint: Marks,
    strong: Marks,
    /// Where most of the neighbourhood is marked; what of it stands upright, and what lies low.
    solid: Marks,
    upright: Marks,
    low: Marks,
    grouping: Grouping,
    holes: Holes,
    /// The pixels of objects, for the tracker.
    mask: Vec<u8>,
    /// The runs of `mask` that are not 0.
    drawn: Vec<Run>,
    /// Threshold of (6-1) in this frame, grey levels.
    gate_threshold: u8,
    how: Vec<u8>,
    /// Frames learnt from: each learns its turn of the picture.
    learnt: usize,
    /// When something last moved at a pixel, tenths of a second since `first_capture`, which begin anew after two hours.
    moved_ds: Vec<u16>,
    first_capture: Option<Timestamp>,
    capture: Timestamp,
    previous_capture: Timestamp,
    /// Typical time between frames.
    spacing_s: f64,
    objects: Vec<Object>,
    ghosts: Vec<(Patch, u32)>,
    /// What the tracker wanted last: where somebody is followed, ghosts are believed later, or never.
    holds: Holds,
    noise_sigma: f64,
    /// Picture / background, the light's common factor.
    gain: f64,
    light: gain::Light,
    /// When the light was last looked at, and whether it is in this frame.
    light_seen: Option<Timestamp>,
    looks_at_light: bool,
    sensor_failed: bool,
    /// When it failed last.
    failed_at: Option<Timestamp>,
    frozen: sensor::Frozen,
    work: Work,
    /// Whether the picture that comes was drawn over the last one, of which `next` keeps what it was drawn over.
    drawn_in_place: bool,
    /// Frames since the background was begun.
    ready_frames: u32,
}

impl MotionStage {
    /// For pictures of one size. `valid`: 0 = never tested, never counted (the robot's own body, the hole); all where `None`.
    ///
    /// # Errors
    /// A size below 16×16, or a mask of another size.
    pub fn new(raster: Raster, valid: Option<&[u8]>, settings: MotionSettings) -> Result<Self, MotionError> {
        let n = raster.len();
        if raster.width < 16 || raster.height < 16 || u32::try_from(n).is_err() {
            return Err(MotionError::Size { width: raster.width, height: raster.height });
        }
        let valid: Vec<u8> = match valid {
            Some(v) if v.len() != n => {
                return Err(MotionError::Length { what: "the mask", found: v.len(), wanted: n });
            }
            Some(v) => v.iter().map(|&v| u8::from(v != 0)).collect(),
            None => vec![1; n],
        };
        Ok(Self {
            raster,
            valid_count: valid.iter().map(|v| usize::from(*v)).sum(),
            valid_marks: Marks::of_bytes(&valid, raster),
            partly_valid: valid.chunks(halo::CELL * raster.width).map(|band| band.contains(&0)).collect(),
            background: match settings.upright_row {
                Some(_) => Background::new(settings.background, raster).indoors(),
                None => Background::new(settings.background, raster),
            },
            own_motion: OwnMotion::new(raster, valid.clone()),
            majority: Majority::new(raster, settings.window_reach.map(|r| r.clamp(1, 5)), &valid),
            valid,
            state: BackgroundState::Suspended,
            motion: Motion::Unknown,
            picture: vec![0; n],
            before: Vec::new(),
            previous: Vec::new(),
            previous_is_before: false,
            next: vec![0; n],
            first: Vec::new(),
            halo: Halo::new(raster),
            shadow: Shadow::new(raster),
            magnitude: vec![0; n],
            faint: Marks::new(raster),
            strong: Marks::new(raster),
            solid: Marks::new(raster),
            upright: Marks::new(raster),
            low: Marks::new(raster),
            grouping: Grouping::default(),
            holes: Holes::default(),
            mask: vec![0; n],
            drawn: Vec::new(),
            gate_threshold: u8::MAX,
            how: vec![0; n],
            learnt: 0,
            moved_ds: vec![0; n],
            first_capture: None,
            capture: Timestamp(0),
            previous_capture: Timestamp(0),
            spacing_s: 0.1,
            objects: Vec::new(),
            ghosts: Vec::new(),
            holds: Holds::default(),
            noise_sigma: 2.0,
            gain: 1.0,
            light: gain::Light::default(),
            light_seen: None,
            looks_at_light: true,
            sensor_failed: false,
            failed_at: None,
            frozen: sensor::Frozen::default(),
            work: Work::new(raster),
            drawn_in_place: false,
            ready_frames: 0,
            settings,
        })
    }

    /// Take a frame: what does the robot do, is there a background, what differs from it?
    ///
    /// # Errors
    /// A picture of another size; the state is unchanged.
    pub fn change(&mut self, picture: &[u8], capture: Timestamp) -> Result<Change, MotionError> {
        if picture.len() != self.raster.len() {
            return Err(MotionError::Length { what: "the picture", found: picture.len(), wanted: self.raster.len() });
        }
        self.next_picture().copy_from_slice(picture);
        Ok(self.change_drawn(capture))
    }

    /// Where the next picture may be drawn, row by row; taken by [`MotionStage::change_drawn`]. All of it must be drawn each time.
    pub fn next_picture(&mut self) -> &mut [u8] {
        self.work.plan_all();
        self.next_buffer()
    }

    fn next_buffer(&mut self) -> &mut [u8] {
        self.next.resize(self.raster.len(), 0);
        &mut self.next
    }

    /// The picture drawn last that was taken, or was none (see [`AlarmKind::SensorFailure`]).
    pub fn drawn(&self) -> &[u8] {
        if self.sensor_failed { &self.next } else { &self.picture }
    }

    /// As [`MotionStage::change`], of what was drawn into [`MotionStage::next_picture`].
    pub fn change_drawn(&mut self, capture: Timestamp) -> Change {
        self.next_buffer();
        let in_place = std::mem::take(&mut self.drawn_in_place);
        if !in_place && !self.work.is_whole() {
            // Nobody drew anything.
            self.next.copy_from_slice(&self.picture);
            self.work.work_all();
        }
        self.objects.clear();
        // Where most of a picture rests it shows what it showed: its light is the same but for what turns tell.
        self.looks_at_light = self.work.is_fresh() || !is_within(LIGHT_S, self.light_seen, capture);
        let drawn = if in_place { &self.picture } else { &self.next };
        let failure = if self.looks_at_light { sensor::failure(drawn, &self.valid) } else { None };
        if let Some(failure) = failure {
            if in_place {
                self.next.copy_from_slice(&self.picture);
            }
            // One that fails now and then is one failure.
            let goes_on = is_within(FAILURE_S, self.failed_at.replace(capture), capture);
            let alarm = (!goes_on).then(|| AlarmKind::SensorFailure(failure.to_owned()));
            self.sensor_failed = true;
            self.state = BackgroundState::Suspended;
            self.background.restart();
            self.own_motion.reset();
            self.before.clear();
            self.previous.clear();
            self.previous_is_before = false;
            self.motion = Motion::Unknown;
            return Change { motion: self.motion, background: self.state, alarm };
        }
        if self.looks_at_light {
            self.light_seen = Some(capture);
        }
        self.sensor_failed = false;
        self.take(capture, in_place);
        let frozen = self.frozen.look(self.is_same_picture(), capture);
        let frozen = frozen.map(|why| AlarmKind::SensorFailure(why.to_owned()));

        let before = self.motion;
        self.motion = if self.settings.own_motion {
            let anchor = anchor(self.state, &self.background, &self.first);
            let before = if self.previous_is_before { &self.before } else { &self.previous };
            let calm = self.work.is_calm();
            self.own_motion.step(&self.picture, before, anchor, self.noise_sigma, capture, calm)
        } else {
            Motion::Standing
        };
        if self.motion != Motion::Standing {
            let alarm = (before == Motion::Standing).then_some(AlarmKind::SelfMotion);
            self.suspend();
            return Change { motion: self.motion, background: self.state, alarm };
        }
        let mut alarm = None;
        if self.state == BackgroundState::Suspended {
            self.begin();
        }
        if self.state == BackgroundState::Building {
            alarm = self.build(capture);
        } else {
            self.background.revise(&self.picture, capture, (self.gain - 1.0).abs() < SAME_LIGHT);
            let differing = self.mark();
            self.ready_frames = self.ready_frames.saturating_add(1);
            if scene_changed(self.valid_count, differing) {
                let anchor = anchor(self.state, &self.background, &self.first);
                let relit = self.own_motion.is_relit(&self.picture, anchor, self.noise_sigma);
                alarm = Some(if relit { AlarmKind::LightSwitched } else { AlarmKind::SceneChanged });
                self.begin();
                let _ = self.build(capture);
            }
        }
        Change { motion: self.motion, background: self.state, alarm: alarm.or(frozen) }
    }

    /// Objects from the marks of this frame's [`MotionStage::change`]. Does nothing while there is no background.
    pub fn extract(&mut self) {
        self.objects.clear();
        if self.state != BackgroundState::Ready {
            self.draw_objects();
            return;
        }
        let share_q8 = (self.settings.halo_share * 256.0).clamp(0.0, 255.0) as u8;
        self.halo.trim(&self.magnitude, share_q8, self.settings.floor_levels[0] as u8, &mut self.faint);
        let Background { level, noise, .. } = &self.background;
        self.shadow.remove(&self.picture, level, noise, self.gain, &mut self.faint);
        self.majority.apply(&self.faint, &mut self.solid);
        self.work.note_marks(&self.solid);
        let mut regions = self.group_bodies();
        // Where people are known by their silhouettes those judge what is whole.
        let whole = self.settings.upright_row.is_none();
        if whole {
            regions = regions.into_iter().filter_map(|r| self.holes.fill(r, &self.raster)).collect();
        }
        regions.retain(|r| {
            // A real body is clearly different somewhere.
            r.area >= self.settings.min_area_px
                && has_marks(r, &self.strong, (r.area / 12).max(4))
                && !floor::is_soft_shadow(
                    r,
                    &self.picture,
                    &self.background.level,
                    &self.background.noise,
                    &self.raster,
                )
        });
        if regions.len() > MAX_OBJECTS {
            regions.sort_by_key(|r| std::cmp::Reverse(r.area));
            regions.truncate(MAX_OBJECTS);
        }
        for region in regions {
            let moves = self.moves(&region);
            let steps = ghost::outline_steps(&region, &self.picture, &self.background.level, &self.raster);
            self.objects.push(Object { moves, outline: steps.belong_to(), region });
        }
        for object in &self.objects {
            self.work.note_patch(&Patch { arc: object.region.arc, rows: object.region.rows });
        }
        self.remove_ghosts();
        self.draw_objects();
    }

    /// What the tracker sees.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            raster: &self.raster,
            picture: &self.picture,
            background: &self.background.level,
            mask: &self.mask,
            magnitude: &self.magnitude,
            valid: &self.valid,
            objects: &self.objects,
        }
    }

    /// Let the background follow, outside this frame's moving objects and `holds.keep`.
    pub fn learn(&mut self, holds: &Holds) {
        if self.state != BackgroundState::Ready {
            return;
        }
        self.holds.clone_from(holds);
        // A fast camera's pixels take turns, so that each is learnt about ten times a second.
        let turns = ((0.1 / self.spacing_s + TIE).round() as usize).clamp(1, MAX_TURNS);
        let turn = self.learnt % turns;
        let rows = self.raster.height * turn / turns..self.raster.height * (turn + 1) / turns;
        self.mark_permissions(holds, rows.clone());
        for patch in holds.keep.iter().chain(&holds.release) {
            self.work.note_patch(patch);
        }
        let rate = LearningRate::for_spacing(self.settings.rate_shift, self.spacing_s * turns as f64);
        // Half of them a round are counted, for the processor's sake.
        let round = self.learnt / turns;
        let middle = usize::midpoint(rows.start, rows.end);
        let counted = if round.is_multiple_of(2) { rows.start..middle } else { middle..rows.end };
        let exposure_q15 = self.learnt_exposure_q15();
        let Self { background, picture, how, work, .. } = self;
        let seen = Learnt { picture, exposure_q15, how };
        for (band, lines) in work.bands() {
            let lines = lines.start.max(rows.start)..lines.end.min(rows.end);
            for run in work.learnt(band, Learning::InTurn).filter(|_| !lines.is_empty()) {
                for y in lines.clone() {
                    background.fetch(y + FETCH_ROWS, &run);
                    background.fetch_seen(y + FETCH_ROWS, &run);
                    background.learn(seen, y, &run, rate);
                    if counted.contains(&y) {
                        background.count(seen, y, &run, round, 1);
                    }
                }
            }
        }
        self.learn_visited(turns);
        self.learnt = self.learnt.wrapping_add(1);
    }

    /// Learns where nothing was and it is a cell's turn.
    fn learn_visited(&mut self, turns: usize) {
        if self.work.is_whole() {
            return;
        }
        let width = self.raster.width;
        let exposure_q15 = self.learnt_exposure_q15();
        let rate = LearningRate::for_visits(self.settings.rate_shift, self.spacing_s * self.work.rest() as f64);
        // In pairs of turns, as all counts.
        let weight = (self.work.rest() as f64 / (2 * turns) as f64).round().clamp(1.0, 16.0) as u8;
        let Self { background, picture, how, work, .. } = self;
        for (band, rows) in work.bands() {
            for run in work.learnt(band, Learning::ForAll) {
                for y in rows.clone() {
                    how[run.pixels(y, width)].fill(kernel::LEARN);
                    let seen = Learnt { picture, exposure_q15, how };
                    background.fetch(y + FETCH_ROWS, &run);
                    background.fetch_seen(y + FETCH_ROWS, &run);
                    background.learn(seen, y, &run, rate);
                    background.count(seen, y, &run, 0, weight);
                }
            }
        }
    }

    /// Nearly all of the gain is the exposure's; the rest lets the background follow a light that stays.
    fn learnt_exposure_q15(&self) -> u16 {
        gain::inverse_q15(1.0 + 0.95 * (self.gain - 1.0))
    }

    /// How each pixel of some rows is learnt.
    fn mark_permissions(&mut self, holds: &Holds, rows: Range<usize>) {
        let width = self.raster.width;
        let Self { how, work, .. } = self;
        for (band, lines) in work.bands() {
            for y in lines.start.max(rows.start)..lines.end.min(rows.end) {
                work.learnt(band, Learning::InTurn).for_each(|run| how[run.pixels(y, width)].fill(kernel::LEARN));
            }
        }
        let now_ds = self.decisecond();
        for object in &self.objects {
            let patch = Patch { arc: object.region.arc, rows: object.region.rows };
            if object.moves {
                fill(&mut self.how, &patch, MARGIN, &rows, kernel::LEARN_SLOWLY, &self.raster);
                fill(&mut self.moved_ds, &patch, MARGIN, &rows, now_ds, &self.raster);
            } else {
                // Slowly at first: what has just stopped may go on.
                for (row, start, len) in object.region.spans().filter(|(row, _, _)| rows.contains(row)) {
                    let i = row * width + start;
                    for (how, moved) in self.how[i..i + len].iter_mut().zip(&self.moved_ds[i..i + len]) {
                        if now_ds.wrapping_sub(*moved) < STILL_DS {
                            *how = kernel::LEARN_SLOWLY;
                        }
                    }
                }
            }
        }
        for patch in &holds.keep {
            fill(&mut self.how, patch, MARGIN, &rows, kernel::KEEP, &self.raster);
        }
        for patch in &holds.release {
            fill(&mut self.how, patch, MARGIN, &rows, kernel::LEARN, &self.raster);
        }
    }

    /// Takes a picture with the boxes of somebody else's detector in place of what differs from the background: each is an object
    /// that moves, all of its pixels are marked. Boxes outside the picture are left out.
    ///
    /// # Errors
    /// A picture of another size; the state is unchanged.
    pub fn take_boxes(
        &mut self,
        picture: &[u8],
        capture: Timestamp,
        boxes: &[[f64; 4]],
    ) -> Result<Change, MotionError> {
        if picture.len() != self.raster.len() {
            return Err(MotionError::Length { what: "the picture", found: picture.len(), wanted: self.raster.len() });
        }
        self.next_picture().copy_from_slice(picture);
        self.sensor_failed = false;
        self.take(capture, false);
        (self.state, self.motion) = (BackgroundState::Ready, Motion::Standing);
        self.magnitude.fill(0);
        self.objects.clear();
        for region in boxes.iter().take(MAX_OBJECTS).filter_map(|xywh| Region::of_box(*xywh, &self.raster)) {
            for (row, start, len) in region.spans() {
                let pixels = row * self.raster.width + start..row * self.raster.width + start + len;
                self.magnitude[pixels].fill(u8::MAX);
            }
            self.objects.push(Object { region, moves: true, outline: Outline::Unclear });
        }
        self.draw_objects();
        Ok(Change { motion: self.motion, background: self.state, alarm: None })
    }

    /// Start the background anew with the next frame, as on a command.
    pub fn restart(&mut self) {
        self.suspend();
        // Times may begin anew, too.
        self.first_capture = None;
        self.moved_ds.fill(0);
        self.own_motion.reset();
        self.motion = Motion::Unknown;
    }

    /// The background, rounded to grey levels; 0 before it is ready.
    pub fn background(&self) -> Vec<u8> {
        self.background.levels()
    }

    /// How the background stands.
    pub fn state(&self) -> BackgroundState {
        self.state
    }

    /// Size and topology of the pictures.
    pub fn raster(&self) -> &Raster {
        &self.raster
    }

    /// Typical noise of the picture against the background, one standard deviation in grey levels.
    pub fn noise_sigma(&self) -> f64 {
        self.noise_sigma
    }

    /// Bytes held for pictures and background; the same in every frame but the first seconds' (see `background`).
    pub fn memory_bytes(&self) -> usize {
        let bytes = [&self.valid, &self.picture, &self.before, &self.previous, &self.next, &self.first];
        let pictures: usize =
            bytes.into_iter().chain([&self.magnitude, &self.mask, &self.how]).map(Vec::capacity).sum();
        let marks = [&self.valid_marks, &self.faint, &self.strong, &self.solid, &self.upright, &self.low];
        let marks: usize = marks.map(Marks::memory_bytes).iter().sum();
        pictures + marks + size_of_val(&*self.moved_ds) + self.background.memory_bytes() + self.majority.memory_bytes()
    }

    /// Takes the picture drawn; keeps the one before and the one that (6-1) compares with: at least `GATE_SPACING_S` old, so that a
    /// fast camera sees slow things move. Buffers change places, no picture is copied.
    fn take(&mut self, capture: Timestamp, in_place: bool) {
        let spacing_s = capture.seconds_since(self.capture);
        if self.first_capture.is_none() {
            self.first_capture = Some(capture);
        } else {
            if spacing_s > 0.0 && spacing_s < 10.0 {
                self.spacing_s += 0.1 * (spacing_s - self.spacing_s);
            }
            let old_enough = capture.seconds_since(self.previous_capture) >= GATE_SPACING_S + 0.5 * self.spacing_s;
            let any = self.previous_is_before || !self.previous.is_empty();
            if !any || old_enough || spacing_s < 0.0 {
                self.previous_is_before = true;
                self.previous_capture = self.capture;
            } else if self.previous_is_before {
                std::mem::swap(&mut self.previous, &mut self.before);
                self.previous_is_before = false;
            }
            if !in_place {
                std::mem::swap(&mut self.picture, &mut self.before);
            }
        }
        self.capture = capture;
        // Drawn in place, what was there before was kept in the other.
        let other = if in_place { &mut self.before } else { &mut self.picture };
        std::mem::swap(other, &mut self.next);
    }

    fn decisecond(&self) -> u16 {
        let first = self.first_capture.unwrap_or(self.capture);
        (self.capture.seconds_since(first) * 10.0).max(0.0) as u64 as u16
    }

    fn suspend(&mut self) {
        self.state = BackgroundState::Suspended;
        self.background.restart();
        self.gain = 1.0;
        self.light = gain::Light::default();
        self.first.clear();
        self.ghosts.clear();
    }

    fn begin(&mut self) {
        self.suspend();
        self.shadow.restart();
        self.ready_frames = 0;
        self.state = BackgroundState::Building;
        // Until there is a background, the first frame is what the robot must not leave.
        self.first.extend_from_slice(&self.picture);
    }

    fn build(&mut self, capture: Timestamp) -> Option<AlarmKind> {
        if !self.background.collect(&self.picture, &self.valid, capture) {
            return None;
        }
        self.state = BackgroundState::Ready;
        self.update_noise_sigma();
        self.mark();
        Some(AlarmKind::BackgroundReady)
    }

    /// Marks what differs from the background; how many pixels do strongly, if those may be many.
    fn mark(&mut self) -> usize {
        let [faint, strong] = self.settings.floor_levels.map(|f| (f * 256.0) as u16);
        if self.looks_at_light {
            self.gain = gain::common_gain(&self.picture, &self.background.level, &self.valid, self.gain);
        }
        if self.light.stays(self.gain, self.capture) {
            self.background.relight(self.gain);
            self.gain = 1.0;
        }
        let exposure_q15 = gain::inverse_q15(self.gain);
        let mut differing = 0;
        // Only so many can make a changed scene.
        let counted = scene_changed(self.valid_count, self.work.worked_pixels());
        self.wipe_left();
        for band in 0..self.raster.height.div_ceil(halo::CELL) {
            self.halo.band();
            differing += self.mark_band(band, exposure_q15, [faint, strong], counted);
            self.halo.note(band);
        }
        if self.learnt.is_multiple_of(NOISE_FRAMES) {
            self.update_noise_sigma();
        }
        // Noise of a difference of two frames is √2 that of one (T_D of §7.4).
        let threshold = (4.0 * std::f64::consts::SQRT_2 * self.noise_sigma).max(self.settings.floor_levels[1]);
        self.gate_threshold = threshold.min(255.0) as u8;
        differing
    }

    /// Median of the pixels' noise, from a sparse sample.
    fn update_noise_sigma(&mut self) {
        const STRIDE: usize = 131;
        let tested = self.background.noise.iter().zip(&self.valid).step_by(STRIDE).filter(|(_, valid)| **valid != 0);
        let mut sample: Vec<u16> = tested.map(|(noise, _)| *noise).collect();
        let middle = sample.len() / 2;
        if sample.is_empty() {
            return;
        }
        let (_, median, _) = sample.select_nth_unstable(middle);
        self.noise_sigma = (f64::from(*median) / 256.0 * 1.2533).max(0.3);
    }

    /// Whether a region passes the change gate: enough of its pixels differ from the frame before (6-1).
    fn moves(&self, region: &Region) -> bool {
        let previous = if self.previous_is_before { &self.before } else { &self.previous };
        if previous.len() != self.picture.len() {
            return false;
        }
        let (width, enough) = (self.raster.width, gate::least_changed(region.area));
        let changed =
            kernel::count_differences(&region.runs, width, &self.picture, previous, self.gate_threshold, enough);
        region_moves(region.area, changed)
    }

    /// Regions of the mask, fragments joined; what stands upright apart from what lies on the floor.
    fn group_bodies(&mut self) -> Vec<Region> {
        let (gap, share) = (self.settings.gap, self.settings.max_gap_share);
        let least = self.settings.min_area_px / 4 + 1;
        let (grouping, raster) = (&mut self.grouping, &self.raster);
        let mut together =
            |mask: &Marks| bodies::join_fragments(grouping.group(mask, raster, gap, least), raster, share);
        let Some(row) = self.settings.upright_row else { return together(&self.solid) };
        floor::split(&self.solid, row, raster, &mut self.upright, &mut self.low);
        let mut regions = together(&self.upright);
        let low = together(&self.low);
        let is_shadow = |r: &Region| floor::is_darker(r, &self.picture, &self.background.level, &self.raster);
        regions.extend(low.into_iter().filter(|r| !is_shadow(r)));
        regions
    }

    /// Still regions whose outline lies in the background for some frames: take over what is there now.
    fn remove_ghosts(&mut self) {
        let mut seen = Vec::new();
        for object in self.objects.iter().filter(|o| o.is_ghost() && !o.moves) {
            let patch = Patch { arc: object.region.arc, rows: object.region.rows };
            let before = self.ghosts.iter().find(|(p, _)| similar(p, &patch, &self.raster)).map_or(0, |(_, n)| *n);
            seen.push((patch, before + 1));
        }
        let holds = &self.holds;
        let raster = self.raster;
        let believed = |patch: &Patch, frames: u32| {
            let followed = holds.keep.iter().any(|k| similar(k, patch, &raster));
            frames >= if followed { FOLLOWED_GHOST_FRAMES } else { GHOST_FRAMES }
                && !holds.recognised.iter().any(|r| r.holds(patch, &raster))
        };
        for (patch, _) in seen.iter().filter(|(p, n)| believed(p, *n)) {
            for row in patch.rows[0]..=patch.rows[1] {
                for offset in 0..patch.arc.width {
                    let column = self.raster.column(patch.arc.start, offset);
                    if self.solid.is_marked(column, row) {
                        let i = row * self.raster.width + column;
                        self.background.absorb(i, self.picture[i]);
                    }
                }
            }
        }
        let gone = |o: &Object| {
            let patch = Patch { arc: o.region.arc, rows: o.region.rows };
            o.is_ghost() && !o.moves && seen.iter().any(|(p, n)| *p == patch && believed(p, *n))
        };
        self.objects.retain(|o| !gone(o));
        self.ghosts = seen;
    }

    /// Draws the objects, and nothing else, into the mask.
    fn draw_objects(&mut self) {
        let width = self.raster.width;
        kernel::fill_runs(&self.drawn, width, 0, &mut self.mask);
        self.drawn.clear();
        self.drawn.extend(self.objects.iter().flat_map(|o| &o.region.runs));
        kernel::fill_runs(&self.drawn, width, 1, &mut self.mask);
    }
}

/// Failures of the sensor nearer to each other than this are one, seconds.
const FAILURE_S: f64 = 3.0;
/// Of two numbers of turns that suit equally well (25 Hz) the larger is taken.
const TIE: f64 = 0.05;
/// Most turns in which the pixels learn.
const MAX_TURNS: usize = 8;
/// A gain so near to 1 leaves grey levels comparable.
const SAME_LIGHT: f64 = 0.03;
/// Frames from one look at the noise of all pixels to the next.
const NOISE_FRAMES: usize = 8;
/// The light of a picture of which most rests is looked at so often, seconds.
const LIGHT_S: f64 = 0.07;
/// Pixels round an object that are not learnt: its blurred outline and its next step.
const MARGIN: usize = 3;
/// Least age of the frame for the change gate.
const GATE_SPACING_S: f64 = 0.1;
/// A still region that nobody follows is learnt after so many tenths of a second.
const STILL_DS: u16 = 20;
/// Rows ahead of which pixels are fetched: where a row is worked here and there, it is not read in one piece.
const FETCH_ROWS: usize = 2;
/// Frames in which a region must look like a ghost before it is one.
const GHOST_FRAMES: u32 = 2;
const FOLLOWED_GHOST_FRAMES: u32 = 10;

/// Whether an instant is no longer ago than that.
fn is_within(s: f64, then: Option<Timestamp>, now: Timestamp) -> bool {
    then.is_some_and(|then| (0.0..s).contains(&now.seconds_since(then)))
}

/// What the robot must not leave: the background, or the first frame while that is being built.
fn anchor<'a>(state: BackgroundState, background: &'a Background, first: &'a [u8]) -> Option<Anchor<'a>> {
    match state {
        BackgroundState::Ready => Some(Anchor::Background(&background.level)),
        _ => (!first.is_empty()).then_some(Anchor::Picture(first)),
    }
}

/// Whether at least so many of a region's pixels are marked.
fn has_marks(region: &Region, marks: &Marks, least: usize) -> bool {
    let mut n = 0;
    region.spans().any(|(row, start, len)| {
        n += marks.count(row, start, len);
        n >= least
    })
}

/// Sets the pixels of a patch, grown by a margin, in some rows.
fn fill<T: Copy>(marks: &mut [T], patch: &Patch, margin: usize, rows: &Range<usize>, value: T, raster: &Raster) {
    let arc = patch.arc.grown(margin, raster);
    let first = arc.width.min(raster.width - arc.start);
    let last = (patch.rows[1] + margin + 1).min(rows.end);
    for row in patch.rows[0].saturating_sub(margin).max(rows.start)..last {
        let row = &mut marks[row * raster.width..(row + 1) * raster.width];
        row[arc.start..arc.start + first].fill(value);
        row[..arc.width - first].fill(value);
    }
}

fn similar(a: &Patch, b: &Patch, raster: &Raster) -> bool {
    10 * a.shared(b, raster) > 7 * a.area().max(b.area())
}

#[cfg(test)]
mod reality;

/// A group of the golden numbers.
#[cfg(test)]
pub(crate) fn golden(group: &str) -> serde_json::Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/golden.json");
    let all: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    all[group].clone()
}
