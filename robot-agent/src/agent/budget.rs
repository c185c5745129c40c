//! A cap on what a robot sends, for links that others need too.
//!
//! Problem: observations grow with what there is to see, and a link that is full drops what it likes. Insight: fewer observations cost
//! the team little, fewer tracks in each a little more, and a missed fellow robot or alarm much. So a token bucket counts what goes out as
//! it stands on the wire; where it runs dry, observations are left out down to [`LEAST_RATE_HZ`], then they lose tracks, the least
//! confident first. Sightings of fellows, alarms, answers and reports always go, and what they cost is saved on the rest. When there
//! is room again everything goes again.

use std::collections::BTreeMap;

use protocol::codec::{self, Kind, Message};
use protocol::id::TrackId;
use protocol::message::{Observation, TrackObservation};
use protocol::meter::modelled_wire_bytes;
use protocol::time::Timestamp;

use super::Output;

/// Observations a second that are not left out for the cap's sake.
pub const LEAST_RATE_HZ: f64 = 2.0;
/// What may be saved up or owed, seconds of the cap. A picture owes no more than this.
const DEPTH_S: f64 = 1.0;
/// Without degradation for so long, people are told that there is room again.
const RELIEF_S: f64 = 10.0;
/// Most appearances that wait for their tracks' next observation.
const MAX_WAITING: usize = 64;

/// The bucket of one agent.
#[derive(Debug, Default)]
pub struct Budget {
    cap_bytes_per_s: Option<f64>,
    tokens: f64,
    filled: Option<Timestamp>,
    last_sent: Option<Timestamp>,
    /// Appearances in observations that were left out: they are sent once only.
    waiting: BTreeMap<TrackId, [u8; 16]>,
    degraded: Option<Timestamp>,
}

impl Budget {
    /// A cap in bytes a second on the wire; `None`: everything goes.
    pub fn new(cap_bytes_per_s: Option<f64>) -> Self {
        let tokens = cap_bytes_per_s.unwrap_or_default() * DEPTH_S;
        Self { cap_bytes_per_s, tokens, ..Self::default() }
    }

    /// What of an observation goes: all of it, less tracks, or nothing. Notices tell when this begins and ends.
    pub fn shape(
        &mut self,
        now: Timestamp,
        mut observation: Observation,
        out: &mut Vec<Output>,
    ) -> Option<Observation> {
        let Some(cap) = self.cap_bytes_per_s else { return Some(observation) };
        self.fill(now, cap);
        for track in &mut observation.tracks {
            let waited = self.waiting.remove(&track.track);
            track.appearance = track.appearance.or(waited);
        }
        let whole = wire_bytes(&observation);
        if whole <= self.tokens {
            self.relieve(now, out);
            return Some(self.send(now, observation, whole));
        }
        if self.degraded.replace(now).is_none() {
            out.push(Output::Notice(format!(
                "the cap of {cap:.0} B/s is reached: observations are left out, down to {LEAST_RATE_HZ} a second, then the least \
                 certain tracks"
            )));
        }
        let due = self.last_sent.is_none_or(|last| now.seconds_since(last) >= 0.95 / LEAST_RATE_HZ);
        // Motion since the last observation cannot be left out.
        if !due && observation.odometry.is_none() {
            observation.tracks.iter().for_each(|track| self.keep_waiting(track));
            return None;
        }
        // Dropping one by one: a track's size depends on its neighbours', and there are few.
        let mut size = whole;
        while size > self.tokens && !observation.tracks.is_empty() {
            let least = (0..observation.tracks.len()).min_by_key(|i| observation.tracks[*i].confidence)?;
            self.keep_waiting(&observation.tracks.remove(least));
            size = wire_bytes(&observation);
        }
        Some(self.send(now, observation, size))
    }

    /// The appearance of a track that is left out comes with its next sight; of too many the oldest tracks' are given up.
    fn keep_waiting(&mut self, track: &TrackObservation) {
        let Some(appearance) = track.appearance else { return };
        self.waiting.insert(track.track, appearance);
        if self.waiting.len() > MAX_WAITING {
            self.waiting.pop_first();
        }
    }

