//! Free floor: how far a place is from walls and furniture, whether two places see each other, and the way from one to
//! another (distance field on a grid, followed downhill).

use nalgebra::Vector2;

use super::furnishing::PaintedBlock;

/// Edge of a grid cell.
const CELL_M: f64 = 0.1;

/// The floor of a furnished room.
#[derive(Debug, Clone)]
pub struct Floor {
    half: Vector2<f64>,
    /// Middle, half size, cosine and sine of the turn.
    blocks: Vec<(Vector2<f64>, Vector2<f64>, [f64; 2])>,
}

impl Floor {
    /// Of a room (sizes along x and y) with blocks; blocks above head height leave the floor free.
    pub fn new(size_m: [f64; 2], blocks: &[PaintedBlock]) -> Self {
        let blocks = blocks
            .iter()
            .map(|b| &b.block)
            .filter(|b| b.centre.z - b.half.z < 2.0)
            .map(|b| {
                (
                    Vector2::new(f64::from(b.centre.x), f64::from(b.centre.y)),
                    Vector2::new(f64::from(b.half.x), f64::from(b.half.y)),
                    b.turn.map(f64::from),
                )
            })
            .collect();
        Self { half: Vector2::new(size_m[0] / 2.0, size_m[1] / 2.0), blocks }
    }

    /// Half of the room's sizes.
    pub fn half(&self) -> Vector2<f64> {
        self.half
    }

    /// Distance to the nearest wall or furniture; negative outside the room or inside a block.
    pub fn clearance(&self, p: Vector2<f64>) -> f64 {
        let walls = (self.half.x - p.x.abs()).min(self.half.y - p.y.abs());
        self.blocks.iter().fold(walls, |least, (centre, half, [cos, sin])| {
            let d = p - centre;
            let local = Vector2::new(cos * d.x + sin * d.y, cos * d.y - sin * d.x);
            let out = local.abs() - half;
            let outside = Vector2::new(out.x.max(0.0), out.y.max(0.0)).norm();
            least.min(if outside > 0.0 { outside } else { out.x.max(out.y) })
        })
    }

    /// Whether the straight way between two places keeps this far from everything.
    pub fn is_clear(&self, a: Vector2<f64>, b: Vector2<f64>, margin: f64) -> bool {
        let steps = ((b - a).norm() / 0.04).ceil().max(1.0) as usize;
        (0..=steps).all(|i| self.clearance(a + (b - a) * (i as f64 / steps as f64)) >= margin)
    }
}

/// Where a walker may be: the floor minus furniture and robots, grown by a body's half width.
#[derive(Debug, Clone)]
pub struct Grid {
    columns: usize,
    rows: usize,
    half: Vector2<f64>,
    clearance: Vec<f64>,
    margin: f64,
}

impl Grid {
    /// `keep_out`: discs (middle, radius) besides the furniture. A cell is free where the clearance is above `margin`.
    pub fn new(floor: &Floor, keep_out: &[(Vector2<f64>, f64)], margin: f64) -> Self {
        let half = floor.half();
        let (columns, rows) = ((2.0 * half.x / CELL_M).round() as usize, (2.0 * half.y / CELL_M).round() as usize);
        let mut grid = Self { columns, rows, half, clearance: Vec::new(), margin };
        grid.clearance = (0..columns * rows)
            .map(|i| {
                let p = grid.place(i);
                keep_out.iter().fold(floor.clearance(p), |least, (q, r)| least.min((p - q).norm() - r))
            })
            .collect();
        grid.close_pockets();
        grid
    }

    /// Leaves only the largest connected part free: nobody is born behind a cabinet.
    fn close_pockets(&mut self) {
        let mut label = vec![0usize; self.clearance.len()];
        let (mut largest, mut most) = (0, 0);
        for start in 0..label.len() {
            if label[start] != 0 || self.clearance[start] <= self.margin {
                continue;
            }
            let (mut open, mut size) = (vec![start], 0);
            label[start] = start + 1;
            while let Some(i) = open.pop() {
                size += 1;
                for (j, _) in self.neighbours(i).collect::<Vec<_>>() {
                    if label[j] == 0 && self.clearance[j] > self.margin {
                        label[j] = start + 1;
                        open.push(j);
                    }
                }
            }
            if size > most {
                (largest, most) = (start + 1, size);
            }
        }
        for (clearance, label) in self.clearance.iter_mut().zip(&label) {
            if *label != largest {
                *clearance = clearance.min(self.margin);
            }
        }
    }

