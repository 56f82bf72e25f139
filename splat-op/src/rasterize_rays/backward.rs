//! Backward kernels of `rasterize_rays`. No float is accumulated by two units, so every run gives the same bits.
//!
//! 1. *Walk*: a cube per tile, a unit per pixel. A unit goes front to back as in the forward pass and stores, at each layer, the
//!    transmittance before it and a link to the previous layer. It then follows these links back and replaces them by
//!    `h = α ∂L/∂α` and by the weight `α T`. Both numbers lie in a table `[places, 256, 2]` of all layers and pixels of a run of
//!    tiles; many tiles take several launches, so that the table does not grow with the picture.
//! 2. *Sums*: a unit per place of these tiles computes a row, the sums over the tile's pixels.
//! 3. *Gather*: a unit per Gaussian adds its rows in the order of its intersections and turns them into gradients.

use cubecl::prelude::*;

use super::SUMS;
use super::layer::{CHUNK, RayFrame, RayGaussian, RayPixel, Walk};
use crate::depth_slope::DEPTH_SLOPE;
use crate::gpu::UNITS;
use crate::gpu::reduce::cube_sum;
use crate::intersect::TILE_PIXELS;
use crate::project::COLUMNS;

/// Number of columns of a row: the sums, one per channel, and two for the absolute gradient.
pub(super) const fn row_len(channels: usize, absolute: bool) -> usize {
    SUMS + channels + if absolute { 2 } else { 0 }
}

/// Fills the table with bits of floats, and `left`, `[H W]`, with the transmittances behind all layers.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_walk_kernel(
    projected: &[f32],
    depth_slopes: &[f32],
    features: &[f32],
    background: &[f32],
    grad: &[f32],
    tile_start: &[u32],
    intersection_of_place: &[u32],
    gaussian_of_intersection: &[u32],
    table: &mut [u32],
    left: &mut [f32],
    view: RayFrame,
) {
    let tile = view.first_tile + CUBE_POS as u32;
    if tile < view.end_tile {
        let unit = UNIT_POS % comptime!(TILE_PIXELS as u32);
        let pixel = RayPixel::of(tile, unit, &view);
        let plane = (view.width * view.height) as usize;
        let channels = view.features as usize;
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        // Index of this unit's two numbers at the tile's first place.
        let own =
            (first - tile_start[view.first_tile as usize]) as usize * comptime!(2 * TILE_PIXELS) + 2 * unit as usize;
        for place in 0..places {
            let at = own + place as usize * comptime!(2 * TILE_PIXELS);
            table[at] = 0u32;
            table[at + 1] = 0u32;
        }
        if pixel.inside {
            let mut transmittance = 1.0f32;
            // The place of the last layer plus one; zero for no layer.
            let mut link = 0u32;
            let mut walk = Walk::new();
            let mut open = true;
            while open {
                let count = walk.advance(
                    projected,
                    depth_slopes,
                    intersection_of_place,
                    gaussian_of_intersection,
                    first,
                    places,
                    &pixel,
                    &view,
                );
                for i in 0..count {
                    if open {
                        let alpha = walk.alphas[i as usize];
                        let behind = fma(-alpha, transmittance, transmittance);
                        open = behind > view.transmittance_min;
                        if open {
                            let place = walk.places[i as usize];
                            let at = own + place as usize * comptime!(2 * TILE_PIXELS);
                            table[at] = u32::reinterpret(transmittance);
                            table[at + 1] = link;
                            link = place + 1;
                            transmittance = behind;
                        }
                    }
                }
                open = open && count == comptime!(CHUNK as u32);
            }
            left[pixel.index] = transmittance;

            // Contribution of everything behind the layer, as the gradient weighs it: g·R.
            let mut behind = 0.0f32;
            for channel in 0..channels {
                behind += grad[channel * plane + pixel.index] * background[channel];
            }
            let grad_alpha = grad[channels * plane + pixel.index];
            let mut grad_depth = 0.0f32;
            if comptime!(view.depth) {
                grad_depth = grad[(channels + 1) * plane + pixel.index];
            }
            while link > 0 {
                let place = link - 1;
                let at = own + place as usize * comptime!(2 * TILE_PIXELS);
                let before = f32::reinterpret(table[at]);
                link = table[at + 1];
                let gaussian =
                    gaussian_of_intersection[intersection_of_place[(first + place) as usize] as usize] as usize;
                let footprint = RayGaussian::load(projected, depth_slopes, gaussian);
                let layer = footprint.at(pixel.x, pixel.y, &view);
                // Alpha acts as one more channel of colour one.
                let mut here = grad_alpha + grad_depth * footprint.depth_of(&layer, &view);
                for channel in 0..channels {
                    here += grad[channel * plane + pixel.index] * features[gaussian * channels + channel];
                }
                let h = select(layer.free, layer.alpha * before * (here - behind), 0.0);
                behind = layer.alpha * here + (1.0 - layer.alpha) * behind;
                table[at] = u32::reinterpret(h);
                table[at + 1] = u32::reinterpret(layer.alpha * before);
            }
        }
    }
}

