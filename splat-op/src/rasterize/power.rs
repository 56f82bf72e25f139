//! `2^−q` by a polynomial, for kernels that do not use the device's `exp`; see [`crate::Exponential`].

use cubecl::prelude::*;

/// Coefficients of `eᵗ`, from `t⁷` down. For `|t| <= (ln 2)/2` the truncation of Taylor's series costs at most a tenth
/// of an ulp.
const SERIES: [f32; 8] = [1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];

/// The largest `q`: beyond it `2^−q` is subnormal, and many devices do not support subnormal numbers.
const LARGEST: f32 = 126.0;

/// `2^−q` for `q >= 0`, within 2 ulp; zero above 126.
#[cube]
pub(super) fn power(q: f32) -> f32 {
    let held = min(q, LARGEST);
    // q = n + s with an integer n and |s| <= 1/2; the difference is exact.
    let n = (held + 0.5).floor();
    let t = (n - held) * core::f32::consts::LN_2;
    let mut sum = f32::new(SERIES[0]);
    #[unroll]
    for i in 1..8usize {
        sum = fma(sum, t, f32::new(SERIES[i]));
    }
    let scale = f32::reinterpret((127u32 - u32::cast_from(n)) << 23);
    select(q <= LARGEST, sum * scale, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{Buffer, elementwise};
    use crate::testing::gpu::gpus;

    #[cube(launch_unchecked)]
    fn powers_kernel(from: &[f32], to: &mut [f32], count: u32) {
        if ABSOLUTE_POS < count as usize {
            to[ABSOLUTE_POS] = power(from[ABSOLUTE_POS]);
        }
    }

    #[test]
    fn a_power_stays_within_two_ulp() {
        let from: Vec<f32> =
            (0..=400_000).map(|i| (f64::from(i) * (126.0 / 400_000.0)) as f32).chain([127.0, 1e30, f32::MAX]).collect();
        for (form, gpu) in gpus() {
            let (given, found) = (Buffer::from_slice(&gpu, &from), Buffer::<f32>::new(&gpu, from.len()));
            let (grid, dim) = elementwise(from.len());
            // SAFETY: every access is guarded by the length.
            unsafe {
                powers_kernel::launch_unchecked(&gpu.client, grid, dim, given.arg(), found.arg(), from.len() as u32);
            }
            let found = found.read(&gpu);
            let mut worst = 0.0_f64;
            for (q, found) in from.iter().zip(&found).filter(|(q, _)| **q <= LARGEST) {
                let expected = (-f64::from(*q)).exp2();
                worst = worst.max((f64::from(*found) - expected).abs() / (expected * f64::from(f32::EPSILON)));
            }
            assert!(worst <= 2.0, "{form}: {worst} ulp");
            assert_eq!((found[0], found[400_000]), (1.0, f32::MIN_POSITIVE), "{form}");
            assert_eq!(found[400_001..], [0.0; 3], "{form}");
        }
    }
}
