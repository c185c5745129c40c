//! A flat rectangle's paint and light, as grids that are looked up between their values.

use super::scene::Glow;

/// Edge of a texel of paint.
pub(super) const PAINT_TEXEL_M: f32 = 0.01;
/// The paint and its coarser copies, each of twice the texel.
const LEVELS: usize = 5;

#[derive(Debug)]
pub(super) struct Patch {
    levels: Vec<Map<f32>>,
    light: Map<Glow>,
}

/// Values on a grid over a patch.
#[derive(Debug)]
pub(super) struct Map<T> {
    columns: usize,
    rows: usize,
    /// Grid steps a metre along u and v, and the place of the first value on the grid.
    scale: [f32; 2],
    first: f32,
    values: Vec<T>,
}

impl Map<f32> {
    fn halved(&self, size: [f32; 2]) -> Self {
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let at = |i: usize, j: usize| self.values[j.min(self.rows - 1) * self.columns + i.min(self.columns - 1)];
        let values = (0..columns * rows)
            .map(|n| {
                let (i, j) = (2 * (n % columns), 2 * (n / columns));
                0.25 * (at(i, j) + at(i + 1, j) + at(i, j + 1) + at(i + 1, j + 1))
            })
            .collect();
        Self::middles(columns, rows, size, values)
    }
}

impl<T> Map<T> {
    /// Values in the middles of equal cells.
    pub(super) fn middles(columns: usize, rows: usize, size: [f32; 2], values: Vec<T>) -> Self {
        Self { columns, rows, scale: [columns as f32 / size[0], rows as f32 / size[1]], first: 0.5, values }
    }

    /// Values on the corners of equal cells, so that the outermost lie on the patch's edges. At least two each way.
    pub(super) fn corners(columns: usize, rows: usize, size: [f32; 2], values: Vec<T>) -> Self {
        let scale = [(columns - 1) as f32 / size[0], (rows - 1) as f32 / size[1]];
        Self { columns, rows, scale, first: 0.0, values }
    }

    /// The four values round a place and their weights.
    #[inline(always)]
    fn around(&self, u: f32, v: f32) -> [(&T, f32); 4] {
        let x = (u * self.scale[0] - self.first).clamp(0.0, (self.columns - 1) as f32);
        let y = (v * self.scale[1] - self.first).clamp(0.0, (self.rows - 1) as f32);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let right = usize::from(i + 1 < self.columns);
        let at = j * self.columns + i;
        let up = if j + 1 < self.rows { at + self.columns } else { at };
        [
            (&self.values[at], (1.0 - fx) * (1.0 - fy)),
            (&self.values[at + right], fx * (1.0 - fy)),
            (&self.values[up], (1.0 - fx) * fy),
            (&self.values[up + right], fx * fy),
        ]
    }
}

impl Patch {
    /// From the finest paint and the light.
    pub(super) fn new(finest: Map<f32>, light: Map<Glow>, size: [f32; 2]) -> Self {
        let mut levels = vec![finest];
        while levels.len() < LEVELS {
            let coarser = levels[levels.len() - 1].halved(size);
            levels.push(coarser);
        }
        Self { levels, light }
    }

    #[inline(always)]
    pub(super) fn paint(&self, u: f32, v: f32, blur_m: f32) -> f32 {
        let mut level = 0;
        let mut texel = 1.5 * PAINT_TEXEL_M;
        while blur_m > texel && level + 1 < LEVELS {
            level += 1;
            texel *= 2.0;
        }
        self.levels[level].around(u, v).into_iter().map(|(value, weight)| value * weight).sum()
    }

    #[inline(always)]
    pub(super) fn light_at(&self, u: f32, v: f32) -> Glow {
        let mut glow = Glow::default();
        for (light, weight) in self.light.around(u, v) {
            glow.add(light, weight);
        }
        glow
    }
}
