//! The observation's hand-written encoding: its size, and that every legal one comes back.

use proptest::prelude::*;

use super::*;
use crate::id::{RobotId, TrackId};
use crate::message::observation::{FeaturePart, MAX_FEATURES, MAX_SIGHTINGS, MAX_TRACKS};
use crate::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use crate::time::Timestamp;

/// The budget of issue 2.
const BUDGET: usize = 160;

#[test]
fn an_observation_of_four_tracks_and_two_cylinder_sightings_has_at_most_160_bytes() {
    let observation = samples::observation();
    assert_eq!((observation.tracks.len(), observation.sightings.len()), (4, 2));
    assert!(observation.tracks.iter().all(|track| track.range.is_some() && track.ends == [ElevationEnd::Seen; 2]));
    assert!(observation.sightings.iter().all(|sighting| sighting.features.len() == 2
        && sighting.range.is_some()
        && sighting.features.iter().all(|feature| feature.elevation.is_some())));
    let len = encode(&observation).unwrap().len();
    assert!(len <= BUDGET, "{len} bytes");
}

#[test]
fn it_has_at_most_160_bytes_whatever_its_values() {
    let mut observation = samples::observation();
    observation.epoch = u64::MAX;
    observation.sequence = u32::MAX;
    observation.capture = Timestamp(u64::MAX);
    // The worst ids: each as far from the one before as can be.
    for (track, id) in observation.tracks.iter_mut().zip([u32::MAX, 0, u32::MAX, 0]) {
        track.track = TrackId(id);
    }
    let len = encode(&observation).unwrap().len();
    assert!(len <= BUDGET, "{len} bytes");
}

#[test]
fn the_largest_observation_fits_its_limit() {
    let mut observation = samples::full_observation();
    let mut sighting = observation.sightings[0].clone();
    sighting.robot = RobotId::new("sixteen-letters-").ok();
    sighting.range = observation.sightings[1].range;
    sighting.features = vec![sighting.features[1]; MAX_FEATURES];
    observation.sightings = vec![sighting; MAX_SIGHTINGS];
    let mut track = observation.tracks[0].clone();
    track.range = observation.sightings[0].range;
    observation.tracks = vec![track; MAX_TRACKS];
    let envelope = encode(&observation).unwrap();
    assert_eq!(decode::<Observation>(&envelope).unwrap(), observation);
}

#[test]
fn flags_that_mean_nothing_are_refused() {
    let envelope = encode(&samples::observation()).unwrap();
    // Header 4, epoch 8, sequence 2 (4711), capture 8, flags 2, tracks 1: the first sighting's flags.
    let sighting = 25;
    assert_eq!(envelope[sighting], 0b10_1000);
    for bit in [6, 7] {
        let mut changed = envelope.clone();
        changed[sighting] |= 1 << bit;
        assert!(decode::<Observation>(&changed).is_err(), "bit {bit}");
    }
}

proptest! {
    #[test]
    fn every_legal_observation_comes_back(observation in observation()) {
        let envelope = encode(&observation).unwrap();
        prop_assert_eq!(decode::<Observation>(&envelope).unwrap(), observation);
    }
}

fn observation() -> impl Strategy<Value = Observation> {
    let odometry = prop::option::of((-1f32..1.0, -1f32..1.0, -1f32..1.0, 0f32..1.0));
    (
        (any::<u64>(), any::<u32>(), any::<u64>(), 0usize..5, odometry, 0u8..64),
        prop::collection::vec(sighting(), 0..6),
        prop::collection::vec(track(), 0..6),
    )
        .prop_map(|((epoch, sequence, capture, motion, odometry, stages), sightings, tracks)| Observation {
            epoch,
            sequence,
            capture: Timestamp(capture),
            motion: [Motion::Standing, Motion::Turning, Motion::Moving, Motion::Lifted, Motion::Unknown][motion],
            odometry: odometry.map(|(dx_m, dy_m, dheading_rad, v)| Odometry {
                dx_m,
                dy_m,
                dheading_rad,
                covariance: [v, 0.1, -0.1, v, 0.0, v],
            }),
            stages: Stages(stages),
            sightings,
            tracks,
        })
}

