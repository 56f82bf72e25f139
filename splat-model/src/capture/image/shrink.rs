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
        let camera = &self.intrinsics;
        let by = 1.0 / n as f64;
        let intrinsics = Intrinsics {
            width,
            height,
            fx: camera.fx * by,
            fy: camera.fy * by,
            cx: camera.cx * by,
            cy: camera.cy * by,
            ..*camera
        };
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
mod tests {
    use glam::{DAffine3, DVec2, DVec3};

    use super::*;

    fn photo(alpha: Option<Vec<u8>>) -> Photo {
        let (width, height) = (5, 4);
        Photo {
            name: "five by four".into(),
            intrinsics: Intrinsics { cx: 2.25, ..Intrinsics::centred(width, height, 6.0) },
            cam_from_world: DAffine3::IDENTITY,
            rgb: (0..60).collect(),
            alpha,
            mask: Some((0..20).map(|i| i != 6).collect()),
        }
    }

    #[test]
    fn pixels_are_means_and_the_camera_looks_the_same_way() {
        let small = photo(None).box_filtered(2).unwrap();
        assert_eq!((small.intrinsics.width, small.intrinsics.height), (2, 2));
        // Red of the first: pixels 0, 1, 5 and 6.
        assert_eq!(small.rgb[0], (3 + 15 + 18) / 4);
        assert_eq!(small.rgb[3 * 3 + 2], ((12 + 13 + 17 + 18) * 3 / 4 + 2) as u8);
        assert_eq!(small.mask.as_deref(), Some(&[false, true, true, true][..]));
        let point = DVec3::new(0.3, -0.2, 1.5);
        let (full, half) =
            (photo(None).intrinsics.px_from_cam(point).unwrap(), small.intrinsics.px_from_cam(point).unwrap());
        assert!((full / 2.0).abs_diff_eq(half, 1e-12) && full != DVec2::ZERO);
        assert!(photo(None).box_filtered(5).is_none());
    }

    #[test]
    fn transparent_pixels_give_no_colour() {
        let mut alpha = vec![255; 20];
        (alpha[0], alpha[1], alpha[5]) = (0, 0, 0);
        let small = photo(Some(alpha)).box_filtered(2).unwrap();
        assert_eq!(&small.rgb[..3], &[18, 19, 20]);
        assert_eq!(small.alpha.unwrap()[..2], [64, 255]);
    }
}
