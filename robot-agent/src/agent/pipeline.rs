//! The stages of a frame, in an order in which each can be left out.
//!
//! ```text
//! unwarp ─▶ change ─▶ regions ─▶ tracks ─▶ peers ─▶ record          peers first if the frame before had no time for them
//! ```
//! A mutual calibration dies without peers and the map without tracks, so neither may starve: whoever was left out
//! in one frame comes first in the next. Unwarping and change always run; without them there is no frame.

use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::observation::{MAX_SIGHTINGS, MAX_TRACKS};
use protocol::message::{AlarmKind, Motion, PeerSighting, Stages, TrackObservation, UprightEdge};

use super::readout::Readout;
use super::witness::Witnesses;
use super::{AgentError, AgentSettings, Frame, PictureKind, Progress};
use crate::motion::{BackgroundState, MotionStage, Raster};
use crate::optics::MountedCamera;
use crate::panorama::{Lut, PanoramaGeometry, UnwarpError, Watch};
use crate::peers::{Grid, Peer, PeerDetector};
use crate::picture::{self, Gallery};
use crate::structure::{self, upright_edges};
use crate::tracking::{Expected, PeerBearing, Tracker, View, bodily};

/// JPEG quality of pictures for people.
const JPEG_QUALITY: u8 = 85;

/// All that works on frames.
#[derive(Debug)]
pub struct Pipeline {
    camera: MountedCamera,
    geometry: PanoramaGeometry,
    lut: Lut,
    watch: Watch,
    motion: MotionStage,
    tracker: Tracker,
    markers: Vec<(Option<RobotId>, Marker)>,
    peer_detector: Option<PeerDetector>,
    /// Of a camera that does not see all of a picture at once.
    readout: Option<Readout>,
    /// Of a camera that looks one way.
    witnesses: Option<Witnesses>,
    edges: structure::Due,
    gallery: Gallery,
    frame: Option<Frame>,
    /// The camera's own picture of the last frame, for the gaze windows; black before the first.
    last_gray: Vec<u8>,
    todo: Vec<Stage>,
    seen: Seen,
    peers_starved: bool,
    /// The same of regions or tracks, for which the next frame takes its time: without them each frame is worked whole, the dearest kind.
    people_starved: bool,
    people_due: bool,
    peer_bearings: Vec<PeerBearing>,
    peers: usize,
    background: BackgroundState,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Unwarp,
    Change,
    Regions,
    Tracks,
    Peers,
    Record,
}

/// What a frame gave.
#[derive(Debug)]
pub struct Seen {
    /// What the robot itself does.
    pub motion: Motion,
    /// Stages that ran.
    pub stages: Stages,
    /// Stages that would have run with enough time.
    pub wanted: Stages,
    /// Fellow robots.
    pub sightings: Vec<PeerSighting>,
    /// Moving objects.
    pub tracks: Vec<TrackObservation>,
    /// What happened.
    pub events: Vec<AlarmKind>,
    /// What stands upright round the robot, now and then.
    pub edges: Option<Vec<UprightEdge>>,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            motion: Motion::Unknown,
            stages: Stages::default(),
            wanted: Stages(Stages::MOTION | Stages::PEERS),
            sightings: Vec::new(),
            tracks: Vec::new(),
            events: Vec::new(),
            edges: None,
        }
    }
}

impl Pipeline {
    /// For one camera. Also gives what cannot be looked for, in words.
    pub fn new(camera: MountedCamera, settings: &AgentSettings) -> Result<(Self, Vec<String>), AgentError> {
        let geometry = settings.panorama(&camera)?;
        let lut = Lut::panorama(&camera, &geometry);
        let raster = Raster { width: geometry.width() as usize, height: geometry.height() as usize, wraps: true };
        let valid: Vec<u8> = lut.valid().iter().map(|&valid| u8::from(valid)).collect();
        let [width, height] = camera.image_size_px();
        let view = View::panorama(geometry, &camera);
        let mut motion = settings.motion.clone();
        motion.upright_row = motion.upright_row.or_else(|| view.upright_row());
        let mut pipeline = Self {
            motion: MotionStage::new(raster, Some(&valid), motion)?,
            readout: view.is_rolling().then(Readout::default),
            tracker: Tracker::new(raster, view, settings.tracking.clone()),
            markers: Vec::new(),
            peer_detector: None,
            witnesses: (!camera.camera().is_panoramic()).then(Witnesses::default),
            edges: structure::Due::default(),
            gallery: Gallery::new(raster),
            frame: None,
            last_gray: vec![0; width as usize * height as usize],
            todo: Vec::new(),
            seen: Seen::default(),
            peers_starved: false,
            people_starved: false,
            people_due: false,
            peer_bearings: Vec::new(),
            peers: 0,
            background: BackgroundState::Suspended,
            watch: Watch::new(&lut),
            lut,
            geometry,
            camera,
        };
        let problems = pipeline.look_for(vec![(None, settings.marker.clone())]);
        Ok((pipeline, problems))
    }

