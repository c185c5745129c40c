//! Boxes of a detector followed from frame to frame in one camera, as an agent follows regions: each box goes to the track
//! whose prediction it fits best, by optimal assignment.

use protocol::angle::wrap;

use crate::score::assignment::assign;

/// A box: bearing of its middle, elevations of its lower and upper edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// rad.
    pub bearing_rad: f64,
    /// rad.
    pub elevation_rad: [f64; 2],
}

/// Standard deviations by which a box may be off its prediction: bearing, and either edge.
const SPREAD_RAD: [f64; 2] = [0.05, 0.06];
/// Squared sigmas of three numbers beyond which a box is not the track's: 99.9 %.
const GATE: f64 = 16.3;
/// A track that is unseen for longer ends, frames.
const MAX_MISSED: u32 = 3;
/// How much of a new speed is believed.
const SPEED_GAIN: f64 = 0.4;

#[derive(Debug, Clone, Copy)]
struct Track {
    number: u32,
    seen: Seen,
    speed_rad: f64,
    missed: u32,
}

/// The tracks of one camera.
#[derive(Debug, Clone, Default)]
pub struct Tracks {
    tracks: Vec<Track>,
    next: u32,
}

impl Tracks {
    /// One frame; the number of each box's track.
    pub fn follow(&mut self, boxes: &[Seen]) -> Vec<u32> {
        let cost = |track: &Track, b: &Seen| {
            let ahead = f64::from(track.missed + 1);
            let turned = wrap(b.bearing_rad - track.seen.bearing_rad - track.speed_rad * ahead) / SPREAD_RAD[0];
            let ends = [0, 1].map(|k| (b.elevation_rad[k] - track.seen.elevation_rad[k]) / SPREAD_RAD[1]);
            ((turned * turned + ends[0] * ends[0] + ends[1] * ends[1]) / ahead).sqrt()
        };
        let costs: Vec<Vec<f64>> = boxes.iter().map(|b| self.tracks.iter().map(|t| cost(t, b)).collect()).collect();
        let assigned = assign(&costs, GATE.sqrt());
        let mut met = vec![false; self.tracks.len()];
        let mut numbers = Vec::with_capacity(boxes.len());
        let mut born = Vec::new();
        for (b, to) in boxes.iter().zip(assigned) {
            match to {
                Some(k) => {
                    let track = &mut self.tracks[k];
                    let step = wrap(b.bearing_rad - track.seen.bearing_rad) / f64::from(track.missed + 1);
                    track.speed_rad += SPEED_GAIN * (step - track.speed_rad);
                    (track.seen, track.missed, met[k]) = (*b, 0, true);
                    numbers.push(track.number);
                }
                None => {
                    self.next += 1;
                    born.push(Track { number: self.next, seen: *b, speed_rad: 0.0, missed: 0 });
                    numbers.push(self.next);
                }
            }
        }
        for (track, met) in self.tracks.iter_mut().zip(met) {
            track.missed += u32::from(!met);
        }
        self.tracks.retain(|t| t.missed <= MAX_MISSED);
        self.tracks.extend(born);
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(bearing_rad: f64) -> Seen {
        Seen { bearing_rad, elevation_rad: [-0.5, -0.1] }
    }

    #[test]
    fn two_boxes_keep_their_numbers_through_a_miss_and_over_the_seam() {
        let mut tracks = Tracks::default();
        let first = tracks.follow(&[seen(3.10), seen(0.0)]);
        assert_eq!(tracks.follow(&[seen(0.02), seen(3.13)]), [first[1], first[0]]);
        assert_eq!(tracks.follow(&[seen(0.04)]), [first[1]]);
        assert_eq!(tracks.follow(&[seen(-3.09), seen(0.06), seen(1.5)]), [first[0], first[1], 3]);
    }
}
