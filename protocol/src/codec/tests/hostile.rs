//! Truncated, extended, mutated and random bytes: an error, never a panic, never memory above the limit, and what is
//! accepted is legal and encodes again.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use super::memory::peak_of;
use super::*;

/// Words of an error beside the claimed memory.
const ERROR_TEXT: usize = 2048;
/// Cases a message and kind of ill-treatment.
const CASES: u32 = 1000;

#[test]
fn every_truncation_is_refused() {
    for_every_message!(is_refused_when_truncated);
}

#[test]
fn every_extension_is_refused() {
    for_every_message!(is_refused_when_extended);
}

#[test]
fn mutated_bytes_never_panic_nor_allocate_above_the_limit() {
    for_every_message!(survives_mutation);
}

#[test]
fn random_bodies_never_panic_nor_allocate_above_the_limit() {
    for_every_message!(survives_random_bodies);
}

#[test]
fn oversized_messages_are_refused_unread() {
    for_every_message!(is_refused_when_oversized);
}

#[test]
fn a_claim_of_terabytes_in_a_few_bytes_is_refused_without_allocating() {
    for_every_message!(survives_great_claims);
}

fn is_refused_when_truncated<M: Message>(name: &str, message: &M) {
    let envelope = encode(message).unwrap();
    for len in 0..envelope.len() {
        assert!(bounded_decode_of::<M>(&envelope[..len]).is_err(), "{name} cut to {len} bytes");
    }
}

fn is_refused_when_extended<M: Message>(name: &str, message: &M) {
    let mut envelope = encode(message).unwrap();
    for extra in [0, 1, 0xFF] {
        envelope.push(extra);
        let error = bounded_decode_of::<M>(&envelope).unwrap_err();
        assert!(matches!(error, DecodeError::Trailing { .. }), "{name}: {error}");
    }
}

fn survives_mutation<M: Message + PartialEq>(_: &str, message: &M) {
    let envelope = encode(message).unwrap();
    let places = prop::collection::vec((HEADER_LEN..envelope.len(), any::<u8>()), 1..8);
    runner()
        .run(&places, |changes| {
            let mut mutated = envelope.clone();
            for (at, byte) in changes {
                mutated[at] = byte;
            }
            accepts_only_what_it_would_send::<M>(&mutated);
            Ok(())
        })
        .unwrap();
}

fn survives_random_bodies<M: Message + PartialEq>(_: &str, message: &M) {
    let header = encode(message).unwrap()[..HEADER_LEN].to_vec();
    runner()
        .run(&prop::collection::vec(any::<u8>(), 0..300), |body| {
            let envelope = [header.clone(), body].concat();
            if envelope.len() <= M::KIND.max_bytes() {
                accepts_only_what_it_would_send::<M>(&envelope);
            }
            Ok(())
        })
        .unwrap();
}

fn is_refused_when_oversized<M: Message>(_: &str, message: &M) {
    let mut envelope = encode(message).unwrap();
    envelope.resize(M::KIND.max_bytes() + 1, 0);
    let (result, peak) = peak_of(|| decode::<M>(&envelope));
    assert!(matches!(result, Err(DecodeError::TooLong { .. })));
    assert_eq!(peak, 0);
}

fn survives_great_claims<M: Message>(_: &str, message: &M) {
    let envelope = encode(message).unwrap();
    // Bincode's marker of a u64 and 2⁴⁰, put over every place of the body, where it may be read as a length.
    let claim = [&[253u8][..], &(1u64 << 40).to_le_bytes()].concat();
    for at in HEADER_LEN..=envelope.len() {
        let mut claiming = envelope[..at].to_vec();
        claiming.extend_from_slice(&claim);
        claiming.truncate(M::KIND.max_bytes());
        let _ = bounded_decode_of::<M>(&claiming);
    }
}

/// Whether it was accepted.
pub(super) fn accepts_only_what_it_would_send<M: Message + PartialEq>(envelope: &[u8]) -> bool {
    // Equal values may have several encodings on the wire (bincode's integers), but what was read can be sent and read.
    let Ok(message) = bounded_decode_of::<M>(envelope) else { return false };
    let again = encode(&message).expect("what is accepted is legal");
    assert_eq!(decode::<M>(&again).unwrap(), message);
    true
}

fn bounded_decode_of<M: Message>(envelope: &[u8]) -> Result<M, DecodeError> {
    let (result, peak) = peak_of(|| decode::<M>(envelope));
    let limit = ALLOCATION_FACTOR * M::KIND.max_bytes() + ERROR_TEXT;
    assert!(peak <= limit, "{} allocated {peak} bytes, {limit} are allowed", M::KIND);
    result
}

fn runner() -> TestRunner {
    // Seeded: a failure here is a failure everywhere.
    let config = ProptestConfig { cases: CASES, failure_persistence: None, ..ProptestConfig::default() };
    TestRunner::new_with_rng(
        config,
        proptest::test_runner::TestRng::deterministic_rng(prop::test_runner::RngAlgorithm::ChaCha),
    )
}
