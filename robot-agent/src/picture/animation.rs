//! An animated picture that any browser opens (APNG): gray levels and the tracks' colours from one palette, times as they were.
//!
//! Its memory is bounded: when it is full every other frame goes, and of those that come only as many are taken.

use image::RgbImage;

use super::PictureError;
use super::canvas::COLOURS;

/// Most bytes of all frames, one a pixel, and most frames.
const MOST_BYTES: usize = 48 << 20;
const MOST_FRAMES: usize = 300;
/// Gray levels of the palette; the rest is for colours.
const GRAYS: usize = 216;
/// Shades of each colour, as parts of its brightness.
const SHADES: [f32; 4] = [1.0, 0.75, 0.55, 0.35];
/// Channels nearer to each other than this are gray.
const GRAY_SPREAD: u8 = 14;
/// Shortest and longest time that a frame is shown, milliseconds.
const SHOWN_MS: [f64; 2] = [20.0, 2000.0];

/// Frames of one size in order of time.
#[derive(Debug)]
pub struct Animation {
    size_px: [u32; 2],
    frames: Vec<(f64, Vec<u8>)>,
    /// Every so many of the frames that come are taken.
    step: usize,
    came: usize,
    palette: Palette,
}

impl Default for Animation {
    fn default() -> Self {
        Self { size_px: [0, 0], frames: Vec::new(), step: 1, came: 0, palette: Palette::new() }
    }
}

impl Animation {
    /// Whether the next frame would be taken; a frame that is not need not be drawn.
    pub fn wants_next(&self) -> bool {
        self.came.is_multiple_of(self.step)
    }

    /// Passes a frame over.
    pub fn skip(&mut self) {
        self.came += 1;
    }

    /// Adds a frame that was taken at a time; one of another size than the first is left out.
    pub fn add(&mut self, picture: &RgbImage, time_s: f64) {
        let wanted = self.wants_next();
        self.came += 1;
        let size_px = [picture.width(), picture.height()];
        if self.frames.is_empty() {
            self.size_px = size_px;
        }
        if !wanted || size_px != self.size_px {
            return;
        }
        self.frames.push((time_s, picture.pixels().map(|p| self.palette.index(p.0)).collect()));
        let bytes: usize = self.frames.iter().map(|(_, f)| f.len()).sum();
        if bytes > MOST_BYTES || self.frames.len() > MOST_FRAMES {
            let mut n = 0;
            self.frames.retain(|_| {
                n += 1;
                n % 2 == 1
            });
            self.step *= 2;
        }
    }

    /// Frames that it has.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is nothing to show.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// As APNG, repeated for ever.
    ///
    /// # Errors
    /// What the encoder says, also where there are no frames.
    pub fn encode(&self) -> Result<Vec<u8>, PictureError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size_px[0], self.size_px[1]);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(self.palette.bytes());
        encoder.set_animated(self.frames.len() as u32, 0)?;
        let mut writer = encoder.write_header()?;
        for (n, (time_s, frame)) in self.frames.iter().enumerate() {
            let next_s = self.frames.get(n + 1).map_or(time_s + 1.0, |(next, _)| *next);
            let shown_ms = ((next_s - time_s) * 1e3).clamp(SHOWN_MS[0], SHOWN_MS[1]);
            writer.set_frame_delay(shown_ms.round() as u16, 1000)?;
            writer.write_image_data(frame)?;
        }
        writer.finish()?;
        Ok(bytes)
    }
}

#[derive(Debug)]
struct Palette {
    colours: Vec<[u8; 3]>,
}

impl Palette {
    fn new() -> Self {
        let gray = |n: usize| [(n * 255 / (GRAYS - 1)) as u8; 3];
        let shades = COLOURS.iter().flat_map(|c| SHADES.map(|s| c.map(|v| (f32::from(v) * s) as u8)));
        Self { colours: (0..GRAYS).map(gray).chain(shades).collect() }
    }

    fn bytes(&self) -> Vec<u8> {
        self.colours.iter().flatten().copied().collect()
    }

    fn index(&self, rgb: [u8; 3]) -> u8 {
        let [low, high] = rgb.iter().fold([u8::MAX, 0], |[l, h], v| [l.min(*v), h.max(*v)]);
        if high - low < GRAY_SPREAD {
            return ((usize::from(rgb[1]) * (GRAYS - 1) + 127) / 255) as u8;
        }
        let apart = |c: &[u8; 3]| c.iter().zip(rgb).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum::<u32>();
        let nearest = (GRAYS..self.colours.len()).min_by_key(|n| apart(&self.colours[*n]));
        nearest.unwrap_or(0) as u8
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn frame(n: u32) -> RgbImage {
        RgbImage::from_fn(40, 20, |x, _| if x == n % 40 { Rgb(COLOURS[1]) } else { Rgb([(6 * x) as u8; 3]) })
    }

    #[test]
    fn an_animation_holds_its_frames_with_their_times_and_colours() {
        let mut animation = Animation::default();
        (0..5).for_each(|n| animation.add(&frame(n), f64::from(n) * 0.25));
        let bytes = animation.encode().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control.map(|a| (a.num_frames, a.num_plays)), Some((5, 0)));
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        for n in 0..5 {
            reader.next_frame(&mut pixels).unwrap();
            let shown = reader.info().frame_control.unwrap();
            assert_eq!((shown.delay_num, shown.delay_den), (if n < 4 { 250 } else { 1000 }, 1000));
            let palette = reader.info().palette.clone().unwrap();
            let at = |x: usize| &palette[3 * usize::from(pixels[x])..][..3];
            assert_eq!(at(n), COLOURS[1]);
            assert!(at(30).iter().all(|v| v.abs_diff(180) <= 1));
        }
    }

    #[test]
    fn a_long_one_becomes_sparser_and_stays_bounded() {
        let mut animation = Animation::default();
        (0..2000).for_each(|n| animation.add(&frame(n), f64::from(n) * 0.1));
        assert!(animation.len() <= MOST_FRAMES && animation.len() > MOST_FRAMES / 3, "{}", animation.len());
        let spacing: Vec<f64> = animation.frames.windows(2).map(|w| w[1].0 - w[0].0).collect();
        assert!(spacing.iter().all(|s| (s - spacing[0]).abs() < 1e-9), "even times");
        animation.add(&RgbImage::new(3, 3), 300.0);
        assert!(animation.encode().is_ok());
        assert!(Animation::default().encode().is_err());
    }
}
