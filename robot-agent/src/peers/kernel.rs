//! Sums over boxes of the panorama, and how well a strip of it shows the rings. Plain functions over slices.

/// Running sums of gray and gray² over a panorama with `pad` columns repeated on either side of the seam, modulo 2³²: a box of
/// up to 66 000 pixels is right although the whole is not. Both tables have `(height + 1) · (width + 2·pad + 1)` entries.
pub fn integrate(gray: &[u8], width: usize, height: usize, pad: usize, sums: &mut [u32], squares: &mut [u32]) {
    let stride = width + 2 * pad + 1;
    sums[..stride].fill(0);
    squares[..stride].fill(0);
    for v in 0..height {
        let line = &gray[v * width..(v + 1) * width];
        let (mut sum, mut square) = (0u32, 0u32);
        let (above, here) = ((v * stride), ((v + 1) * stride));
        sums[here] = 0;
        squares[here] = 0;
        for x in 0..width + 2 * pad {
            let g = u32::from(line[(x + width - pad) % width]);
            sum = sum.wrapping_add(g);
            square = square.wrapping_add(g * g);
            sums[here + x + 1] = sums[above + x + 1].wrapping_add(sum);
            squares[here + x + 1] = squares[above + x + 1].wrapping_add(square);
        }
    }
}

/// One band of rows that shows one ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// First row and one past the last.
    pub rows: [usize; 2],
    /// Of the ring.
    pub reflectance: f32,
}

/// Correlation of the columns `from..to` (padded coordinates) with the bands, and gray levels per unit of reflectance. `noise2` is
/// added to the variance, so that an even wall does not correlate by chance.
pub fn correlate(
    sums: &[u32],
    squares: &[u32],
    stride: usize,
    bands: &[Band],
    from: usize,
    to: usize,
    noise2: f32,
) -> (f32, f32) {
    let (mut n, mut i, mut ii, mut r, mut rr, mut ri) = (0f32, 0f32, 0f32, 0f32, 0f32, 0f32);
    let width = (to - from) as f32;
    for band in bands {
        let (top, bottom) = (band.rows[0] * stride, band.rows[1] * stride);
        let count = width * (band.rows[1] - band.rows[0]) as f32;
        let sum = (sums[bottom + to].wrapping_sub(sums[bottom + from]))
            .wrapping_sub(sums[top + to].wrapping_sub(sums[top + from])) as f32;
        let square = (squares[bottom + to].wrapping_sub(squares[bottom + from]))
            .wrapping_sub(squares[top + to].wrapping_sub(squares[top + from])) as f32;
        n += count;
        i += sum;
        ii += square;
        r += band.reflectance * count;
        rr += band.reflectance * band.reflectance * count;
        ri += band.reflectance * sum;
    }
    let (var_r, var_i, cov) = (rr / n - r * r / (n * n), ii / n - i * i / (n * n), ri / n - r * i / (n * n));
    if var_r < 1e-4 {
        return (0.0, 0.0);
    }
    (cov / (var_r * (var_i.max(0.0) + noise2)).sqrt(), cov / var_r)
}
