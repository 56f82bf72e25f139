//! Tests that both passes see the same alphas, bit by bit.

use super::kernel_tests::ALL;
use super::launch::{launch_rasterize, launch_rasterize_backward};
use super::{Layers, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::gpu::Buffer;
use crate::intersect::launch::launch_intersect;
use crate::intersect::{Cut, TILE_SIZE};
use crate::options::{Accumulation, RenderOptions};
use crate::testing::gpu::gpu;
use crate::testing::random::Random;

/// Tiles along each side of the picture, one Gaussian each.
const TILES: usize = 32;
const SIZE: usize = TILES * TILE_SIZE;

#[test]
fn both_passes_see_the_same_bits_of_alpha() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random::new(41);
    let mut projected = Vec::new();
    for tile in 0..TILES * TILES {
        let mut near = |tile: usize| (tile * TILE_SIZE) as f64 + random.between(6.0, 10.0);
        let mean = [near(tile % TILES), near(tile / TILES)];
        let [sigma_u, sigma_v] = [(); 2].map(|()| random.between(0.6, 1.2));
        let (shear, opacity) = (random.between(-0.8, 0.8), random.between(0.3, 1.0));
        projected.extend([mean[0], mean[1], sigma_u, shear, sigma_v, 1.0, opacity].map(|v| v as f32));
    }
    let options = RenderOptions::standard().with_accumulation(Accumulation::Ordered);
    let in_f64 = |column: usize, row: usize| {
        let tile = row / TILE_SIZE * TILES + column / TILE_SIZE;
        let ellipse: [f64; 7] = std::array::from_fn(|i| projected[7 * tile + i].into());
        let [x, y, sigma_u, shear, sigma_v, _, opacity] = ellipse;
        let (dx, dy) = (column as f64 + 0.5 - x, row as f64 + 0.5 - y);
        let (u, v) = (dx / sigma_u, (dy - shear * dx) / sigma_v);
        let alpha = (opacity * (-0.5 * (u * u + v * v)).exp()).min(options.alpha_max);
        if alpha >= options.alpha_min { alpha } else { 0.0 }
    };
    let spec = RasterizeSpec { intrinsics: Intrinsics::centred(SIZE, SIZE, 500.0), options };
    for channels in [1, 5] {
        let inputs = Layers {
            projected: Buffer::from_slice(&gpu, &projected),
            features: Buffer::from_slice(&gpu, &vec![1.0; TILES * TILES * channels]),
            background: Buffer::from_slice(&gpu, &vec![0.0; channels]),
            mean2d_abs: Buffer::new(&gpu, 0),
            ray_space: Buffer::new(&gpu, 0),
        };
        let lists = launch_intersect(&gpu, &inputs.projected, &spec.intrinsics, Cut::of(&options));
        let (planes, trace) = launch_rasterize(&gpu, &inputs, &lists, &spec, true);
        let (planes, trace) = (planes.read(&gpu), trace.expect("asked for"));
        let mut shown = 0;
        for (i, &alpha) in planes[..SIZE * SIZE].iter().enumerate() {
            let expected = in_f64(i % SIZE, i / SIZE);
            let error = (f64::from(alpha) - expected).abs();
            // Near the cut a pair may or may not show.
            let cut = (expected - options.alpha_min).abs() < 1e-5 * options.alpha_min;
            assert!(cut || error <= 2e-6, "pixel {i}: {alpha:e} instead of {expected:e}");
            shown += usize::from(alpha > 0.0);
        }
        assert!(shown > 20 * TILES * TILES, "{shown} pixels prove little");
        // A gradient at one pixel of each tile makes the gradient of a Gaussian's feature that pixel's alpha.
        for pixel in [[7, 7], [8, 9], [5, 8], [9, 6], [10, 10], [8, 4]] {
            let at = |tile: usize| (tile / TILES * TILE_SIZE + pixel[1]) * SIZE + tile % TILES * TILE_SIZE + pixel[0];
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
