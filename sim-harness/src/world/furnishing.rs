//! Furniture as painted blocks, and what hangs on the walls.

use super::solid::{Block, FACES};
use super::texture::Paint;
use crate::scenario::{FurnitureKind, FurnitureSpec};

/// A block with its paint.
#[derive(Debug, Clone)]
pub struct PaintedBlock {
    /// Shape.
    pub block: Block,
    /// A paint for each face.
    pub paint: [Paint; FACES],
    /// Which piece of furniture.
    pub piece: usize,
}

/// A picture, door or board on a wall.
#[derive(Debug, Clone, Copy)]
pub struct Hanging {
    /// Wall +x, −x, +y, −y: 0 … 3.
    pub wall: usize,
    /// Lower left corner on the wall: along the wall from its lower coordinate, above the floor.
    pub corner: [f32; 2],
    /// Width, height.
    pub size: [f32; 2],
    /// Look.
    pub paint: Paint,
}

/// All blocks of a room's furniture.
pub fn blocks(furniture: &[FurnitureSpec]) -> Vec<PaintedBlock> {
    let mut out = Vec::new();
    for (piece, spec) in furniture.iter().enumerate().filter(|(_, s)| !s.kind.is_flat()) {
        Builder { spec, piece, out: &mut out }.build();
    }
    out
}

struct Builder<'a> {
    spec: &'a FurnitureSpec,
    piece: usize,
    out: &'a mut Vec<PaintedBlock>,
}

impl Builder<'_> {
    fn build(mut self) {
        let [w, d, h] = self.spec.size_m.unwrap_or(self.spec.kind.usual_size_m()).map(|s| s as f32);
        let (wood, dark) = (Paint::Wood(0.42), Paint::Wood(0.24));
        match self.spec.kind {
            FurnitureKind::Table => {
                self.add([0.0, 0.0, h - 0.03], [w, d, 0.03], [wood; FACES]);
                self.legs(w - 0.08, d - 0.08, h - 0.03, 0.05, Paint::Plaster(0.15));
            }
            FurnitureKind::Chair => {
                let cloth = Paint::Fabric(0.22 + 0.07 * (self.piece % 3) as f32);
                self.add([0.0, 0.0, 0.42], [w, d, 0.06], [cloth; FACES]);
                self.add([0.0, d / 2.0 - 0.025, 0.50], [w, 0.05, h - 0.50], [cloth; FACES]);
                self.legs(w - 0.05, d - 0.05, 0.42, 0.035, Paint::Plaster(0.12));
            }
            FurnitureKind::Desk => {
                self.add([0.0, 0.0, h - 0.03], [w, d, 0.03], [wood; FACES]);
                self.add([w / 2.0 - 0.22, 0.0, 0.0], [0.42, d - 0.06, h - 0.03], [Paint::Drawers(0.55); FACES]);
                self.add([-w / 2.0 + 0.02, 0.0, 0.0], [0.04, d - 0.06, h - 0.03], [dark; FACES]);
                let mut screen = [Paint::Plaster(0.1); FACES];
                screen[3] = Paint::Screen;
                self.add([-0.1, 0.16, h + 0.10], [0.55, 0.04, 0.34], screen);
                self.add([-0.1, 0.18, h], [0.08, 0.08, 0.10], [Paint::Plaster(0.1); FACES]);
            }
            FurnitureKind::Cabinet => {
                self.add([0.0, 0.0, 0.0], [w, d, h], [Paint::Drawers(0.58); FACES]);
                self.add([-0.2 * w, 0.0, h], [0.28, 0.22, 0.25], [Paint::Fabric(0.3); FACES]);
            }
            FurnitureKind::Bookcase => {
                let mut paint = [dark; FACES];
                paint[3] = Paint::Books;
                self.add([0.0, 0.0, 0.0], [w, d, h], paint);
            }
            FurnitureKind::Sofa => {
                let cloth = [Paint::Fabric(0.33); FACES];
                self.add([0.0, 0.0, 0.08], [w, d, 0.34], cloth);
                self.add([0.0, d / 2.0 - 0.1, 0.42], [w, 0.2, h - 0.42], cloth);
                for side in [-1.0, 1.0] {
                    self.add([side * (w / 2.0 - 0.09), -0.1, 0.42], [0.18, d - 0.2, 0.18], cloth);
                }
            }
            FurnitureKind::Box => self.add([0.0, 0.0, 0.0], [w, d, h], [Paint::Fabric(0.45); FACES]),
            FurnitureKind::StripedBox => self.add([0.0, 0.0, 0.0], [w, d, h], [Paint::Stripes(0.2 * h); FACES]),
            FurnitureKind::Door | FurnitureKind::Poster | FurnitureKind::Whiteboard => {}
        }
    }

    fn legs(&mut self, w: f32, d: f32, height: f32, thick: f32, paint: Paint) {
        for (sx, sy) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
            self.add([sx * w, sy * d, 0.0], [thick, thick, height], [paint; FACES]);
        }
    }

    /// `foot`: middle of the block's foot in the piece's axes.
    fn add(&mut self, foot: [f32; 3], size: [f32; 3], paint: [Paint; FACES]) {
        let yaw = self.spec.yaw_deg.to_radians() as f32;
        let (sin, cos) = yaw.sin_cos();
        let [x, y] = self.spec.position_m.map(|c| c as f32);
        let block = Block::new(
            x + cos * foot[0] - sin * foot[1],
            y + sin * foot[0] + cos * foot[1],
            foot[2],
            yaw,
            size[0],
            size[1],
            size[2],
        );
        self.out.push(PaintedBlock { block, paint, piece: self.piece });
    }
}

/// What hangs on the walls of a room of this size.
pub fn hangings(furniture: &[FurnitureSpec], room_m: [f64; 3]) -> Vec<Hanging> {
    let half = [room_m[0] / 2.0, room_m[1] / 2.0];
    furniture
        .iter()
        .enumerate()
        .filter(|(_, s)| s.kind.is_flat())
        .map(|(n, s)| {
            let [x, y] = s.position_m;
            let gaps = [half[0] - x, half[0] + x, half[1] - y, half[1] + y];
            let wall = (0..4).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b])).unwrap_or(0);
            let along = if wall < 2 { y + half[1] } else { x + half[0] };
            let [w, _, h] = s.size_m.unwrap_or(s.kind.usual_size_m());
            let paint = match s.kind {
                FurnitureKind::Door => Paint::Door,
                FurnitureKind::Whiteboard => Paint::Whiteboard,
                _ => Paint::Poster(n as u32),
            };
            Hanging {
                wall,
                corner: [(along - w / 2.0) as f32, s.kind.bottom_m() as f32],
                size: [w as f32, h as f32],
                paint,
            }
        })
        .collect()
}
