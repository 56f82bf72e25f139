//! Box downsampling of photographs.

use splat_op::Intrinsics;

use super::Photo;

impl Photo {
    /// The photograph of a sensor whose pixels are `n` × `n` times as large, with its camera to match. Each pixel is the
    /// mean of `n` × `n` pixels; incomplete blocks at the right and lower borders are dropped. It is the ground truth for a scene
    /// viewed from `n` times as far away, the field's test of anti-aliasing (Barron et al. 2021, Yu et al. 2024). A
    /// pixel counts if all pixels that it covers count. None if the photograph is smaller than one such pixel.
    pub fn box_filtered(&self, n: usize) -> Option<Self> {
        let [width, height] = [self.intrinsics.width / n.max(1), self.intrinsics.height / n.max(1)];
        if width == 0 || height == 0 {
            return None;
        }
        let full = self.intrinsics.width;
        let covered = |i: usize| {
            let (x, y) = (i % width * n, i / width * n);
            (0..n * n).map(move |k| (y + k / n) * full + x + k % n)
        };
        let alpha_of = |at: usize| self.alpha.as_ref().map_or(255, |alpha| u32::from(alpha[at]));
        let (mut rgb, mut alpha) = (Vec::with_capacity(3 * width * height), Vec::new());
        for i in 0..width * height {
            let weight: u32 = covered(i).map(alpha_of).sum();
            for channel in 0..3 {
                // Transparent pixels have no colour.
                let sum: u32 = covered(i).map(|at| alpha_of(at) * u32::from(self.rgb[3 * at + channel])).sum();
                rgb.push(((sum + weight / 2) / weight.max(1)) as u8);
            }
            let count = (n * n) as u32;
            alpha.push(((weight + count / 2) / count) as u8);
        }
        let Intrinsics { model, fx, fy, cx, cy, distortion, .. } = self.intrinsics;
        let by = 1.0 / n as f64;
        let intrinsics = Intrinsics::pinhole(width, height, [fx * by, fy * by], [cx * by, cy * by]);
        let intrinsics = intrinsics.with_lens(model, distortion);
        let mask = self.mask.as_ref().map(|mask| (0..width * height).map(|i| covered(i).all(|at| mask[at])).collect());
        Some(Self {
            name: self.name.clone(),
            intrinsics,
            cam_from_world: self.cam_from_world,
            rgb,
            alpha: self.alpha.as_ref().map(|_| alpha),
            mask,
        })
    }
}

#[cfg(test)]
mod tests;
