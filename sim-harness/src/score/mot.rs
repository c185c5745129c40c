//! Tracks of boxes against truth by the standard definitions.
//!
//! - *CLEAR-MOT* (Bernardin and Stiefelhagen, 2008): frame by frame a person and the track last matched to it stay matched if their
//!   boxes overlap enough; what is left is assigned so that as many pairs as possible are matched, those of the largest overlap. A
//!   switch is a person matched to another track than last, however long ago. MOTA = 1 − (misses + false + switches) / truths.
//! - *IDF1* (Ristani et al., 2016): one track for each person over the whole sequence, so that the frames in which they overlap
//!   enough are most; IDF1 = 2·IDTP / (truths + boxes).
//! - *Box F*: pairs matched frame by frame whoever they are.
//!
//! Overlap is intersection over union.

mod boxes;

use std::collections::BTreeMap;

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;
use serde::Serialize;

pub use boxes::{BoxesError, Frames, TrackBox, read};

/// Counts and what follows from them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct MotScores {
    /// Least intersection over union of a pair.
    pub iou: f64,
    /// Frames in which there is a truth or a track.
    pub frames: usize,
    /// Boxes of the truth.
    pub truths: usize,
    /// Boxes of the tracks.
    pub boxes: usize,
    /// Truths without a box.
    pub misses: usize,
    /// Boxes without a truth.
    pub false_positives: usize,
    /// Identity switches.
    pub switches: usize,
    /// 1 − (misses + false positives + switches) / truths.
    pub mota: f64,
    /// Mean overlap of the pairs.
    pub motp_iou: f64,
    /// Frames of tracks with the person they stand for.
    pub idtp: usize,
    /// 2 · IDTP / (truths + boxes).
    pub idf1: f64,
    /// IDTP / boxes.
    pub idp: f64,
    /// IDTP / truths.
    pub idr: f64,
    /// Of boxes alone.
    pub box_precision: f64,
    /// Of boxes alone.
    pub box_recall: f64,
    /// Of boxes alone.
    pub box_f: f64,
}

/// Scores tracks against truth; pairs overlap by at least `iou`.
pub fn score(truth: &Frames, tracks: &Frames, iou: f64) -> MotScores {
    let mut scores = MotScores { iou, ..MotScores::default() };
    let mut last: BTreeMap<u64, u64> = BTreeMap::new();
    let mut together: BTreeMap<(u64, u64), usize> = BTreeMap::new();
    let (mut overlap, mut matches, mut box_matches) = (0.0, 0usize, 0usize);
    let none = Vec::new();
    let mut numbers: Vec<u64> = truth.keys().chain(tracks.keys()).copied().collect();
    numbers.sort_unstable();
    numbers.dedup();
    for number in &numbers {
        let (people, found) = (truth.get(number).unwrap_or(&none), tracks.get(number).unwrap_or(&none));
        let overlaps: Vec<Vec<f64>> = people
            .iter()
            .map(|p| found.iter().map(|t| p.overlap(t)).map(|o| if o >= iou { o } else { 0.0 }).collect())
            .collect();
        for (person, row) in people.iter().zip(&overlaps) {
            for (track, _) in found.iter().zip(row).filter(|(_, o)| **o > 0.0) {
                *together.entry((person.id, track.id)).or_default() += 1;
            }
        }
        box_matches += assign(&overlaps).iter().flatten().count();

        let mut left = overlaps.clone();
        let mut pairs: Vec<(usize, usize)> = Vec::new();
        for (p, person) in people.iter().enumerate() {
            let before = last.get(&person.id);
            let t = found.iter().position(|b| Some(&b.id) == before);
            if let Some(t) = t
                && left[p][t] > 0.0
            {
                pairs.push((p, t));
                left[p].fill(0.0);
                left.iter_mut().for_each(|row| row[t] = 0.0);
            }
        }
        pairs.extend(assign(&left).into_iter().enumerate().filter_map(|(p, t)| t.map(|t| (p, t))));
        for &(p, t) in &pairs {
            let (person, track) = (people[p].id, found[t].id);
            scores.switches += usize::from(last.insert(person, track).is_some_and(|before| before != track));
            overlap += overlaps[p][t];
        }
        matches += pairs.len();
        scores.truths += people.len();
        scores.boxes += found.len();
    }
    let share = |part: usize, of: usize| if of == 0 { 0.0 } else { part as f64 / of as f64 };
    scores.frames = numbers.len();
    scores.misses = scores.truths - matches;
    scores.false_positives = scores.boxes - matches;
    scores.mota = 1.0 - share(scores.misses + scores.false_positives + scores.switches, scores.truths);
    scores.motp_iou = if matches == 0 { 0.0 } else { overlap / matches as f64 };
    scores.idtp = most_together(&together);
    scores.idf1 = share(2 * scores.idtp, scores.truths + scores.boxes);
    scores.idp = share(scores.idtp, scores.boxes);
    scores.idr = share(scores.idtp, scores.truths);
    scores.box_precision = share(box_matches, scores.boxes);
    scores.box_recall = share(box_matches, scores.truths);
    scores.box_f = share(2 * box_matches, scores.truths + scores.boxes);
    scores
}

/// The track of each person: as many pairs as possible, of them those of the largest overlap; 0 is no pair.
fn assign(overlaps: &[Vec<f64>]) -> Vec<Option<usize>> {
    /// A pair more outweighs any overlap of the others.
    const PAIR: i64 = 1 << 40;
    const PER_OVERLAP: f64 = (1u64 << 24) as f64;
    let gain = |overlap: f64| if overlap > 0.0 { PAIR + (overlap * PER_OVERLAP) as i64 } else { 0 };
    let gains: Vec<Vec<i64>> = overlaps.iter().map(|row| row.iter().map(|o| gain(*o)).collect()).collect();
    best_pairs(&gains)
}

/// Frames that people and their tracks have together, one track each, at most.
fn most_together(together: &BTreeMap<(u64, u64), usize>) -> usize {
    let mut people: Vec<u64> = together.keys().map(|k| k.0).collect();
    let mut tracks: Vec<u64> = together.keys().map(|k| k.1).collect();
    for ids in [&mut people, &mut tracks] {
        ids.sort_unstable();
        ids.dedup();
    }
    let frames = |p: u64, t: u64| together.get(&(p, t)).copied().unwrap_or(0);
    let gains: Vec<Vec<i64>> = people.iter().map(|p| tracks.iter().map(|t| frames(*p, *t) as i64).collect()).collect();
    best_pairs(&gains).iter().zip(&people).filter_map(|(t, p)| t.map(|t| frames(*p, tracks[t]))).sum()
}

/// The assignment of the largest sum of gains; pairs without gain stay alone.
fn best_pairs(gains: &[Vec<i64>]) -> Vec<Option<usize>> {
    let columns = gains.first().map_or(0, Vec::len);
    if columns == 0 {
        return vec![None; gains.len()];
    }
    // The method wants at least as many columns as rows.
    let width = columns.max(gains.len());
    let gain = |row: usize, column: usize| gains[row].get(column).copied().unwrap_or(0);
    let (_, matched) = kuhn_munkres(&Matrix::from_fn(gains.len(), width, |(row, column)| gain(row, column)));
    matched.iter().enumerate().map(|(row, &column)| (gain(row, column) > 0).then_some(column)).collect()
}

#[cfg(test)]
mod tests;
