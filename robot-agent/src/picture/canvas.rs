//! Drawing on a gray picture that was enlarged: boxes, lines, icons and text that stay readable.

use ab_glyph::{FontRef, PxScale};
use image::{GrayImage, Rgb, RgbImage};
use imageproc::drawing::{
    draw_filled_circle_mut, draw_filled_rect_mut, draw_hollow_circle_mut, draw_line_segment_mut, draw_text_mut,
    text_size,
};
use imageproc::rect::Rect;

/// Drawn on in the coordinates of the picture it was made from.
pub(crate) struct Canvas {
    pub(crate) image: RgbImage,
    scale: f32,
    font: Option<FontRef<'static>>,
}

pub(crate) const TEXT_PX: f32 = 15.0;
pub(crate) const WHITE: Rgb<u8> = Rgb([245, 245, 245]);
pub(crate) const DIM: Rgb<u8> = Rgb([150, 150, 150]);
const INK: Rgb<u8> = Rgb([12, 12, 14]);

/// Of tracks, by their number.
pub(crate) const COLOURS: [[u8; 3]; 10] = [
    [255, 196, 37],
    [64, 196, 255],
    [255, 99, 132],
    [124, 222, 88],
    [205, 140, 255],
    [255, 145, 60],
    [70, 225, 190],
    [250, 120, 220],
    [200, 220, 70],
    [130, 160, 255],
];

/// A colour for a number: neighbours differ clearly, also in brightness from the gray picture.
pub(crate) fn colour(id: u32) -> Rgb<u8> {
    Rgb(COLOURS[id as usize % COLOURS.len()])
}

impl Canvas {
    /// A gray picture, enlarged by a whole factor so that text has room: to about 2000 columns.
    pub(crate) fn new(gray: &[u8], width: usize, height: usize) -> Self {
        Self::enlarged(gray, width, height, (2400 / width.max(1)).clamp(1, 4) as u32)
    }