fn sighting() -> impl Strategy<Value = PeerSighting> {
    let robot = prop::option::of("[a-z0-9_-]{1,16}");
    let features = prop_oneof![
        prop::collection::vec(feature(), 0..5),
        (feature(), feature(), elevation()).prop_map(|(mut right, mut left, elevation)| {
            (right.part, left.part) = (FeaturePart::Right, FeaturePart::Left);
            (right.elevation, left.elevation) = (Some(elevation), Some(elevation));
            vec![right, left]
        }),
    ];
    let heading = prop::option::of((any::<i16>(), any::<u8>()));
    (0u8..3, robot, any::<i16>(), any::<u8>(), range(), heading, any::<u8>(), features).prop_map(
        |(marker, robot, bearing, sigma, range, heading, confidence, features)| PeerSighting {
            marker,
            robot: robot.map(|name| RobotId::new(&name).unwrap()),
            bearing: Angle16(bearing),
            bearing_sigma: LogSigma(sigma),
            range,
            heading: heading.map(|(heading, sigma)| (Angle16(heading), LogSigma(sigma))),
            confidence: Fraction8(confidence),
            features,
        },
    )
}

fn feature() -> impl Strategy<Value = Feature> {
    let part = prop_oneof![
        Just(FeaturePart::Left),
        Just(FeaturePart::Right),
        prop::option::of(any::<u8>()).prop_map(FeaturePart::Bar),
        (0u8..2).prop_map(FeaturePart::Edge),
    ];
    (part, any::<i16>(), any::<u8>(), prop::option::of(elevation())).prop_map(|(part, bearing, sigma, elevation)| {
        Feature { part, bearing: Angle16(bearing), sigma: LogSigma(sigma), elevation }
    })
}

fn elevation() -> impl Strategy<Value = ([Angle16; 2], LogSigma)> {
    (-16384i16..=16384, -16384i16..=16384, any::<u8>())
        .prop_map(|(a, b, sigma)| ([Angle16(a.min(b)), Angle16(a.max(b))], LogSigma(sigma)))
}

fn range() -> impl Strategy<Value = Option<SightedRange>> {
    prop::option::of(
        (any::<u16>(), any::<u8>())
            .prop_map(|(range, sigma)| SightedRange { range: Millimetres(range), sigma: LogSigma(sigma) }),
    )
}

fn track() -> impl Strategy<Value = TrackObservation> {
    (
        (any::<u32>(), 0usize..3, any::<i16>(), any::<u8>(), elevation(), 0usize..3, 0usize..3),
        (any::<i16>(), range(), 0usize..5, any::<u8>(), any::<bool>(), prop::option::of(any::<[u8; 16]>())),
    )
        .prop_map(
            |(
                (id, state, bearing, sigma, elevation, low, high),
                (width, range, class, confidence, doubtful, appearance),
            )| {
                let ends = [ElevationEnd::Seen, ElevationEnd::Cut, ElevationEnd::Hidden];
                TrackObservation {
                    track: TrackId(id),
                    state: [TrackState::Visible, TrackState::Merged, TrackState::Hidden][state],
                    bearing: Angle16(bearing),
                    bearing_sigma: LogSigma(sigma),
                    elevation: elevation.0,
                    elevation_sigma: elevation.1,
                    ends: [ends[low], ends[high]],
                    width: Angle16(width),
                    range,
                    class: [
                        ObjectClass::Unknown,
                        ObjectClass::Person,
                        ObjectClass::Robot,
                        ObjectClass::Swaying,
                        ObjectClass::Other,
                    ][class],
                    confidence: Fraction8(confidence),
                    doubtful,
                    appearance,
                }
            },
        )
}
