//! Gray pictures of what cameras send.

/// What a camera's bytes mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// 8-bit gray.
    Grey,
    /// Two pixels in four bytes: Y U Y V.
    Yuyv,
    /// A JPEG a frame.
    Mjpeg,
}

/// The gray picture, row by row; lines longer than the picture (a driver's padding) are cut.
///
/// # Errors
/// In words: too few bytes, a JPEG that is broken or of another size.
pub fn gray(bytes: &[u8], encoding: Encoding, [width, height]: [u32; 2]) -> Result<Vec<u8>, String> {
    let (w, h) = (width as usize, height as usize);
    if w == 0 || h == 0 {
        return Err(format!("a picture of {width}×{height} pixels"));
    }
    let lines = |bytes_a_pixel: usize| {
        let (line, least) = (bytes.len() / h, w * bytes_a_pixel);
        if line < least {
            return Err(format!(
                "{} bytes came of a picture of {width}×{height} pixels that has {}",
                bytes.len(),
                least * h
            ));
        }
        Ok(bytes.chunks_exact(line).take(h).map(move |l| &l[..least]))
    };
    match encoding {
        Encoding::Grey => Ok(lines(1)?.flatten().copied().collect()),
        Encoding::Yuyv => Ok(lines(2)?.flat_map(|l| l.iter().step_by(2)).copied().collect()),
        Encoding::Mjpeg => {
            let picture = image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg)
                .map_err(|e| format!("a JPEG that cannot be decoded: {e}"))?;
            let got = [picture.width(), picture.height()];
            if got != [width, height] {
                return Err(format!("a JPEG of {}×{} pixels came, {width}×{height} were agreed on", got[0], got[1]));
            }
            Ok(picture.into_luma8().into_raw())
        }
    }
}
