//! Where in the source picture each output pixel lies, computed once a camera.

use nalgebra::Vector2;

use super::{GazeWindow, PanoramaGeometry, RadialPanorama, kernel};
use crate::motion::{Canvas, Work};
use crate::optics::{MountedCamera, direction};

/// One output pixel: the upper left of its four source pixels and the weights of the right and lower ones in 1/256.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LutEntry {
    /// Index into the source, row by row.
    pub offset: u32,
    /// Weight of the right column, 0 … 256.
    pub fx: u16,
    /// Weight of the lower row, 0 … 256.
    pub fy: u16,
}

/// A picture of another size than the table was made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{what} has {got} pixels, the table is for {expected}")]
pub struct UnwarpError {
    /// Source or output.
    pub what: &'static str,
    /// Its pixels.
    pub got: usize,
    /// The pixels it should have.
    pub expected: usize,
}

/// A table from output pixels to source positions, with bilinear weights. Made for points at infinity.
#[derive(Debug, Clone)]
pub struct Lut {
    size_px: [u32; 2],
    source_size_px: [u32; 2],
    entries: Vec<LutEntry>,
    valid: Vec<bool>,
    invalid_runs: Vec<(u32, u32)>,
    /// The entries once more for vector instructions, where the processor has them.
    tiles: Option<kernel::Tiles>,
}

impl Lut {
    /// The table of a panorama. Pixels outside the camera's domain or touching its mask are not valid.
    pub fn panorama(camera: &MountedCamera, geometry: &PanoramaGeometry) -> Self {
        let bearings: Vec<(f64, f64)> =
            (0..geometry.width()).map(|u| geometry.bearing_of_column(f64::from(u)).sin_cos()).collect();
        Self::from_camera(camera, [geometry.width(), geometry.height()], |u, v| {
            let d = direction(0.0, geometry.elevation_of_row(f64::from(v)));
            let (sin, cos) = bearings[u as usize];
            nalgebra::Vector3::new(d.x * cos, d.x * sin, d.z)
        })
    }

    /// The table of a perspective window.
    pub fn gaze(camera: &MountedCamera, window: &GazeWindow) -> Self {
        Self::from_camera(camera, [window.width, window.height], |u, v| window.direction(f64::from(u), f64::from(v)))
    }

    /// The table of a panorama by image radius. Pixels outside the camera's domain or touching its mask are not valid.
    pub fn radial(camera: &MountedCamera, panorama: &RadialPanorama) -> Self {
        let mut lut = Self::from_map(panorama.size_px(), camera.image_size_px(), |u, v| {
            Some(panorama.source_of(f64::from(u), f64::from(v))).filter(|at| camera.camera().unproject(at).is_some())
        });
        lut.exclude_masked(camera);
        lut
    }

    fn exclude_masked(&mut self, camera: &MountedCamera) {
        if let Some(mask) = camera.mask() {
            self.exclude(&mask.tested);
        }
    }

    fn from_camera(
        camera: &MountedCamera,
        size_px: [u32; 2],
        direction: impl Fn(u32, u32) -> nalgebra::Vector3<f64>,
    ) -> Self {
        let mut lut =
            Self::from_map(size_px, camera.image_size_px(), |u, v| camera.project_body_direction(&direction(u, v)));
        lut.exclude_masked(camera);
        lut
    }

    /// The table of any map from output pixels (u, v) to source positions; `None` where there is none.
    pub fn from_map(
        size_px: [u32; 2],
        source_size_px: [u32; 2],
        map: impl Fn(u32, u32) -> Option<Vector2<f64>>,
    ) -> Self {
        let pixels = size_px[0] as usize * size_px[1] as usize;
        let mut entries = Vec::with_capacity(pixels);
        let mut valid = Vec::with_capacity(pixels);
        for v in 0..size_px[1] {
            for u in 0..size_px[0] {
                let entry = map(u, v).and_then(|at| entry(at, source_size_px));
                valid.push(entry.is_some());
                entries.push(entry.unwrap_or_default());
            }
        }
        let invalid_runs = runs_of_false(&valid);
        let tiles = kernel::Tiles::new(&entries, size_px[0] as usize, source_size_px.map(|n| n as usize));
        Self { size_px, source_size_px, entries, valid, invalid_runs, tiles }
    }

    /// Columns and rows of the output.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Columns and rows of the source.
    pub fn source_size_px(&self) -> [u32; 2] {
        self.source_size_px
    }

    /// The entries, row by row.
    pub fn entries(&self) -> &[LutEntry] {
        &self.entries
    }

    /// Which output pixels show the world, row by row. The others are 0 in every output and must never be tested or
    /// counted.
    pub fn valid(&self) -> &[bool] {
        &self.valid
    }

