//! All pictures on one sheet, each with its name and its panorama.

use ab_glyph::{FontRef, PxScale};
use image::imageops::{self, FilterType};
use image::{GrayImage, Luma};

/// Height of a row's pictures.
const ROW_PX: u32 = 190;
/// Room for a row's name above its pictures.
const NAME_PX: u32 = 24;
const GAP_PX: u32 = 8;
/// Width of the camera's picture and of the panorama.
const WIDTHS_PX: [u32; 2] = [380, 760];

/// Rows of name, picture and panorama, in two columns.
pub(super) fn sheet(rows: &[(&str, GrayImage, GrayImage)]) -> GrayImage {
    let column = WIDTHS_PX[0] + WIDTHS_PX[1] + 3 * GAP_PX;
    let row = NAME_PX + ROW_PX + GAP_PX;
    let lines = rows.len().div_ceil(2) as u32;
    let mut sheet = GrayImage::from_pixel(2 * column, lines * row + GAP_PX, Luma([255]));
    let font = FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR).ok();
    for (n, (name, picture, panorama)) in rows.iter().enumerate() {
        let n = n as u32;
        let (mut x, y) = ((n / lines) * column + GAP_PX, (n % lines) * row + GAP_PX);
        if let Some(font) = &font {
            imageproc::drawing::draw_text_mut(
                &mut sheet,
                Luma([0]),
                x as i32,
                y as i32,
                PxScale::from(19.0),
                font,
                name,
            );
        }
        for (source, width) in [picture, panorama].into_iter().zip(WIDTHS_PX) {
            let scale =
                (f64::from(width) / f64::from(source.width())).min(f64::from(ROW_PX) / f64::from(source.height()));
            let size = |side: u32| ((f64::from(side) * scale) as u32).max(1);
            let small = imageops::resize(source, size(source.width()), size(source.height()), FilterType::Triangle);
            imageops::replace(&mut sheet, &small, i64::from(x), i64::from(y + NAME_PX));
            x += width + GAP_PX;
        }
    }
    sheet
}