    /// Looks for fellows of these looks from now on (none: nothing changes). Gives what cannot be looked for, in words.
    pub fn look_for(&mut self, markers: Vec<(Option<RobotId>, Marker)>) -> Vec<String> {
        if markers.is_empty() || markers == self.markers {
            return Vec::new();
        }
        let Some(grid) = Grid::of(&self.geometry) else {
            self.markers = markers;
            return vec!["fellow robots cannot be looked for: the camera sees nothing near the horizon".to_owned()];
        };
        let detector = PeerDetector::for_team(&self.camera, grid, &markers);
        let unsupported = detector.unsupported().iter().map(|error| format!("a fellow robot: {error}"));
        let alike = detector.alike_beacons().into_iter().map(|[a, b]| {
            format!("the beacons of {a} and {b} blink the same code: neither has a name by it; give one of them another code")
        });
        let problems = unsupported.chain(alike).collect();
        self.peer_detector = Some(detector);
        self.markers = markers;
        problems
    }

    /// Who is where in the frame that comes, as others see it.
    pub fn expect(&mut self, people: Vec<Expected>) {
        self.tracker.expect(people);
    }

    /// Takes a frame of the right size.
    pub fn begin(&mut self, frame: Frame) {
        self.frame = Some(frame);
        self.seen = Seen::default();
        self.people_due = std::mem::take(&mut self.people_starved);
        // Taken from the end.
        self.todo = vec![Stage::Record, Stage::Peers, Stage::Tracks, Stage::Regions, Stage::Change, Stage::Unwarp];
        if self.peers_starved {
            self.todo = vec![Stage::Record, Stage::Tracks, Stage::Regions, Stage::Peers, Stage::Change, Stage::Unwarp];
        }
    }

    /// Does the next stage, or leaves it out if there is no time.
    pub fn step(&mut self, hurry: bool) -> Progress {
        let Some(frame) = self.frame.take() else { return Progress::Done };
        match self.todo.pop() {
            Some(Stage::Unwarp) => self.unwarp(&frame),
            Some(Stage::Change) => self.change(&frame),
            Some(Stage::Regions) if !hurry || self.people_due => self.regions(),
            Some(Stage::Tracks) if !hurry || self.people_due => self.tracks(&frame),
            Some(Stage::Regions | Stage::Tracks) => self.people_starved = true,
            Some(Stage::Peers) => {
                self.peers_starved = hurry;
                if !hurry {
                    self.find_peers(&frame);
                }
            }
            Some(Stage::Record) if !hurry => {
                self.gallery.record(&self.motion, &self.tracker.tracks());
                self.look_round(&frame);
            }
            Some(_) => {}
            None => return Progress::Done,
        }
        if self.todo.is_empty() {
            self.last_gray = frame.gray;
            return Progress::Done;
        }
        self.frame = Some(frame);
        Progress::More
    }

    /// What the frame gave; to be taken once when all steps are done.
    pub fn take_result(&mut self) -> Seen {
        self.peers = self.seen.sightings.len();
        std::mem::take(&mut self.seen)
    }

    fn unwarp(&mut self, frame: &Frame) {
        // The sizes were checked when the frame came in; a table that disagrees leaves an old panorama.
        let whole = self.peer_detector.as_ref().is_some_and(PeerDetector::will_search);
        if let Err(error) = self.watch.unwarp(&self.lut, &frame.gray, self.motion.next_drawing(whole)) {
            debug_assert!(false, "{error}");
        }
    }

    fn change(&mut self, frame: &Frame) {
        let change = self.motion.change_drawn(frame.capture);
        self.seen.stages.0 |= Stages::MOTION;
        self.seen.motion = change.motion;
        self.seen.events.extend(change.alarm);
        self.background = change.background;
        if change.background == BackgroundState::Ready {
            self.seen.wanted.0 |= Stages::EXTRACTION | Stages::TRACKING | Stages::LOCALISATION | Stages::IDENTIFICATION;
        } else {
            self.tracker.suspend(frame.capture);
            self.seen.events.extend(self.tracker.take_events());
        }
    }

    fn regions(&mut self) {
        if self.background == BackgroundState::Ready {
            self.motion.extract();
            self.seen.stages.0 |= Stages::EXTRACTION;
        }
    }

