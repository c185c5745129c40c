//! Many random and ill-treated messages through every decoder: no panic, no memory above the limit, and what is accepted is legal.
//!
//! ```text
//! cargo test --release -p protocol --lib -- --ignored ten_million      # the whole; the gate runs a hundredth of it
//! ```

use super::hostile::accepts_only_what_it_would_send;
use super::*;

/// One kind of message: a good envelope, and its decoder under watch (whether it accepted).
struct Victim {
    envelope: Vec<u8>,
    decode: fn(&[u8]) -> bool,
    max_bytes: usize,
}

fn victim<M: Message + PartialEq>(message: &M) -> Victim {
    Victim {
        envelope: encode(message).unwrap(),
        decode: |bytes| accepts_only_what_it_would_send::<M>(bytes),
        max_bytes: M::KIND.max_bytes(),
    }
}

fn victims() -> Vec<Victim> {
    vec![
        victim(&samples::announcement()),
        victim(&samples::observation()),
        victim(&samples::full_observation()),
        victim(&samples::alarm()),
        victim(&samples::health()),
        victim(&samples::command()),
        victim(&samples::command_reply()),
        victim(&samples::clock_probe()),
        victim(&samples::clock_reply()),
        victim(&samples::replay_start()),
        victim(&samples::map()),
        victim(&samples::guidance()),
        victim(&samples::surroundings()),
        victim(&samples::edges()),
        victim(&samples::candidacy()),
    ]
}

#[test]
fn a_hundred_thousand_hostile_messages_are_refused_or_legal() {
    attack(100_000, 1);
}

#[test]
#[ignore = "minutes: run it in a release build after changes of the wire"]
fn ten_million_hostile_messages_are_refused_or_legal() {
    attack(10_000_000, 2);
}

fn attack(count: u64, seed: u64) {
    let victims = victims();
    let mut dice = Dice(seed);
    let (mut accepted, mut by_way) = (0u64, [0u64; 6]);
    for _ in 0..count {
        let way = dice.below(by_way.len());
        let (victim, other) = (&victims[dice.below(victims.len())], &victims[dice.below(victims.len())]);
        let bytes = ill_treated(way, victim, other, &mut dice);
        by_way[way] += 1;
        accepted += u64::from((victim.decode)(&bytes));
    }
    println!("{count} messages, {accepted} of them legal; by way of ill-treatment: {by_way:?}");
    assert!(accepted < count, "nothing was refused");
    assert!(by_way.iter().all(|n| *n > count / 10), "{by_way:?}");
}

fn ill_treated(way: usize, victim: &Victim, other: &Victim, dice: &mut Dice) -> Vec<u8> {
    let mut bytes = victim.envelope.clone();
    match way {
        // A few bytes changed, the header too.
        0 => {
            for _ in 0..=dice.below(8) {
                let at = dice.below(bytes.len());
                bytes[at] = dice.byte();
            }
        }
        // A good header and noise.
        1 => {
            bytes.truncate(HEADER_LEN);
            let len = dice.below(400).min(victim.max_bytes - HEADER_LEN);
            bytes.extend((0..len).map(|_| dice.byte()));
        }
        // Noise alone.
        2 => bytes = (0..dice.below(400)).map(|_| dice.byte()).collect(),
        // Cut, or continued by another message.
        3 => {
            bytes.truncate(dice.below(bytes.len() + 1));
            if dice.below(2) == 0 {
                let from = dice.below(other.envelope.len());
                bytes.extend_from_slice(&other.envelope[from..]);
            }
        }
        // A length of terabytes, of a million, of just too many, somewhere in the body.
        4 => {
            let at = HEADER_LEN + dice.below(bytes.len() - HEADER_LEN + 1);
            bytes.truncate(at);
            match dice.below(3) {
                0 => bytes.extend([&[253][..], &(1u64 << 40).to_le_bytes()].concat()),
                1 => bytes.extend([&[252][..], &(1u32 << 20).to_le_bytes()].concat()),
                _ => bytes.extend([&[251][..], &u16::MAX.to_le_bytes()].concat()),
            }
            bytes.extend((0..dice.below(64)).map(|_| dice.byte()));
        }
        // A piece moved.
        _ => {
            let (from, to) = (dice.below(bytes.len()), dice.below(bytes.len()));
            let piece: Vec<u8> = bytes[from..].iter().copied().take(dice.below(32)).collect();
            bytes.splice(to..to, piece);
        }
    }
    bytes
}

/// SplitMix64: a seed means the same attack everywhere.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }

    fn byte(&mut self) -> u8 {
        self.next() as u8
    }
}