    /// Counts what goes out beside observations.
    pub fn charge(&mut self, now: Timestamp, output: &Output) {
        let Some(cap) = self.cap_bytes_per_s else { return };
        let bytes = match output {
            Output::Announcement(message) => wire_bytes(message),
            Output::Alarm(message) => wire_bytes(message),
            Output::Health(message) => wire_bytes(message),
            Output::Edges(message) => wire_bytes(message),
            Output::ClockReply(_, message) => wire_bytes(message),
            Output::CommandReply(_, message) => wire_bytes(message),
            Output::Picture(_, Ok(picture)) => modelled_wire_bytes(Kind::Picture, picture.len()) as f64,
            // Counted when they were shaped; or nothing that is sent.
            _ => return,
        };
        self.fill(now, cap);
        self.take(bytes);
    }

    fn send(&mut self, now: Timestamp, observation: Observation, bytes: f64) -> Observation {
        self.take(bytes);
        self.last_sent = Some(now);
        observation
    }

    fn take(&mut self, bytes: f64) {
        let cap = self.cap_bytes_per_s.unwrap_or_default();
        self.tokens = (self.tokens - bytes).max(-DEPTH_S * cap);
    }

    fn fill(&mut self, now: Timestamp, cap: f64) {
        // A clock that was set back fills nothing; one that was set forward fills the bucket once.
        let passed_s = self.filled.replace(now).map_or(0.0, |filled| now.seconds_since(filled)).max(0.0);
        self.tokens = (self.tokens + cap * passed_s).min(cap * DEPTH_S);
    }

    fn relieve(&mut self, now: Timestamp, out: &mut Vec<Output>) {
        if self.degraded.is_some_and(|last| now.seconds_since(last) > RELIEF_S) {
            self.degraded = None;
            out.push(Output::Notice("there is room below the cap again: everything is sent".to_owned()));
        }
    }
}

fn wire_bytes<M: Message>(message: &M) -> f64 {
    // A message that cannot be encoded is not sent, and costs nothing.
    codec::encode(message).map_or(0.0, |envelope| modelled_wire_bytes(M::KIND, envelope.len()) as f64)
}

#[cfg(test)]
mod tests {
    use protocol::marker::Marker;
    use protocol::message::{ElevationEnd, Motion, ObjectClass, PeerSighting, Stages, TrackObservation, TrackState};
    use protocol::quantity::{Angle16, Fraction8, LogSigma};

    use super::*;

    const START: Timestamp = Timestamp(1_800_000_000_000_000_000);

    #[test]
    fn without_a_cap_everything_goes() {
        let mut budget = Budget::new(None);
        for frame in 0..100 {
            assert!(budget.shape(at(frame), observation(frame, 60), &mut Vec::new()).is_some());
        }
    }

    #[test]
    fn the_rate_gives_way_first_then_tracks_by_confidence_and_fellows_never() {
        // 10 observations a second of 20 tracks and 2 fellows would be some 3.9 kB/s on the wire.
        for (cap, least_tracks) in [(3000.0, 20), (1200.0, 20), (500.0, 1), (250.0, 0)] {
            let mut budget = Budget::new(Some(cap));
            let (mut sent, mut bytes, mut fewest) = (Vec::new(), 0.0, usize::MAX);
            for frame in 0..600 {
                let Some(got) = budget.shape(at(frame), observation(frame, 20), &mut Vec::new()) else { continue };
                assert_eq!(got.sightings.len(), 2, "a fellow is missing");
                let certain: Vec<u32> = got.tracks.iter().map(|track| track.track.0).collect();
                // The most certain ones have the highest numbers here.
                assert_eq!(certain, (20 - certain.len() as u32..20).collect::<Vec<_>>());
                if frame > 100 {
                    bytes += wire_bytes(&got);
                    fewest = fewest.min(got.tracks.len());
                    sent.push(frame);
                }
            }
            let rate_hz = sent.len() as f64 / 49.9;
            assert!(bytes / 49.9 <= cap * 1.03 || fewest == 0, "cap {cap}: {:.0} B/s", bytes / 49.9);
            assert!(fewest >= least_tracks, "cap {cap}: {fewest} tracks");
            assert!(rate_hz >= 0.9 * LEAST_RATE_HZ, "cap {cap}: {rate_hz:.2} a second");
            let gap = sent.windows(2).map(|two| two[1] - two[0]).max().unwrap();
            assert!(gap <= 6, "cap {cap}: {gap} frames without an observation");
        }
    }

