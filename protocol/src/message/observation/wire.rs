//! The observation's body by hand: it is nine tenths of all traffic, and one bit a flag is what brings four tracks and two
//! sightings under 160 bytes whatever their values.
//!
//! ```text
//! observation   epoch 8 | sequence v | capture 8 | flags 2 | tracks n 1 | [odometry 36] | sightings | tracks
//!     flags     0-2 motion  3 odometry  4-9 stages  10-15 number of sightings
//! sighting      flags 1 | [robot 1+n] | bearing 2 σ 1 | [range 2 σ 1] | [heading 2 σ 1] | confidence 1 | [n 1] | features
//!     flags     0-1 marker  2 robot  3 range  4 heading  5 the features are a right and a left edge with elevations
//! feature       [part 1] | [bar index 1] | bearing 2 σ 1 | [elevations 2+2 σ 1]
//!     part      0-2 left, right, bar, numbered bar, edge 0, edge 1   3 elevations      (absent where sighting flag 5 is set)
//! track         flags 2 | id v | bearing 2 σ 1 | elevations 2+2 σ 1 | width 2 | [range 2 σ 1] | confidence 1 | [appearance 16]
//!     flags     0-1 state  2-3 lower end  4-5 upper end  6 range  7 appearance  8-10 class  11 doubtful
//! v             unsigned LEB128, 1-5 bytes; a track's id is the zigzag difference to the id before
//! ```
//! All little-endian. Flag bits that mean nothing must be 0.

use bincode::de::Decoder;
use bincode::enc::Encoder;
use bincode::enc::write::Writer;
use bincode::error::{DecodeError, EncodeError};
use bincode::{BorrowDecode, Decode, Encode};

use super::{
    ElevationEnd, Feature, FeaturePart, MAX_FEATURES, MAX_SIGHTINGS, MAX_TRACKS, Motion, ObjectClass, Observation,
    PeerSighting, SightedRange, Stages, TrackObservation, TrackState,
};
use crate::id::TrackId;
use crate::marker::Marker;
use crate::time::Timestamp;

const MOTIONS: [Motion; 5] = [Motion::Standing, Motion::Turning, Motion::Moving, Motion::Lifted, Motion::Unknown];
const STATES: [TrackState; 3] = [TrackState::Visible, TrackState::Merged, TrackState::Hidden];
const ENDS: [ElevationEnd; 3] = [ElevationEnd::Seen, ElevationEnd::Cut, ElevationEnd::Hidden];
const CLASSES: [ObjectClass; 5] =
    [ObjectClass::Unknown, ObjectClass::Person, ObjectClass::Robot, ObjectClass::Swaying, ObjectClass::Other];

impl Encode for Observation {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        raw(encoder, &self.epoch.to_le_bytes())?;
        put_varint(encoder, self.sequence.into())?;
        raw(encoder, &self.capture.0.to_le_bytes())?;
        // `validate` has bounded stages and counts; a longer list would spoil the flags, so it is refused here too.
        if self.stages.0 > Stages::ALL.0 || self.sightings.len() > MAX_SIGHTINGS || self.tracks.len() > MAX_TRACKS {
            return Err(EncodeError::Other("an observation's stages or counts are above their limits"));
        }
        let flags = index_of(&MOTIONS, &self.motion)
            | u16::from(self.odometry.is_some()) << 3
            | u16::from(self.stages.0) << 4
            | (self.sightings.len() as u16) << 10;
        raw(encoder, &flags.to_le_bytes())?;
        raw(encoder, &[self.tracks.len() as u8])?;
        if let Some(odometry) = &self.odometry {
            odometry.encode(encoder)?;
        }
        for sighting in &self.sightings {
            put_sighting(encoder, sighting)?;
        }
        let mut previous = 0;
        for track in &self.tracks {
            put_track(encoder, track, previous)?;
            previous = track.track.0;
        }
        Ok(())
    }
}

impl<C> Decode<C> for Observation {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let epoch = u64::from_le_bytes(<[u8; 8]>::decode(decoder)?);
        let sequence = u32::try_from(take_varint(decoder)?).map_err(|_| DecodeError::Other("sequence above 2³²"))?;
        let capture = Timestamp(u64::from_le_bytes(<[u8; 8]>::decode(decoder)?));
        let flags = u16::from_le_bytes(<[u8; 2]>::decode(decoder)?);
        let motion = pick(&MOTIONS, flags & 7, "motion")?;
        let sighting_count = usize::from(flags >> 10);
        let track_count = usize::from(u8::decode(decoder)?);
        if sighting_count > MAX_SIGHTINGS || track_count > MAX_TRACKS {
            return Err(DecodeError::LimitExceeded);
        }
        let odometry = if flags & 8 != 0 { Some(Decode::decode(decoder)?) } else { None };
        let sightings = take_list(decoder, sighting_count, |decoder| take_sighting(decoder))?;
        let mut previous = 0;
        let tracks = take_list(decoder, track_count, |decoder| {
            let track = take_track(decoder, previous)?;
            previous = track.track.0;
            Ok(track)
        })?;
        let stages = Stages((flags >> 4) as u8 & Stages::ALL.0);
        Ok(Self { epoch, sequence, capture, motion, odometry, stages, sightings, tracks })
    }
}