    /// Bytes that the table holds.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.entries)
            + self.valid.len()
            + size_of_val(&*self.invalid_runs)
            + self.tiles.as_ref().map_or(0, kernel::Tiles::memory_bytes)
    }

    /// Unwarps a picture (gray, row by row) into `out`.
    ///
    /// # Errors
    /// A source or output of another size than the table's.
    pub fn unwarp(&self, source: &[u8], out: &mut [u8]) -> Result<(), UnwarpError> {
        self.check(source, out)?;
        if !self.tiles.as_ref().is_some_and(|tiles| tiles.unwarp(source, out)) {
            kernel::unwarp(source, self.source_size_px[0] as usize, &self.entries, self.size_px[0] as usize, out);
        }
        self.wipe_invalid(out);
        Ok(())
    }

    /// The same where the cells of a canvas are worked, of which the old picture is kept; the others may keep what they hold.
    pub(super) fn unwarp_cells(&self, source: &[u8], mut canvas: Canvas<'_>) -> Result<(), UnwarpError> {
        if canvas.work.is_whole() {
            return self.unwarp(source, canvas.picture);
        }
        self.check(source, canvas.picture)?;
        if !self.tiles.as_ref().is_some_and(|tiles| tiles.unwarp_cells(source, &mut canvas)) {
            canvas.keep();
            let [stride, width] = [self.source_size_px[0], self.size_px[0]].map(|n| n as usize);
            kernel::unwarp(source, stride, &self.entries, width, canvas.picture);
        }
        self.wipe_invalid(canvas.picture);
        Ok(())
    }

    /// Begins to fetch what cells are unwarped from that are known to be worked, while something else is done.
    pub(super) fn fetch_first(&self, source: &[u8], work: &Work) {
        if let Some(tiles) = &self.tiles {
            tiles.fetch_first(source, work);
        }
    }

    fn check(&self, source: &[u8], out: &[u8]) -> Result<(), UnwarpError> {
        let [w, h] = self.source_size_px.map(|n| n as usize);
        for (what, got, expected) in [("the source", source.len(), w * h), ("the output", out.len(), self.valid.len())]
        {
            if got != expected {
                return Err(UnwarpError { what, got, expected });
            }
        }
        Ok(())
    }

    fn wipe_invalid(&self, out: &mut [u8]) {
        for (start, length) in &self.invalid_runs {
            out[*start as usize..][..*length as usize].fill(0);
        }
    }

    /// Makes pixels invalid that would mix in a source pixel that is not tested.
    pub(super) fn exclude(&mut self, tested: &[bool]) {
        let stride = self.source_size_px[0] as usize;
        for (entry, valid) in self.entries.iter().zip(&mut self.valid) {
            let upper = [(0, 256 - entry.fx, 256 - entry.fy), (1, entry.fx, 256 - entry.fy)];
            let lower = [(stride, 256 - entry.fx, entry.fy), (stride + 1, entry.fx, entry.fy)];
            *valid &= upper.iter().chain(&lower).filter(|(_, x, y)| *x > 0 && *y > 0).all(|(step, _, _)| {
                // Out of the mask's range cannot be; if it were, it would not be tested.
                tested.get(entry.offset as usize + step).copied().unwrap_or(false)
            });
        }
        self.invalid_runs = runs_of_false(&self.valid);
    }
}

/// The entry of a source position; on the picture's rim the position is moved to the outermost pixel centres. `None`
/// beyond the rim and for pictures without two rows and columns.
fn entry(at: Vector2<f64>, [width, height]: [u32; 2]) -> Option<LutEntry> {
    let (x, fx) = split(at.x, width)?;
    let (y, fy) = split(at.y, height)?;
    Some(LutEntry { offset: y * width + x, fx, fy })
}

/// Left neighbour and weight of the right one in 1/256, rounded: ⌊256·frac + ½⌋.
fn split(position: f64, size: u32) -> Option<(u32, u16)> {
    if size < 2 || !(position >= -0.5 && position <= f64::from(size) - 0.5) {
        return None;
    }
    let position = position.clamp(0.0, f64::from(size - 1));
    let left = (position.floor() as u32).min(size - 2);
    Some((left, (256.0 * (position - f64::from(left)) + 0.5).floor() as u16))
}

/// (start, length) of each run of `false`.
fn runs_of_false(valid: &[bool]) -> Vec<(u32, u32)> {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for (i, _) in valid.iter().enumerate().filter(|(_, valid)| !**valid) {
        let i = i as u32;
        match runs.last_mut() {
            Some((start, length)) if *start + *length == i => *length += 1,
            _ => runs.push((i, 1)),
        }
    }
    runs
}