    #[test]
    fn it_returns_when_there_is_room_again_and_says_so_once() {
        let mut budget = Budget::new(Some(1500.0));
        let (mut out, mut sent) = (Vec::new(), 0);
        for frame in 0..400 {
            let tracks = if frame < 200 { 30 } else { 2 };
            let got = budget.shape(at(frame), observation(frame, tracks), &mut out);
            sent += u32::from(got.is_some() && frame >= 220);
        }
        assert_eq!(sent, 180, "every observation goes again");
        let notices = out.iter().filter(|output| matches!(output, Output::Notice(_))).count();
        assert_eq!(notices, 2, "{out:?}");
    }

    #[test]
    fn alarms_are_counted_and_an_appearance_is_not_lost_with_its_observation() {
        let mut budget = Budget::new(Some(600.0));
        let mut given = 0;
        for frame in 0..100 {
            let mut new = observation(frame, 10);
            if frame == 50 {
                new.tracks[9].appearance = Some([7; 16]);
            }
            let got = budget.shape(at(frame), new, &mut Vec::new());
            given += got.iter().flat_map(|o| &o.tracks).filter(|track| track.appearance == Some([7; 16])).count();
        }
        assert_eq!(given, 1);
        // Nor with a track that is left out of an observation.
        let (mut cut, mut first) = (Budget::new(Some(600.0)), [None, None]);
        for frame in 0..200 {
            let mut new = observation(frame, if frame < 100 { 10 } else { 1 });
            if frame == 50 {
                new.tracks[0].appearance = Some([7; 16]);
            }
            let got = cut.shape(at(frame), new, &mut Vec::new());
            let sent = got.iter().flat_map(|o| &o.tracks).find(|track| track.track == TrackId(0));
            first[0] = first[0].or(sent.and_then(|track| track.appearance).map(|_| frame));
            first[1] = first[1].or(sent.filter(|_| frame > 50).map(|_| frame));
        }
        assert!(first[0].is_some() && first[0] == first[1], "with its first sight after that: {first:?}");
        let before = budget.tokens;
        budget.charge(at(100), &Output::Notice("nothing is sent".to_owned()));
        assert!((budget.tokens - before).abs() < 1e-9);
        budget.charge(at(100), &Output::Picture(super::super::Token(1), Ok(vec![0; 1_000_000])));
        assert!((budget.tokens + 600.0).abs() < 1e-9, "a picture owes a second at most");
    }

    fn at(frame: u32) -> Timestamp {
        START.offset_by_secs(0.1 * f64::from(frame))
    }

    fn observation(sequence: u32, tracks: u32) -> Observation {
        let sighting = PeerSighting {
            marker: Marker::CYLINDER,
            robot: None,
            bearing: Angle16::from_rad(0.1),
            bearing_sigma: LogSigma::from_value(0.001),
            range: None,
            heading: None,
            confidence: Fraction8::from_value(1.0),
            features: Vec::new(),
        };
        let track = |id: u32| TrackObservation {
            track: TrackId(id),
            state: TrackState::Visible,
            bearing: Angle16::from_rad(0.5),
            bearing_sigma: LogSigma::from_value(0.003),
            elevation: [Angle16::from_rad(-0.2), Angle16::from_rad(0.3)],
            elevation_sigma: LogSigma::from_value(0.004),
            ends: [ElevationEnd::Seen, ElevationEnd::Seen],
            width: Angle16::from_rad(0.15),
            range: None,
            class: ObjectClass::Person,
            confidence: Fraction8::from_value(f64::from(id) / 64.0),
            doubtful: false,
            appearance: None,
        };
        Observation {
            epoch: 1,
            sequence,
            capture: at(sequence),
            motion: Motion::Standing,
            odometry: None,
            stages: Stages::ALL,
            sightings: vec![sighting.clone(), sighting],
            tracks: (0..tracks).map(track).collect(),
        }
    }
}
