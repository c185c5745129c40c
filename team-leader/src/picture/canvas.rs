//! Smooth shapes on a picture. A pixel is covered by as much of a shape as its centre's distance to the edge says, so lines
//! and circles of any width are anti-aliased without drawing them larger first. Text is `imageproc`'s.

use ab_glyph::{FontRef, PxScale};
use image::{Rgb, RgbImage};
use imageproc::drawing::draw_text_mut;

/// A picture that is drawn on. Coordinates in pixels, x to the right, y down; everything outside is cut off.
pub(super) struct Canvas {
    image: RgbImage,
    font: Option<FontRef<'static>>,
}

impl Canvas {
    pub(super) fn new(width: u32, height: u32, paper: Rgb<u8>) -> Self {
        let font = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok();
        Self { image: RgbImage::from_pixel(width, height, paper), font }
    }

    pub(super) fn size(&self) -> [u32; 2] {
        [self.image.width(), self.image.height()]
    }

    pub(super) fn into_image(self) -> RgbImage {
        self.image
    }

    /// A line with round ends.
    pub(super) fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64, ink: Rgb<u8>, opacity: f32) {
        self.paint(&[a, b], width, ink, opacity, |p| width / 2.0 - distance_to_segment(p, a, b));
    }

    /// Lines from point to point, as one shape: where they overlap the ink is not doubled.
    pub(super) fn polyline(&mut self, points: &[[f64; 2]], width: f64, ink: Rgb<u8>, opacity: f32) {
        if opacity > 0.8 {
            points.windows(2).for_each(|pair| self.line(pair[0], pair[1], width, ink, opacity));
            return;
        }
        self.paint(points, width, ink, opacity, |p| {
            let nearest = points.windows(2).map(|pair| distance_to_segment(p, pair[0], pair[1]));
            width / 2.0 - nearest.fold(f64::INFINITY, f64::min)
        });
    }

    pub(super) fn disc(&mut self, centre: [f64; 2], radius: f64, ink: Rgb<u8>, opacity: f32) {
        self.paint(&[centre], 2.0 * radius, ink, opacity, |p| radius - distance(p, centre));
    }

    pub(super) fn ring(&mut self, centre: [f64; 2], radius: f64, width: f64, ink: Rgb<u8>, opacity: f32) {
        self.paint(&[centre], 2.0 * radius + width, ink, opacity, |p| {
            width / 2.0 - (distance(p, centre) - radius).abs()
        });
    }

    /// An upright cross of this arm.
    pub(super) fn cross(&mut self, [x, y]: [f64; 2], arm: f64, width: f64, ink: Rgb<u8>) {
        self.line([x - arm, y], [x + arm, y], width, ink, 1.0);
        self.line([x, y - arm], [x, y + arm], width, ink, 1.0);
    }

    /// The inside of a convex closed outline, either way round.
    pub(super) fn convex(&mut self, corners: &[[f64; 2]], ink: Rgb<u8>, opacity: f32) {
        let turn = corners.windows(2).map(|w| w[0][0] * w[1][1] - w[0][1] * w[1][0]).sum::<f64>().signum();
        self.paint(corners, 0.0, ink, opacity, |p| {
            let inside = corners.windows(2).map(|w| {
                let (dx, dy) = (w[1][0] - w[0][0], w[1][1] - w[0][1]);
                turn * (dx * (p[1] - w[0][1]) - dy * (p[0] - w[0][0])) / dx.hypot(dy).max(1e-9)
            });
            inside.fold(f64::INFINITY, f64::min)
        });
    }

    /// Text with its upper left corner here.
    pub(super) fn text(&mut self, [x, y]: [f64; 2], size: f32, ink: Rgb<u8>, text: &str) {
        if let Some(font) = &self.font {
            draw_text_mut(&mut self.image, ink, x.round() as i32, y.round() as i32, PxScale::from(size), font, text);
        }
    }

    /// Blends `ink` in wherever `depth` (pixels inside the shape, negative outside) says, near `points` grown by `width`.
    fn paint(&mut self, points: &[[f64; 2]], width: f64, ink: Rgb<u8>, opacity: f32, depth: impl Fn([f64; 2]) -> f64) {
        let reach = width / 2.0 + 1.0;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis] - reach);
                high[axis] = high[axis].max(point[axis] + reach);
            }
        }
        let end = |value: f64, size: u32| (value.ceil() + 1.0).clamp(0.0, f64::from(size)) as u32;
        let [columns, rows] = self.size();
        for v in low[1].max(0.0) as u32..end(high[1], rows) {
            for u in low[0].max(0.0) as u32..end(high[0], columns) {
                let coverage = (depth([f64::from(u), f64::from(v)]) + 0.5).clamp(0.0, 1.0) as f32 * opacity;
                if coverage > 0.0 {
                    let pixel = self.image.get_pixel_mut(u, v);
                    for (value, ink) in pixel.0.iter_mut().zip(ink.0) {
                        *value = (f32::from(*value) + coverage * (f32::from(ink) - f32::from(*value))).round() as u8;
                    }
                }
            }
        }
    }
}

fn distance(p: [f64; 2], q: [f64; 2]) -> f64 {
    (p[0] - q[0]).hypot(p[1] - q[1])
}

fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let along = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy).max(1e-12);
    let t = along.clamp(0.0, 1.0);
    distance(p, [a[0] + t * dx, a[1] + t * dy])
}
