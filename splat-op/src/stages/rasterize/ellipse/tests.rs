use super::super::blocks::BLOCK_PIXELS;
use super::super::layer::{RasterFrame, SplatInputs, SplatInputsLaunch, TilePixel, tile_origin};
use super::super::splat::Splat;
use super::*;
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, cubes};
use crate::intersect::launch::launch_intersect;
use crate::intersect::{Cut, TILE_PIXELS};
use crate::options::RenderOptions;
use crate::project::COLUMNS;
use crate::rasterize::RasterizeSpec;
use crate::rasterize::launch::frame;
use crate::rasterize::testing::any_ellipse;
use crate::testing::gpu::gpu;
use crate::testing::random::Random;
use cubecl::prelude::CubeDim;

/// For each ellipse, at the tile of its number, writes whether each pixel sees an alpha and whether its block is met.
#[cube(launch_unchecked)]
fn pixels_kernel(inputs: SplatInputs, tiles: &[u32], sees: &mut [u32], frame: RasterFrame, count: u32) {
    if CUBE_POS < count as usize {
        let tile = tiles[CUBE_POS];
        let pixel = TilePixel::of(tile_origin(tile, &frame), pixel_of(UNIT_POS), &inputs, &frame);
        let left = f32::cast_from(tile % frame.tiles_x * comptime!(TILE_SIZE as u32)) + 0.5;
        let ellipse = LayerEllipse::of(&inputs, CUBE_POS, pixel.top, &frame);
        let block = UNIT_POS / comptime!(BLOCK_PIXELS as u32);
        let half = block / comptime!(HALF_BLOCKS as u32);
        let met = (blocks_met(&ellipse, left, half, &frame) >> (block % comptime!(HALF_BLOCKS as u32))) & 1;
        let alpha = ellipse.alpha(pixel.x, pixel.row, &frame);
        sees[CUBE_POS * comptime!(TILE_PIXELS) + UNIT_POS as usize] = met * 2 + select(alpha > 0.0, 1u32, 0u32);
    }
}

const SIZE: usize = 4096;

/// Returns the numbers of pixels that see an alpha, of those whose block is not met, of blocks with such pixels and of
/// blocks met.
fn counts(random: &mut Random, options: RenderOptions, ordinary: bool, opacity: [f64; 2]) -> Option<[usize; 4]> {
    const COUNT: usize = 5_000;
    let gpu = gpu()?;
    let across = SIZE / TILE_SIZE;
    let tiles: Vec<u32> = (0..COUNT).map(|i| (i * 7919 % (across * across)) as u32).collect();
    let rows = tiles.iter().flat_map(|&tile| {
        let corner = [tile as usize % across, tile as usize / across].map(|tile| (tile * TILE_SIZE) as f64);
        any_ellipse(random, corner, ordinary, opacity).to_row()
    });
    let rows: Vec<f32> = rows.map(|v| v as f32).collect();
    assert_eq!(rows.len(), COUNT * COLUMNS);
    let spec = RasterizeSpec { intrinsics: Intrinsics::centred(SIZE, SIZE, 1000.0), options };
    let sees = Buffer::<u32>::new(&gpu, COUNT * TILE_PIXELS);
    // SAFETY: every access is guarded by the count.
    unsafe {
        pixels_kernel::launch_unchecked(
            &gpu.client,
            cubes(COUNT),
            CubeDim::new_1d(TILE_PIXELS as u32),
            SplatInputsLaunch::new(
                Buffer::from_slice(&gpu, &rows).arg(),
                Buffer::<f32>::new(&gpu, 0).arg(),
                None.into(),
                None.into(),
                launch_intersect(&gpu, &Buffer::new(&gpu, 0), &spec.intrinsics, Cut::of(&options)).arg(),
            ),
            Buffer::from_slice(&gpu, &tiles).arg(),
            sees.arg(),
            frame(&spec),
            COUNT as u32,
        );
    }
    let sees = sees.read(&gpu);
    let blocks = || sees.chunks_exact(BLOCK_PIXELS);
    assert!(blocks().all(|block| block.iter().all(|pixel| pixel / 2 == block[0] / 2)), "one answer a block");
    Some([
        sees.iter().filter(|pixel| *pixel % 2 == 1).count(),
        sees.iter().filter(|pixel| **pixel == 1).count(),
        blocks().filter(|block| block.iter().any(|pixel| pixel % 2 == 1)).count(),
        blocks().filter(|block| block[0] / 2 == 1).count(),
    ])
}

#[test]
fn no_pixel_that_sees_an_alpha_is_left_out() {
    let mut random = Random::new(31);
    for alpha_min in [1.0 / 255.0, 0.5, 1.0 / 67_108_864.0, 0.0] {
        let options = RenderOptions { alpha_min, ..RenderOptions::standard() };
        for (ordinary, opacity) in [(true, [0.004, 1.0]), (false, [0.004, 1.0]), (false, [0.5, 1e6])] {
            let opacity = opacity.map(|opacity: f64| opacity.max(alpha_min));
            let Some([seen, lost, needed, met]) = counts(&mut random, options, ordinary, opacity) else {
                return;
            };
            let what = format!("alpha_min {alpha_min}, ordinary {ordinary}, {opacity:?}");
            println!("{what}: {seen} pixels see an alpha, {needed} blocks needed, {met} met");
            assert!(seen > 2_500, "{what}: {seen} pixels prove nothing");
            assert_eq!(lost, 0, "{what}: {lost} of {seen}");
            // Thin ellipses may pass between the centres of a block's pixels.
            assert!(!ordinary || met as f64 <= 1.2 * needed as f64, "{what}: {met} blocks met, {needed} needed");
        }
    }
}
