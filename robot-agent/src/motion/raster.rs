//! The shape of the picture that is tested: its size, and whether its last column touches its first.

/// Size and topology of a picture. All slices that travel with it hold `width · height` values, row by row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Raster {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Whether column `width − 1` is a neighbour of column 0 (a panorama over 360°).
    pub wraps: bool,
}

impl Raster {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether there is no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The column at `x`, round a ring; `None` beside a picture that is none.
    #[inline]
    pub fn column_at(&self, x: isize) -> Option<usize> {
        match usize::try_from(x) {
            // Most are in the picture: no division for those.
            Ok(x) if x < self.width => Some(x),
            _ => self.wraps.then(|| x.rem_euclid(self.width as isize) as usize),
        }
    }

    /// `to − from` in columns, the short way round on a ring: in (−width/2, width/2].
    pub fn column_difference(&self, to: f64, from: f64) -> f64 {
        let d = to - from;
        if !self.wraps {
            return d;
        }
        let w = self.width as f64;
        let wrapped = d - w * (d / w).round();
        if wrapped <= -w / 2.0 { wrapped + w } else { wrapped }
    }

    /// A column position brought into [0, width) on a ring; unchanged otherwise.
    pub fn wrap_column(&self, column: f64) -> f64 {
        if self.wraps { column.rem_euclid(self.width as f64) } else { column }
    }

    /// The column `offset` to the right of `start` (`start < width`, `offset ≤ width`).
    #[inline]
    pub fn column(&self, start: usize, offset: usize) -> usize {
        let c = start + offset;
        if self.wraps && c >= self.width { c - self.width } else { c }
    }
}

/// An interval of columns; on a ring it may run over the seam (`start + width > raster width`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arc {
    /// First column.
    pub start: usize,
    /// Number of columns, at least 1 and at most the raster's width.
    pub width: usize,
}

impl Arc {
    /// The middle, between pixel centres for an even width; may exceed the raster's width on a ring.
    pub fn centre(&self) -> f64 {
        self.start as f64 + (self.width as f64 - 1.0) / 2.0
    }

    /// Number of columns in both.
    pub fn overlap(&self, other: &Self, raster: &Raster) -> usize {
        let plain = |a: usize, b: usize| {
            let lo = a.max(b);
            let hi = (a + self.width).min(b + other.width);
            hi.saturating_sub(lo)
        };
        if !raster.wraps {
            return plain(self.start, other.start);
        }
        let w = raster.width;
        (plain(self.start, other.start) + plain(self.start + w, other.start) + plain(self.start, other.start + w))
            .min(self.width)
            .min(other.width)
    }

    /// Columns between the two, 0 where they touch or overlap.
    pub fn gap(&self, other: &Self, raster: &Raster) -> usize {
        let d = raster.column_difference(other.centre(), self.centre()).abs();
        (d - (self.width + other.width) as f64 / 2.0).round().max(0.0) as usize
    }

    /// The smallest arc that holds both.
    pub fn union(&self, other: &Self, raster: &Raster) -> Self {
        if !raster.wraps {
            let start = self.start.min(other.start);
            let end = (self.start + self.width).max(other.start + other.width);
            return Self { start, width: end - start };
        }
        let w = raster.width;
        // Start at one, go right until the other is covered; take the shorter of both ways.
        let from = |a: &Self, b: &Self| {
            let offset = (b.start + w - a.start) % w;
            Self { start: a.start, width: a.width.max(offset + b.width).min(w) }
        };
        let (ab, ba) = (from(self, other), from(other, self));
        if ab.width <= ba.width { ab } else { ba }
    }

    /// Grown by `margin` columns on both sides, clipped to the raster.
    pub fn grown(&self, margin: usize, raster: &Raster) -> Self {
        if raster.wraps {
            let width = (self.width + 2 * margin).min(raster.width);
            return Self { start: (self.start + raster.width - margin % raster.width) % raster.width, width };
        }
        let start = self.start.saturating_sub(margin);
        let end = (self.start + self.width + margin).min(raster.width);
        Self { start, width: end - start }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RING: Raster = Raster { width: 100, height: 10, wraps: true };

    #[test]
    fn column_differences_take_the_short_way_over_the_seam() {
        assert_eq!(RING.column_difference(2.0, 98.0), 4.0);
        assert_eq!(RING.column_difference(98.0, 2.0), -4.0);
        assert_eq!(Raster { wraps: false, ..RING }.column_difference(98.0, 2.0), 96.0);
    }

    #[test]
    fn arcs_overlap_and_join_over_the_seam() {
        let (a, b) = (Arc { start: 95, width: 10 }, Arc { start: 2, width: 5 });
        assert_eq!(a.overlap(&b, &RING), 3);
        assert_eq!(a.union(&b, &RING), Arc { start: 95, width: 12 });
        assert_eq!(b.union(&a, &RING), Arc { start: 95, width: 12 });
        assert_eq!(a.gap(&Arc { start: 9, width: 4 }, &RING), 4);
        assert_eq!(a.grown(2, &RING), Arc { start: 93, width: 14 });
    }
}
