//! From metres of the team frame to pixels: x to the right, y up, one scale for both.

/// Room round what is shown, metres.
const MARGIN_M: f64 = 0.4;
/// The least that is shown, metres across.
const LEAST_M: f64 = 4.0;
/// Rows above and below that are kept for text, pixels.
const TEXT_ROWS_PX: f64 = 48.0;

/// Which part of the floor is shown.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    low_m: [f64; 2],
    high_m: [f64; 2],
    scale: f64,
    /// Pixel of `low_m`.
    origin_px: [f64; 2],
}

impl View {
    /// The view that holds all points; not finite ones are left out.
    pub(super) fn holding(points_m: Vec<[f64; 2]>, [width, height]: [u32; 2]) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points_m.into_iter().filter(|p| p.iter().all(|v| v.is_finite() && v.abs() < 1e4)) {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis] - MARGIN_M);
                high[axis] = high[axis].max(point[axis] + MARGIN_M);
            }
        }
        for axis in 0..2 {
            if low[axis] > high[axis] {
                (low[axis], high[axis]) = (0.0, 0.0);
            }
            let missing = (LEAST_M - (high[axis] - low[axis])).max(0.0);
            low[axis] -= missing / 2.0;
            high[axis] += missing / 2.0;
        }
        let (width, height) = (f64::from(width), f64::from(height));
        let scale = (width / (high[0] - low[0])).min((height - 2.0 * TEXT_ROWS_PX) / (high[1] - low[1]));
        let left = (width - scale * (high[0] - low[0])) / 2.0;
        let bottom = (height + scale * (high[1] - low[1])) / 2.0;
        Self { low_m: low, high_m: high, scale, origin_px: [left, bottom] }
    }

    /// Lower left and upper right corner, metres.
    pub(super) fn bounds_m(&self) -> [[f64; 2]; 2] {
        [self.low_m, self.high_m]
    }

    pub(super) fn px_per_m(&self) -> f64 {
        self.scale
    }

    pub(super) fn px(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.origin_px[0] + self.scale * (x - self.low_m[0]), self.origin_px[1] - self.scale * (y - self.low_m[1])]
    }
}