    /// A gray picture enlarged by a whole factor.
    pub(crate) fn enlarged(gray: &[u8], width: usize, height: usize, factor: u32) -> Self {
        let small = GrayImage::from_raw(width as u32, height as u32, gray.to_vec()).unwrap_or_default();
        let large = if factor == 1 {
            small
        } else {
            image::imageops::resize(
                &small,
                width as u32 * factor,
                height as u32 * factor,
                image::imageops::FilterType::CatmullRom,
            )
        };
        let image = RgbImage::from_fn(large.width(), large.height(), |x, y| {
            let v = large.get_pixel(x, y).0[0];
            Rgb([v, v, v])
        });
        // Bytes of the crate: they parse, or text is left out rather than a picture.
        let font = FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR).ok();
        Self { image, scale: factor as f32, font }
    }

    /// Canvas position of the left or upper border of a column or row.
    pub(crate) fn at(&self, border: f64) -> f32 {
        border as f32 * self.scale
    }

    /// Room below the picture.
    pub(crate) fn extend(&mut self, rows: u32) {
        let mut taller = RgbImage::from_pixel(self.image.width(), self.image.height() + rows, INK);
        image::imageops::replace(&mut taller, &self.image, 0, 0);
        self.image = taller;
    }

    /// A box with corners emphasised; on a ring drawn on both sides of the seam. `period`: canvas columns of a full turn.
    pub(crate) fn frame(&mut self, left: f32, top: f32, width: f32, height: f32, colour: Rgb<u8>, period: Option<f32>) {
        let corner = (width.min(height) * 0.25).clamp(4.0, 24.0);
        for shift in [0.0, -period.unwrap_or(0.0)] {
            let (l, t, r, b) = (left + shift, top, left + shift + width, top + height);
            for inset in [0.0, 1.0] {
                let (l, t, r, b) = (l + inset, t + inset, r - inset, b - inset);
                let sides = [((l, t), (r, t)), ((l, b), (r, b)), ((l, t), (l, b)), ((r, t), (r, b))];
                for ((x0, y0), (x1, y1)) in sides {
                    let faded = self.blend_towards(colour, 0.55);
                    draw_line_segment_mut(&mut self.image, (x0, y0), (x1, y1), if inset == 0.0 { faded } else { INK });
                }
            }
            for (x, y, dx, dy) in [(l, t, 1.0, 1.0), (r, t, -1.0, 1.0), (l, b, 1.0, -1.0), (r, b, -1.0, -1.0)] {
                for k in 0..2 {
                    let k = k as f32;
                    draw_line_segment_mut(&mut self.image, (x, y + k * dy), (x + dx * corner, y + k * dy), colour);
                    draw_line_segment_mut(&mut self.image, (x + k * dx, y), (x + k * dx, y + dy * corner), colour);
                }
            }
            if period.is_none() {
                break;
            }
        }
    }

    fn blend_towards(&self, colour: Rgb<u8>, part: f32) -> Rgb<u8> {
        Rgb(colour.0.map(|c| (f32::from(c) * part) as u8))
    }

    /// A straight line.
    pub(crate) fn line(&mut self, from: (f32, f32), to: (f32, f32), colour: Rgb<u8>) {
        draw_line_segment_mut(&mut self.image, from, to, colour);
    }

    /// A dot, filled or not.
    pub(crate) fn dot(&mut self, x: f32, y: f32, radius: f32, colour: Rgb<u8>, filled: bool) {
        let (centre, radius) = ((x as i32, y as i32), radius.round().max(1.0) as i32);
        if filled {
            draw_filled_circle_mut(&mut self.image, centre, radius, colour);
        } else {
            draw_hollow_circle_mut(&mut self.image, centre, radius, colour);
        }
    }

    /// A head and a body, `height` tall, its middle at (x, y).
    pub(crate) fn person_icon(&mut self, x: f32, y: f32, height: f32, colour: Rgb<u8>) {
        let head = height * 0.16;
        let top = y - height / 2.0;
        self.dot(x, top + head, head, colour, true);
        let (w, h) = ((height * 0.34).max(2.0), (height - 2.2 * head).max(2.0));
        let rect = Rect::at((x - w / 2.0) as i32, (top + 2.2 * head) as i32).of_size(w as u32, h as u32);
        draw_filled_rect_mut(&mut self.image, rect, colour);
    }

    /// Text on a dark plate, its upper left corner at (x, y), moved to stay inside. Returns the plate's lower border.
    pub(crate) fn label(&mut self, x: f32, y: f32, text: &str, colour: Rgb<u8>) -> f32 {
        let Some(font) = &self.font else { return y };
        let scale = PxScale::from(TEXT_PX);
        let (w, h) = text_size(scale, font, text);
        let (w, h) = (w + 6, h + 6);
        let x = (x as i64).clamp(0, (i64::from(self.image.width()) - i64::from(w)).max(0)) as i32;
        let y = (y as i64).clamp(0, (i64::from(self.image.height()) - i64::from(h)).max(0)) as i32;
        draw_filled_rect_mut(&mut self.image, Rect::at(x, y).of_size(w.max(1), h.max(1)), INK);
        draw_text_mut(&mut self.image, colour, x + 3, y + 2, scale, font, text);
        (y + h as i32) as f32
    }

    /// Text centred at x, its upper border at y, without a plate.
    pub(crate) fn caption(&mut self, x: f32, y: f32, text: &str, colour: Rgb<u8>) {
        let Some(font) = &self.font else { return };
        let scale = PxScale::from(TEXT_PX);
        let (w, _) = text_size(scale, font, text);
        let left = (x as i32 - w as i32 / 2).clamp(0, (self.image.width() as i32 - w as i32).max(0));
        draw_text_mut(&mut self.image, colour, left, y as i32, scale, font, text);
    }

    /// Width of a text with its plate.
    pub(crate) fn label_width(&self, text: &str) -> f32 {
        self.font.as_ref().map_or(0.0, |f| text_size(PxScale::from(TEXT_PX), f, text).0 as f32 + 6.0)
    }
}
