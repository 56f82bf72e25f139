//! Colour correction of renders, for scores that do not depend on the exposure.
//!
//! The exposure of a test photograph is not known from the training photographs. For a second score, the render is mapped by
//! the affine map of colours that brings it closest to the photograph in the least-squares sense, fitted to the whole picture.
//! Successors of NeRF in the Wild are evaluated with such an affine map; `color_correct` of Mip-NeRF 360's code also has
//! quadratic terms and a repetition against clipping, which are left out here. Both scores are reported, because the corrected
//! one does not detect a scene whose colours are wrong throughout.

use crate::solve::solve;

/// Weight of the identity in the fit, per pixel. It decides only what the picture leaves open, for example if all channels are equal.
const TOWARDS_IDENTITY: f64 = 1e-6;

/// Applies to `image`, RGB row by row, the affine map that brings it closest to `truth` over the pixels marked in `counts` (all
/// pixels without it). The result is not clamped.
pub fn colour_corrected(image: &[f32], truth: &[f32], counts: Option<&[bool]>) -> Vec<f32> {
    let (pixels, truths) = (image.as_chunks::<3>().0, truth.as_chunks::<3>().0);
    // The normal equations `(Σ x xᵀ + w I) m = Σ x y + w m₀` with `x = (r, g, b, 1)`, for each channel `y`.
    let mut gram = [[0.0; 4]; 4];
    let mut moments = [[0.0; 4]; 3];
    let mut count = 0.0;
    for (i, (pixel, truth)) in pixels.iter().zip(truths).enumerate() {
        if counts.is_some_and(|counts| !counts[i]) {
            continue;
        }
        let x = [f64::from(pixel[0]), f64::from(pixel[1]), f64::from(pixel[2]), 1.0];
        for row in 0..4 {
            (0..4).for_each(|column| gram[row][column] += x[row] * x[column]);
            (0..3).for_each(|channel| moments[channel][row] += x[row] * f64::from(truth[channel]));
        }
        count += 1.0;
    }
    let weight = TOWARDS_IDENTITY * f64::max(count, 1.0);
    (0..4).for_each(|row| gram[row][row] += weight);
    (0..3).for_each(|channel| moments[channel][channel] += weight);
    // Of pictures in 0..1, only those with numbers that are not finite have no solution.
    let map = moments.map(|moment| solve(gram, moment).unwrap_or([f64::NAN; 4]));
    let mapped = pixels.iter().flat_map(|pixel| {
        let x = [f64::from(pixel[0]), f64::from(pixel[1]), f64::from(pixel[2]), 1.0];
        [0, 1, 2].map(|channel| (0..4).map(|row| x[row] * map[channel][row]).sum::<f64>() as f32)
    });
    mapped.collect()
}

#[cfg(test)]
mod tests;
