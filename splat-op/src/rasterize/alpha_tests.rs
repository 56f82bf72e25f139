//! Tests that both passes see the same alphas, bit by bit, and that these are the values of a fixed sequence of operations.

use cubecl::prelude::*;

use super::kernel_tests::ALL;
use super::launch::{launch_rasterize, launch_rasterize_backward};
use super::{Layers, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::dials::Exponential;
use crate::gpu::{Buffer, Gpu};
use crate::intersect::launch::launch_intersect;
use crate::intersect::{Cut, TILE};
use crate::options::{Accumulation, RenderOptions};
use crate::testing::gpu::gpu;
use crate::testing::random::Random;

/// Tiles along each side of the picture, one Gaussian each.
const TILES: usize = 32;
const SIZE: usize = TILES * TILE;

/// Writes `1 / x` of each value, and in the last element a sum of products that shows whether `fma` rounds once.
#[cube(launch_unchecked)]
fn device_kernel(values: &[f32], inverse: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        inverse[ABSOLUTE_POS] = 1.0 / values[ABSOLUTE_POS];
    }
    if ABSOLUTE_POS == count as usize {
        inverse[count as usize] = fma(values[count as usize], values[count as usize], -1.0f32);
    }
}

/// Returns the inverses as the device computes them, and whether its `fma` rounds once.
fn device_arithmetic(gpu: &Gpu, values: &[f32]) -> (Vec<f32>, bool) {
    // The square of 1 − 2⁻¹³ is 1 − 2⁻¹² + 2⁻²⁶.
    let probe = 1.0 - 1.0 / 8192.0_f32;
    let values: Vec<f32> = values.iter().copied().chain([probe]).collect();
    let (given, found) = (Buffer::from_slice(gpu, &values), Buffer::<f32>::new(gpu, values.len()));
    let (grid, dim) = crate::gpu::elementwise(values.len());
    // SAFETY: every access is guarded by the length.
    unsafe {
        device_kernel::launch_unchecked(&gpu.client, grid, dim, given.arg(), found.arg(), values.len() as u32 - 1);
    }
    let mut found = found.read(gpu);
    let square = found.pop().expect("the probe");
    (found, square == probe.mul_add(probe, -1.0))
}

/// `2^−q` as the kernels' polynomial.
fn power(q: f32, fma: impl Fn(f32, f32, f32) -> f32) -> f32 {
    let n = (q + 0.5).floor();
    let t = (n - q) * core::f32::consts::LN_2;
    let series = [5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0].map(|factorial: f64| (1.0 / factorial) as f32);
    let sum = series.into_iter().reduce(|sum, term| fma(sum, t, term)).expect("eight terms");
    sum * f32::from_bits((127 - n as u32) << 23)
}

#[test]
fn both_passes_and_the_host_see_the_same_bits_of_alpha() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random::new(41);
    let mut projected = Vec::new();
    for tile in 0..TILES * TILES {
        let mut near = |tile: usize| (tile * TILE) as f64 + random.between(6.0, 10.0);
        let mean = [near(tile % TILES), near(tile / TILES)];
        let [sigma_u, sigma_v] = [(); 2].map(|()| random.between(0.6, 1.2));
        let (shear, opacity) = (random.between(-0.8, 0.8), random.between(0.3, 1.0));
        projected.extend([mean[0], mean[1], sigma_u, shear, sigma_v, 1.0, opacity].map(|v| v as f32));
    }
    let sigmas: Vec<f32> = projected.chunks_exact(7).flat_map(|row| [row[2], row[4]]).collect();
    let (inverse, fused) = device_arithmetic(&gpu, &sigmas);
    let fma = |a: f32, b: f32, c: f32| if fused { a.mul_add(b, c) } else { a * b + c };
    let options =
        RenderOptions::standard().with_exponential(Exponential::Polynomial).with_accumulation(Accumulation::Ordered);
    let on_host = |column: usize, row: usize| {
        let tile = row / TILE * TILES + column / TILE;
        let [x, y, _, shear, _, _, opacity] = projected[7 * tile..7 * tile + 7] else { unreachable!() };
        let dx = column as f32 + 0.5 - x;
        let rise = (row / TILE * TILE) as f32 + 0.5 - y;
        let u = dx * inverse[2 * tile];
        let v = (fma(-shear, dx, rise) + (row % TILE) as f32) * inverse[2 * tile + 1];
        let square = fma(u, u, v * v);
        if square > 80.0 {
            return 0.0;
        }
        let alpha = (opacity * power(square * (0.5 * core::f32::consts::LOG2_E), fma)).min(options.alpha_max as f32);
        if alpha >= options.alpha_min as f32 { alpha } else { 0.0 }
    };
    let spec = RasterizeSpec { intrinsics: Intrinsics::centred(SIZE, SIZE, 500.0), options };
    for channels in [1, 5] {
        let inputs = Layers {
            projected: Buffer::from_slice(&gpu, &projected),
            features: Buffer::from_slice(&gpu, &vec![1.0; TILES * TILES * channels]),
            background: Buffer::from_slice(&gpu, &vec![0.0; channels]),
            mean2d_abs: Buffer::new(&gpu, 0),
        };
        let lists = launch_intersect(&gpu, &inputs.projected, &spec.intrinsics, Cut::of(&options));
        let (planes, trace) = launch_rasterize(&gpu, &inputs, &lists, &spec, true);
        let (planes, trace) = (planes.read(&gpu), trace.expect("asked for"));
        let mut shown = 0;
        for (i, alpha) in planes[..SIZE * SIZE].iter().enumerate() {
            let expected = on_host(i % SIZE, i / SIZE);
            assert_eq!(alpha.to_bits(), expected.to_bits(), "pixel {i}: {alpha:e}, on the host {expected:e}");
            shown += usize::from(*alpha > 0.0);
        }
        assert!(shown > 20 * TILES * TILES, "{shown} pixels prove little");
        // A gradient at one pixel of each tile makes the gradient of a Gaussian's feature that pixel's alpha.
        for pixel in [[7, 7], [8, 9], [5, 8], [9, 6], [10, 10], [8, 4]] {
            let at = |tile: usize| (tile / TILES * TILE + pixel[1]) * SIZE + tile % TILES * TILE + pixel[0];
            let mut grad = vec![0.0; channels * SIZE * SIZE];
            (0..TILES * TILES).for_each(|tile| grad[at(tile)] = 1.0);
            let grad = Buffer::from_slice(&gpu, &grad);
            let found = launch_rasterize_backward(&gpu, &inputs, &grad, &lists, &trace, &spec, ALL);
            let found = found.features.expect("asked for").read(&gpu);
            for tile in 0..TILES * TILES {
                let (found, forward) = (found[tile * channels], planes[at(tile)]);
                assert_eq!(found.to_bits(), forward.to_bits(), "tile {tile}, {channels} channels: {found} {forward}");
            }
        }
    }
}
