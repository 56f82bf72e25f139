use super::*;
use crate::camera::Intrinsics;
use crate::intersect::{TILE_PIXELS, TILE_SIZE};
use crate::options::RenderOptions;
use crate::rasterize::RasterizeSpec;
use crate::rasterize::pixels::{SIMD_BLOCK, SIMD_BLOCK_ROW, TileView};
use crate::rasterize::testing::any_ellipse;
use crate::simd::dispatch;
use crate::testing::random::Random;

/// Returns the pixels of a tile in which an ellipse may show.
fn near<S: Simd, F: Real>(simd: S, footprint: &EllipseFootprint<F>, pixels: &TilePixels<F>, top: F) -> Vec<bool> {
    let splat = footprint.lanes(simd, top);
    let vectors = (0..TILE_PIXELS).step_by(len::<S, F>());
    let bits = vectors.map(|place| splat.at(&splat.column(pixels.x(simd, place % SIMD_BLOCK_ROW)), pixels, place).near);
    bits.flat_map(|near| (0..len::<S, F>()).map(move |lane| near.to_bitmask() >> lane & 1 == 1)).collect()
}

/// For random ellipses, returns the numbers of pixels that one may show in, of those in a block that it does not meet, of blocks with such
/// pixels, and of blocks met.
fn counts<F: Real>(random: &mut Random, options: RenderOptions, ordinary: bool, opacity: [f64; 2]) -> [usize; 4] {
    const SIZE: usize = 4096;
    let spec = RasterizeSpec { intrinsics: Intrinsics::centred(SIZE, SIZE, 1000.0), options };
    let mut counts = [0; 4];
    for i in 0..5_000 {
        let tile = i * 7919 % (SIZE / TILE_SIZE).pow(2);
        let origin = [tile % (SIZE / TILE_SIZE), tile / (SIZE / TILE_SIZE)].map(|tile| tile * TILE_SIZE);
        let row = any_ellipse(random, origin.map(|px| px as f64), ordinary, opacity).to_row().map(F::of);
        let inputs = Layers { projected: &row[..], features: &[], background: &[], mean2d_abs: &[], ray_space: &[] };
        let footprint = EllipseFootprint::read(&inputs, 0, &FootprintView { spec: &spec, lens: None, boxes: &[] });
        let size = [TILE_SIZE; 2];
        let view = TileView::<F, EllipseFootprint<F>> {
            origin,
            size,
            gaussians: &[],
            slopes: None,
            footprints: &[],
            colours: &[],
            channels: 0,
            depth: false,
            finite: true,
        };
        let (pixels, corner) = (TilePixels::new(&view), view.corner());
        let met = dispatch!(F, simd => footprint.met(simd, &TileBlocks::new(corner)));
        let near = dispatch!(F, simd => near(simd, &footprint, &pixels, corner[1]));
        for (block, near) in near.chunks(SIMD_BLOCK).enumerate() {
            let (seen, met) = (near.iter().filter(|near| **near).count(), met >> block & 1 == 1);
            counts[0] += seen;
            counts[1] += if met { 0 } else { seen };
            counts[2] += usize::from(seen > 0);
            counts[3] += usize::from(met);
        }
    }
    counts
}

#[test]
fn no_pixel_in_which_an_ellipse_may_show_is_left_out() {
    let mut random = Random::new(31);
    for alpha_min in [1.0 / 255.0, 0.5, 1.0 / 67_108_864.0, 0.0] {
        let options = RenderOptions { alpha_min, ..RenderOptions::standard() };
        for (ordinary, opacity) in [(true, [0.004, 1.0]), (false, [0.004, 1.0]), (false, [0.5, 1e6])] {
            let opacity = opacity.map(|opacity: f64| opacity.max(alpha_min));
            let in_f32 = counts::<f32>(&mut random, options, ordinary, opacity);
            for [seen, lost, needed, met] in [in_f32, counts::<f64>(&mut random, options, ordinary, opacity)] {
                let what = format!("alpha_min {alpha_min}, ordinary {ordinary}, {opacity:?}");
                println!("{what}: {seen} pixels, {needed} blocks needed, {met} met");
                assert!(seen > 2_500, "{what}: {seen} pixels prove nothing");
                assert_eq!(lost, 0, "{what}: {lost} of {seen}");
                // Thin ellipses may pass between the centres of a block's pixels.
                assert!(!ordinary || met as f64 <= 1.2 * needed as f64, "{what}: {met} blocks met, {needed} needed");
            }
        }
    }
}