    fn tracks(&mut self, frame: &Frame) {
        if !self.seen.stages.ran(Stages::EXTRACTION) {
            return;
        }
        self.tracker.step(&self.motion.scene(), frame.capture, &self.peer_bearings);
        self.motion.learn(self.tracker.holds());
        self.seen.tracks = self.tracker.observations();
        self.seen.tracks.truncate(MAX_TRACKS);
        self.seen.events.extend(self.tracker.take_events());
        self.seen.stages.0 |= Stages::TRACKING | Stages::LOCALISATION | Stages::IDENTIFICATION;
    }

    /// The background's upright edges, where they are due.
    fn look_round(&mut self, frame: &Frame) {
        if self.edges.is_due(frame.capture, self.background == BackgroundState::Ready) {
            let (view, scene) = (self.tracker.view(), self.motion.scene());
            let background = self.motion.background();
            self.seen.edges = Some(upright_edges(&background, scene.valid, scene.raster, view, &self.peer_bearings));
        }
    }

    fn find_peers(&mut self, frame: &Frame) {
        let Some(detector) = &mut self.peer_detector else { return };
        if matches!(self.seen.motion, Motion::Turning | Motion::Moving | Motion::Lifted) {
            detector.moved();
        }
        let mut peers = detector.follow(&frame.gray, self.motion.drawn(), frame.capture);
        if let Some(readout) = &mut self.readout {
            let view = self.tracker.view();
            readout.correct(&mut peers, frame.capture, |bearing| view.delay_at_s(bearing, 0.0));
        }
        self.seen.sightings = peers.iter().map(Peer::to_sighting).collect();
        self.seen.sightings.truncate(MAX_SIGHTINGS);
        self.peer_bearings = self.seen.sightings.iter().map(PeerBearing::of).collect();
        self.seen.stages.0 |= Stages::PEERS;
        if let Some(witnesses) = &mut self.witnesses
            && witnesses.show_standing(&self.seen.sightings, frame.capture)
            && self.seen.motion != Motion::Lifted
        {
            self.seen.motion = Motion::Standing;
        }
    }

    /// A picture for people, encoded.
    pub fn picture(&self, kind: PictureKind) -> Result<Vec<u8>, String> {
        let (gallery, panorama) = (&self.gallery, self.motion.drawn());
        let (tracks, view) = (self.tracker.tracks(), self.tracker.view());
        let encoded = match kind {
            PictureKind::Panorama => picture::encode_jpeg(&gallery.panorama(panorama, &tracks, view), JPEG_QUALITY),
            PictureKind::Gaze => {
                picture::encode_jpeg(&gallery.gaze(&self.last_gray, &self.camera, &tracks), JPEG_QUALITY)
            }
            PictureKind::Synopsis => picture::encode_jpeg(&gallery.synopsis(&self.motion), JPEG_QUALITY),
            PictureKind::Background => picture::encode_jpeg(&gallery.background(&self.motion), JPEG_QUALITY),
            PictureKind::Objects => picture::encode_png(&gallery.objects(&self.motion)),
            PictureKind::Tracks => picture::encode_png(&gallery.tracks(&self.motion)),
        };
        encoded.map_err(|error| error.to_string())
    }

    /// What of the last frame was marked (see [`bodily`]), for learning to tell bodies from shadows.
    pub fn marked_cells(&self) -> Vec<bodily::MarkedCell> {
        self.tracker.marked_cells()
    }

    /// Columns of the panorama.
    pub fn panorama_width(&self) -> usize {
        self.motion.raster().width
    }

    /// Another picture of the camera's size as its panorama.
    pub fn unwarped(&self, gray: &[u8]) -> Result<Vec<u8>, UnwarpError> {
        let mut panorama = vec![0; self.motion.raster().len()];
        self.lut.unwarp(gray, &mut panorama)?;
        Ok(panorama)
    }

    /// Background and tracks begin anew.
    pub fn restart(&mut self) {
        self.motion.restart();
        self.tracker.reset();
    }

    /// The background begins anew.
    pub fn restart_background(&mut self) {
        self.motion.restart();
    }

    /// All tracks are forgotten.
    pub fn reset_tracks(&mut self) {
        self.tracker.reset();
    }

    /// Whether objects can be told from the background.
    pub fn is_background_ready(&self) -> bool {
        self.background == BackgroundState::Ready
    }

    /// Tracks followed now.
    pub fn tracks_now(&self) -> usize {
        self.tracker.observations().len()
    }

    /// Peers in the last frame.
    pub fn peers_now(&self) -> usize {
        self.peers
    }
}