    fn place(&self, i: usize) -> Vector2<f64> {
        let (c, r) = (i % self.columns, i / self.columns);
        Vector2::new((c as f64 + 0.5) * CELL_M - self.half.x, (r as f64 + 0.5) * CELL_M - self.half.y)
    }

    fn cell(&self, p: Vector2<f64>) -> usize {
        let clamp = |x: f64, n: usize| (x / CELL_M).clamp(0.0, n as f64 - 1.0) as usize;
        clamp(p.y + self.half.y, self.rows) * self.columns + clamp(p.x + self.half.x, self.columns)
    }

    /// Half of the room's sizes.
    pub fn half(&self) -> Vector2<f64> {
        self.half
    }

    /// Clearance at a place, of its cell.
    pub fn clearance(&self, p: Vector2<f64>) -> f64 {
        self.clearance[self.cell(p)]
    }

    /// Whether a walker may stand there.
    pub fn is_free(&self, p: Vector2<f64>) -> bool {
        self.clearance(p) > self.margin
    }

    /// Unit vector away from the nearest obstacle.
    pub fn outwards(&self, p: Vector2<f64>) -> Vector2<f64> {
        let step = |dx, dy| self.clearance(p + Vector2::new(dx, dy));
        let slope = Vector2::new(step(CELL_M, 0.0) - step(-CELL_M, 0.0), step(0.0, CELL_M) - step(0.0, -CELL_M));
        if slope.norm() > 1e-9 { slope.normalize() } else { Vector2::zeros() }
    }

    fn neighbours(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let (c, r) = ((i % self.columns) as i64, (i / self.columns) as i64);
        (-1..=1i64).flat_map(move |dr| (-1..=1i64).map(move |dc| (dc, dr))).filter_map(move |(dc, dr)| {
            let (c, r) = (c + dc, r + dr);
            let inside = (dc, dr) != (0, 0) && c >= 0 && r >= 0 && c < self.columns as i64 && r < self.rows as i64;
            inside.then(|| ((r as usize) * self.columns + c as usize, if dc * dr == 0 { 1.0 } else { 1.4143 }))
        })
    }

    /// Lengths of the ways from everywhere to `goal`; infinite where there is none.
    pub fn field(&self, goal: Vector2<f64>) -> Field {
        let mut cost = vec![f64::INFINITY; self.clearance.len()];
        let start = self.cell(goal);
        cost[start] = 0.0;
        let mut queue = std::collections::BinaryHeap::from([(std::cmp::Reverse(0u64), start)]);
        while let Some((std::cmp::Reverse(at), i)) = queue.pop() {
            if at as f64 > cost[i] * 1e6 + 1.0 {
                continue;
            }
            for (j, step) in self.neighbours(i) {
                if self.clearance[j] <= self.margin {
                    continue;
                }
                // Ways keep a little away from obstacles where there is room.
                let crowded = ((self.margin + 0.3 - self.clearance[j]) / 0.3).clamp(0.0, 1.0);
                let next = cost[i] + step * CELL_M * (1.0 + 1.5 * crowded);
                if next + 1e-9 < cost[j] {
                    cost[j] = next;
                    queue.push((std::cmp::Reverse((next * 1e6) as u64), j));
                }
            }
        }
        Field { cost, goal }
    }

    /// A point on the way downhill from `p`, about `ahead` metres on; the goal itself when it is nearer.
    pub fn ahead(&self, field: &Field, p: Vector2<f64>, ahead: f64) -> Vector2<f64> {
        let mut i = self.cell(p);
        for _ in 0..(ahead / CELL_M).ceil() as usize {
            let best = self
                .neighbours(i)
                .filter(|(j, _)| field.cost[*j].is_finite())
                .min_by(|(a, da), (b, db)| (field.cost[*a] + da * CELL_M).total_cmp(&(field.cost[*b] + db * CELL_M)));
            match best {
                Some((j, _)) if field.cost[j] < field.cost[i] => i = j,
                _ => break,
            }
        }
        if field.cost[i] < 1.5 * CELL_M { field.goal } else { self.place(i) }
    }
}

/// Lengths of ways to a goal.
#[derive(Debug, Clone)]
pub struct Field {
    cost: Vec<f64>,
    goal: Vector2<f64>,
}

impl Field {
    /// Whether there is a way from `p`.
    pub fn reaches(&self, grid: &Grid, p: Vector2<f64>) -> bool {
        self.cost[grid.cell(p)].is_finite()
    }
}