impl<'de, C> BorrowDecode<'de, C> for Observation {
    fn borrow_decode<D: bincode::de::BorrowDecoder<'de, Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        Self::decode(decoder)
    }
}

fn put_sighting<E: Encoder>(encoder: &mut E, sighting: &PeerSighting) -> Result<(), EncodeError> {
    if sighting.marker > Marker::RECTANGLE || sighting.features.len() > MAX_FEATURES {
        return Err(EncodeError::Other("a sighting's marker or number of features is above its limit"));
    }
    let both_edges = are_both_edges(&sighting.features);
    let flags = sighting.marker
        | u8::from(sighting.robot.is_some()) << 2
        | u8::from(sighting.range.is_some()) << 3
        | u8::from(sighting.heading.is_some()) << 4
        | u8::from(both_edges) << 5;
    raw(encoder, &[flags])?;
    if let Some(robot) = &sighting.robot {
        robot.encode(encoder)?;
    }
    (sighting.bearing, sighting.bearing_sigma).encode(encoder)?;
    if let Some(range) = &sighting.range {
        (range.range, range.sigma).encode(encoder)?;
    }
    if let Some(heading) = &sighting.heading {
        heading.encode(encoder)?;
    }
    sighting.confidence.encode(encoder)?;
    if !both_edges {
        raw(encoder, &[sighting.features.len() as u8])?;
    }
    for feature in &sighting.features {
        if !both_edges {
            put_part(encoder, feature)?;
        }
        (feature.bearing, feature.sigma).encode(encoder)?;
        if let Some(elevation) = &feature.elevation {
            elevation.encode(encoder)?;
        }
    }
    Ok(())
}

fn take_sighting<D: Decoder>(decoder: &mut D) -> Result<PeerSighting, DecodeError> {
    let flags = u8::decode(decoder)?;
    let both_edges = flags & 32 != 0;
    if flags & 3 == 3 || flags & 0xC0 != 0 {
        return Err(DecodeError::Other("unknown flags of a sighting"));
    }
    let robot = if flags & 4 != 0 { Some(Decode::decode(decoder)?) } else { None };
    let (bearing, bearing_sigma) = Decode::decode(decoder)?;
    let range = if flags & 8 != 0 { Some(take_range(decoder)?) } else { None };
    let heading = if flags & 16 != 0 { Some(Decode::decode(decoder)?) } else { None };
    let confidence = Decode::decode(decoder)?;
    let count = if both_edges { 2 } else { usize::from(u8::decode(decoder)?) };
    if count > MAX_FEATURES {
        return Err(DecodeError::LimitExceeded);
    }
    let mut edges = [FeaturePart::Right, FeaturePart::Left].into_iter();
    let features = take_list(decoder, count, |decoder| {
        let (part, has_elevation) = match edges.next().filter(|_| both_edges) {
            Some(edge) => (edge, true),
            None => take_part(decoder)?,
        };
        let (bearing, sigma) = Decode::decode(decoder)?;
        let elevation = if has_elevation { Some(Decode::decode(decoder)?) } else { None };
        Ok(Feature { part, bearing, sigma, elevation })
    })?;
    // The long form of what has a short form would be a second encoding of one message.
    if !both_edges && are_both_edges(&features) {
        return Err(DecodeError::Other("two edges in the long form"));
    }
    Ok(PeerSighting { marker: flags & 3, robot, bearing, bearing_sigma, range, heading, confidence, features })
}

fn are_both_edges(features: &[Feature]) -> bool {
    matches!(
        features,
        [
            Feature { part: FeaturePart::Right, elevation: Some(_), .. },
            Feature { part: FeaturePart::Left, elevation: Some(_), .. }
        ]
    )
}

fn put_part<E: Encoder>(encoder: &mut E, feature: &Feature) -> Result<(), EncodeError> {
    let (code, index) = match feature.part {
        FeaturePart::Left => (0, None),
        FeaturePart::Right => (1, None),
        FeaturePart::Bar(None) => (2, None),
        FeaturePart::Bar(index) => (3, index),
        FeaturePart::Edge(0) => (4, None),
        FeaturePart::Edge(1) => (5, None),
        FeaturePart::Edge(_) => return Err(EncodeError::Other("a rectangle has edges 0 and 1")),
    };
    raw(encoder, &[code | u8::from(feature.elevation.is_some()) << 3])?;
    index.map_or(Ok(()), |index| raw(encoder, &[index]))
}

