//! What is seen behind each bucket, for three channels on a driver in software: as `blend_behind_kernel` of `backward.rs`, by
//! units of four pixels side by side (`quads.rs`), and the gradient of the planes put in order for the layers.

use cubecl::prelude::*;

use super::backward::plane_of;
use super::layer::{Shape, first_slot};
use super::quads::{QUAD, Quad, ROW_QUADS, TILE_QUADS, across};
use crate::tile::TILE;
use crate::tile::forward::Frame;

/// Writes `ρ` behind each bucket, `[slot][quad]`; the gradient of the planes, zero outside the picture,
/// `[tile][channel, then alpha if it has one][quad]`; and the tile's share of the background's gradient, `[tile][feature]`. A cube per tile.
#[cube(launch_unchecked)]
pub(super) fn blend_behind_quads_kernel(
    background: &[f32],
    grad: &[f32],
    tile_start: &[u32],
    kept: &[Quad],
    behind: &[Quad],
    passed: &[u32],
    rho_behind: &mut [Quad],
    grad_by_tile: &mut [Quad],
    grad_background: &mut [f32],
    frame: Frame,
    #[comptime] shape: Shape,
    #[comptime] with_background: bool,
) {
    let channels = comptime!(shape.channels());
    let numbers = comptime!(shape.kept());
    let tile = CUBE_POS as u32;
    let quad = UNIT_POS;
    let mut shared = Shared::<[f32]>::new_slice(TILE_QUADS);
    if tile < frame.tiles_x * frame.tiles_y {
        let column =
            tile % frame.tiles_x * comptime!(TILE as u32) + quad % comptime!(ROW_QUADS as u32) * comptime!(QUAD as u32);
        let row = tile / frame.tiles_x * comptime!(TILE as u32) + quad / comptime!(ROW_QUADS as u32);
        let plane = (frame.width * frame.height) as usize;
        let pixel = (row * frame.width + column) as usize;
        let slot = first_slot(tile_start[tile as usize], tile, shape);
        let at = tile as usize * comptime!(shape.gradients() * TILE_QUADS) + quad as usize;

        let mut own = Array::<Quad>::new(comptime!(shape.gradients()));
        #[unroll]
        for number in 0..comptime!(shape.gradients()) {
            let from = if comptime!(number < channels) {
                plane_of(number, shape)
            } else {
                comptime!(shape.features).runtime()
            };
            let mut found = Quad::new(0.0);
            #[unroll]
            for k in 0..QUAD {
                if column + comptime!(k as u32) < frame.width && row < frame.height {
                    found.insert(k, grad[from * plane + pixel + k]);
                }
            }
            own[number] = found;
            grad_by_tile[at + comptime!(number * TILE_QUADS)] = found;
        }
        let mut rho = Quad::new(0.0);
        #[unroll]
        for channel in 0..comptime!(shape.features) {
            rho += own[channel] * Quad::new(background[channel]);
        }
        if comptime!(with_background) {
            let last = behind[tile as usize * TILE_QUADS + quad as usize];
            #[unroll]
            for channel in 0..comptime!(shape.features) {
                shared[quad as usize] = across(own[channel] * last);
                sync_cube();
                if quad == 0 {
                    let mut sum = 0.0f32;
                    for i in 0..comptime!(TILE_QUADS as u32) {
                        sum += shared[i as usize];
                    }
                    grad_background[tile as usize * comptime!(shape.features) + channel] = sum;
                }
                sync_cube();
            }
        }

        let buckets = passed[tile as usize];
        for step in 0..buckets {
            let place = (slot + buckets - 1 - step) as usize;
            let at = place * comptime!(numbers * TILE_QUADS) + quad as usize;
            rho_behind[place * TILE_QUADS + quad as usize] = rho;
            let through = kept[at + TILE_QUADS];
            // Alpha is one more channel, of colour one: its sum is what the bucket does not let through.
            let mut seen = Quad::new(0.0);
            if comptime!(shape.grad_alpha) {
                seen = own[channels] * (Quad::new(1.0) - through);
            }
            #[unroll]
            for channel in 0..channels {
                seen += own[channel] * kept[at + comptime!((channel + 2) * TILE_QUADS)];
            }
            let open = kept[at].greater_equal(&Quad::new(0.0));
            rho = select_many(open, seen + through * rho, rho);
        }
    }
}