/// Returns the tile whose list holds `place`: the last tile whose list begins at or before it.
#[cube]
fn tile_of_place(tile_start: &[u32], view: &RayFrame, place: u32) -> u32 {
    let mut low = view.first_tile;
    let mut high = view.end_tile;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if tile_start[middle as usize] <= place {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Writes the rows `[H, row]` of the intersections of a run of tiles.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_sums_kernel(
    projected: &[f32],
    depth_slopes: &[f32],
    grad: &[f32],
    tile_start: &[u32],
    intersection_of_place: &[u32],
    gaussian_of_intersection: &[u32],
    table: &[u32],
    rows: &mut [f32],
    view: RayFrame,
    #[comptime] absolute: bool,
) {
    let start = tile_start[view.first_tile as usize];
    let place = start + ABSOLUTE_POS as u32;
    if place < tile_start[view.end_tile as usize] {
        let tile = tile_of_place(tile_start, &view, place);
        let intersection = intersection_of_place[place as usize];
        let footprint =
            RayGaussian::load(projected, depth_slopes, gaussian_of_intersection[intersection as usize] as usize);
        let plane = (view.width * view.height) as usize;
        let channels = view.features as usize;
        let own = ABSOLUTE_POS * comptime!(2 * TILE_PIXELS);
        let mut sums = Array::<f32>::new(comptime!(SUMS));
        #[unroll]
        for column in 0..comptime!(SUMS) {
            sums[column] = 0.0f32;
        }
        let mut absolute_x = 0.0f32;
        let mut absolute_y = 0.0f32;
        for unit in 0..comptime!(TILE_PIXELS as u32) {
            let weight = f32::reinterpret(table[own + 2 * unit as usize + 1]);
            if weight > 0.0 {
                let pixel = RayPixel::of(tile, unit, &view);
                let layer = footprint.at(pixel.x, pixel.y, &view);
                let (u, v) = (layer.u, layer.v);
                let h = f32::reinterpret(table[own + 2 * unit as usize]);
                let mut seen = 0.0f32;
                if comptime!(view.depth) {
                    seen = weight * grad[(channels + 1) * plane + pixel.index];
                }
                let mut p = -(h * u);
                let mut q = -(h * v);
                if comptime!(view.exact) {
                    let (exponent, lambda, phi) = (layer.exponent, layer.lambda, layer.phi);
                    let of_lambda = seen * footprint.depth;
                    let kappa = 2.0 * exponent * phi - lambda * lambda;
                    // Gradients of E and λ along (u, v), and along the depth slope.
                    let radial = -(h * lambda * lambda + of_lambda * 2.0 * lambda * phi);
                    let across = -(h * 2.0 * exponent * lambda + of_lambda * kappa);
                    p = radial * u + across * footprint.depth_slope_u;
                    q = radial * v + across * footprint.depth_slope_v;
                    sums[6] += across * u;
                    sums[7] += across * v;
                    sums[8] += 4.0 * exponent * footprint.thickness * (h * exponent - of_lambda * lambda);
                    seen *= lambda;
                }
                sums[0] += h;
                sums[1] += p;
                sums[2] += q;
                sums[3] += p * u;
                sums[4] += q * u;
                sums[5] += q * v;
                sums[9] += seen;
                if comptime!(absolute) {
                    let per_v = q / footprint.sigma_v;
                    absolute_x += (footprint.shear * per_v - p / footprint.sigma_u).abs();
                    absolute_y += per_v.abs();
                }
            }
        }
        let at = intersection as usize * (comptime!(row_len(0, absolute)) + channels);
        #[unroll]
        for column in 0..comptime!(SUMS) {
            rows[at + column] = sums[column];
        }
        for channel in 0..channels {
            let mut sum = 0.0f32;
            for unit in 0..comptime!(TILE_PIXELS as u32) {
                let weight = f32::reinterpret(table[own + 2 * unit as usize + 1]);
                if weight > 0.0 {
                    sum += weight * grad[channel * plane + RayPixel::of(tile, unit, &view).index];
                }
            }
            rows[at + comptime!(SUMS) + channel] = sum;
        }
        if comptime!(absolute) {
            rows[at + comptime!(SUMS) + channels] = absolute_x;
            rows[at + comptime!(SUMS) + channels + 1] = absolute_y;
        }
    }
}

/// Sums one column of a Gaussian's rows.
#[cube]
fn column_sum(rows: &[f32], first: u32, end: u32, columns: usize, column: usize) -> f32 {
    let mut sum = 0.0f32;
    for intersection in first..end {
        sum += rows[intersection as usize * columns + column];
    }
    sum
}

/// Turns rows into gradients, as the CPU twin does. Gaussians without intersections are skipped, so the gradients must hold zeros
/// before.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_gather_kernel(
    projected: &[f32],
    order: &[u32],
    first_intersection: &[u32],
    rows: &[f32],
    grad_projected: &mut [f32],
    grad_depth_slopes: &mut [f32],
    grad_features: &mut [f32],
    grad_absolute: &mut [f32],
    visible: u32,
    intersections: u32,
    features: u32,
    #[comptime] wanted: (bool, bool, bool),
    #[comptime] absolute: bool,
) {
    let rank = ABSOLUTE_POS;
    if rank < visible as usize {
        let gaussian = order[rank] as usize;
        let first = first_intersection[rank];
        let mut end = intersections;
        if rank + 1 < visible as usize {
            end = first_intersection[rank + 1];
        }
        let channels = features as usize;
        let columns = comptime!(row_len(0, absolute)) + channels;
        if comptime!(wanted.0) {
            let at = gaussian * comptime!(COLUMNS);
            let sigma_u = projected[at + 2];
            let shear = projected[at + 3];
            let sigma_v = projected[at + 4];
            let per_v = column_sum(rows, first, end, columns, 2) / sigma_v;
            grad_projected[at] = shear * per_v - column_sum(rows, first, end, columns, 1) / sigma_u;
            grad_projected[at + 1] = -per_v;
            grad_projected[at + 2] = -(column_sum(rows, first, end, columns, 3) / sigma_u);
            grad_projected[at + 3] = -(column_sum(rows, first, end, columns, 4) * (sigma_u / sigma_v));
            grad_projected[at + 4] = -(column_sum(rows, first, end, columns, 5) / sigma_v);
            grad_projected[at + 5] = column_sum(rows, first, end, columns, 9);
            grad_projected[at + 6] = column_sum(rows, first, end, columns, 0) / projected[at + 6];
        }
        if comptime!(wanted.1) {
            #[unroll]
            for k in 0..comptime!(DEPTH_SLOPE) {
                grad_depth_slopes[gaussian * comptime!(DEPTH_SLOPE) + k] =
                    column_sum(rows, first, end, columns, comptime!(6 + k));
            }
        }
        if comptime!(wanted.2) {
            for channel in 0..channels {
                grad_features[gaussian * channels + channel] =
                    column_sum(rows, first, end, columns, comptime!(SUMS) + channel);
            }
        }
        if comptime!(absolute) {
            grad_absolute[2 * gaussian] = column_sum(rows, first, end, columns, comptime!(SUMS) + channels);
            grad_absolute[2 * gaussian + 1] = column_sum(rows, first, end, columns, comptime!(SUMS + 1) + channels);
        }
    }
}

/// `sums[channel] = Σ grad left`, a cube per channel, in a fixed order.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_background_kernel(
    grad: &[f32],
    left: &[f32],
    sums: &mut [f32],
    pixels: u32,
    channels: u32,
    #[comptime] planes: bool,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < channels as usize {
        let mut own = 0.0f32;
        let mut pixel = UNIT_POS;
        while pixel < pixels {
            own += grad[CUBE_POS * pixels as usize + pixel as usize] * left[pixel as usize];
            pixel += comptime!(UNITS as u32);
        }
        let total = cube_sum(own, &mut shared, planes);
        if UNIT_POS == 0 {
            sums[CUBE_POS] = total;
        }
    }
}