fn take_part<D: Decoder>(decoder: &mut D) -> Result<(FeaturePart, bool), DecodeError> {
    let byte = u8::decode(decoder)?;
    let part = match byte & !8 {
        0 => FeaturePart::Left,
        1 => FeaturePart::Right,
        2 => FeaturePart::Bar(None),
        3 => FeaturePart::Bar(Some(u8::decode(decoder)?)),
        4 => FeaturePart::Edge(0),
        5 => FeaturePart::Edge(1),
        _ => return Err(DecodeError::Other("unknown part of a marker")),
    };
    Ok((part, byte & 8 != 0))
}

fn put_track<E: Encoder>(encoder: &mut E, track: &TrackObservation, previous: u32) -> Result<(), EncodeError> {
    let flags = index_of(&STATES, &track.state)
        | index_of(&ENDS, &track.ends[0]) << 2
        | index_of(&ENDS, &track.ends[1]) << 4
        | u16::from(track.range.is_some()) << 6
        | u16::from(track.appearance.is_some()) << 7
        | index_of(&CLASSES, &track.class) << 8
        | u16::from(track.doubtful) << 11;
    raw(encoder, &flags.to_le_bytes())?;
    let step = i64::from(track.track.0) - i64::from(previous);
    put_varint(encoder, (step << 1 ^ step >> 63) as u64)?;
    (track.bearing, track.bearing_sigma).encode(encoder)?;
    (track.elevation, track.elevation_sigma, track.width).encode(encoder)?;
    if let Some(range) = &track.range {
        (range.range, range.sigma).encode(encoder)?;
    }
    track.confidence.encode(encoder)?;
    track.appearance.map_or(Ok(()), |appearance| raw(encoder, &appearance))
}

fn take_track<D: Decoder>(decoder: &mut D, previous: u32) -> Result<TrackObservation, DecodeError> {
    let flags = u16::from_le_bytes(<[u8; 2]>::decode(decoder)?);
    if flags >> 12 != 0 {
        return Err(DecodeError::Other("unknown flags of a track"));
    }
    let zigzag = take_varint(decoder)?;
    let step = (zigzag >> 1) as i64 ^ -((zigzag & 1) as i64);
    let id = u32::try_from(i64::from(previous) + step).map_err(|_| DecodeError::Other("a track's id outside 0…2³²"))?;
    let (bearing, bearing_sigma) = Decode::decode(decoder)?;
    let (elevation, elevation_sigma, width) = Decode::decode(decoder)?;
    let range = if flags & 64 != 0 { Some(take_range(decoder)?) } else { None };
    let confidence = Decode::decode(decoder)?;
    let appearance = if flags & 128 != 0 { Some(<[u8; 16]>::decode(decoder)?) } else { None };
    Ok(TrackObservation {
        track: TrackId(id),
        state: pick(&STATES, flags & 3, "state")?,
        bearing,
        bearing_sigma,
        elevation,
        elevation_sigma,
        ends: [pick(&ENDS, flags >> 2 & 3, "end")?, pick(&ENDS, flags >> 4 & 3, "end")?],
        width,
        range,
        class: pick(&CLASSES, flags >> 8 & 7, "class")?,
        doubtful: flags & 2048 != 0,
        confidence,
        appearance,
    })
}

fn take_range<D: Decoder>(decoder: &mut D) -> Result<SightedRange, DecodeError> {
    let (range, sigma) = Decode::decode(decoder)?;
    Ok(SightedRange { range, sigma })
}

/// A list whose memory is claimed before it is allocated.
fn take_list<D: Decoder, T>(
    decoder: &mut D,
    count: usize,
    mut take: impl FnMut(&mut D) -> Result<T, DecodeError>,
) -> Result<Vec<T>, DecodeError> {
    decoder.claim_container_read::<T>(count)?;
    let mut list = Vec::with_capacity(count);
    for _ in 0..count {
        decoder.unclaim_bytes_read(size_of::<T>());
        list.push(take(decoder)?);
    }
    Ok(list)
}

fn index_of<T: PartialEq>(values: &[T], value: &T) -> u16 {
    values.iter().position(|v| v == value).unwrap_or(0) as u16
}

fn pick<T: Copy>(values: &[T], index: u16, what: &'static str) -> Result<T, DecodeError> {
    values.get(usize::from(index)).copied().ok_or(DecodeError::Other(what))
}

fn raw<E: Encoder>(encoder: &mut E, bytes: &[u8]) -> Result<(), EncodeError> {
    encoder.writer().write(bytes)
}

fn put_varint<E: Encoder>(encoder: &mut E, mut value: u64) -> Result<(), EncodeError> {
    while value >= 0x80 {
        raw(encoder, &[value as u8 | 0x80])?;
        value >>= 7;
    }
    raw(encoder, &[value as u8])
}

/// At most five bytes, that is below 2³⁵.
fn take_varint<D: Decoder>(decoder: &mut D) -> Result<u64, DecodeError> {
    let mut value = 0;
    for shift in [0, 7, 14, 21, 28] {
        let byte = u8::decode(decoder)?;
        value |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(DecodeError::Other("a variable-length number of more than 5 bytes"))
}
