//! Backward kernels with the per-pixel sort. No float is accumulated by two units, so every run gives the same bits.
//!
//! 1. *Walk*: a cube per tile, a unit per pixel. A unit goes front to back as in the forward pass and stores, at each layer, the
//!    transmittance before it and a link to the previous layer. It then follows these links back, as many as it stored, and
//!    replaces them by `h = α ∂L/∂α` and by the weight `α T`. Both numbers lie in a table `[places, 256, 2]` of all layers and pixels of a run of
//!    tiles; many tiles take several launches, so that the table does not grow with the picture.
//! 2. *Sums*: a unit per place of these tiles computes a row, the sums over the tile's pixels.
//!
//! The gather kernel of `rasterize` adds a Gaussian's rows in the order of its intersections and turns them into gradients.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayGaussian, RayInputs, RayPixel};
use super::pair_sums::{PairSums, row_len};
use super::walk::front_to_back;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;
use crate::rasterize::backward::MOMENTS;
use crate::rasterize::layer::{TilePixel, tile_origin};

/// Returns the link to the next layer in front, a place plus one, from the link that the table holds; zero ends the way. `layers` is
/// the number of layers in front. It bounds the way, whatever the table holds, and a link beyond the list ends it.
#[cube]
fn link_before(held: u32, layers: u32, places: u32) -> u32 {
    select(layers > 0 && held <= places, held, 0u32)
}

/// Fills the table with bits of floats, and `left`, `[H W]`, with the transmittances behind all layers.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_walk_kernel(
    inputs: RayInputs,
    grad: &[f32],
    table: &mut [u32],
    left: &mut [f32],
    view: RayFrame,
) {
    let tile = view.first_tile + CUBE_POS as u32;
    if tile < view.end_tile {
        let unit = UNIT_POS % comptime!(TILE_PIXELS as u32);
        let pixel = TilePixel::of(tile_origin(tile, &view.frame), unit, &view.frame);
        let plane = (view.frame.width * view.frame.height) as usize;
        let channels = comptime!(view.shape.features);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        // Index of this unit's two numbers at the tile's first place.
        let own =
            (first - inputs.lists.start(view.first_tile)) as usize * comptime!(2 * TILE_PIXELS) + 2 * unit as usize;
        for place in 0..places {
            let at = own + place as usize * comptime!(2 * TILE_PIXELS);
            table[at] = 0u32;
            table[at + 1] = 0u32;
        }
        let ray = RayPixel::of(pixel, &inputs);
        let front = front_to_back(&inputs, first, places, &ray, pixel.inside, table, own, &view, true);
        if pixel.inside {
            left[pixel.index] = front.transmittance();
            let mut link = front.link();
            let mut layers = front.layers();

            // Contribution of everything behind the layer, as the gradient weighs it: g·R.
            let mut behind = 0.0f32;
            for channel in 0..channels {
                behind += grad[channel * plane + pixel.index] * inputs.background[channel];
            }
            let grad_alpha = grad[channels * plane + pixel.index];
            let mut grad_depth = 0.0f32;
            if comptime!(view.shape.depth) {
                grad_depth = grad[(channels + 1) * plane + pixel.index];
            }
            while link > 0 {
                let place = link - 1;
                let at = own + place as usize * comptime!(2 * TILE_PIXELS);
                let before = f32::reinterpret(table[at]);
                layers -= 1u32;
                link = link_before(table[at + 1], layers, places);
                let gaussian = inputs.lists.gaussian(first + place) as usize;
                let footprint = RayGaussian::load(&inputs, gaussian, &view);
                let layer = footprint.at(&ray, &view);
                // Alpha acts as one more channel of colour one.
                let mut here = grad_alpha + grad_depth * footprint.depth_of(&layer, &view);
                for channel in 0..channels {
                    here += grad[channel * plane + pixel.index] * inputs.features[gaussian * channels + channel];
                }
                let h = select(layer.free, layer.alpha * before * (here - behind), 0.0);
                behind = layer.alpha * here + (1.0 - layer.alpha) * behind;
                table[at] = u32::reinterpret(h);
                table[at + 1] = u32::reinterpret(layer.alpha * before);
            }
        }
    }
}

/// Returns the last of the tiles `first..end` whose list begins at or before `place`: the tile whose list holds it.
#[cube]
fn tile_of(lists: &TileLists, first: u32, end: u32, place: u32) -> u32 {
    let mut low = first;
    let mut high = end;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if lists.start(middle) <= place {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Writes the rows of those of the intersections `first_row..end_row` that a run of tiles has.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_sums_kernel(
    inputs: RayInputs,
    grad: &[f32],
    table: &[u32],
    rows: &mut [f32],
    first_row: u32,
    end_row: u32,
    view: RayFrame,
    #[comptime] absolute: bool,
) {
    let place = inputs.lists.start(view.first_tile) + ABSOLUTE_POS as u32;
    let mut row = end_row;
    if place < inputs.lists.start(view.end_tile) {
        row = inputs.lists.intersection(place) - first_row;
    }
    if row < end_row - first_row {
        let tile = tile_of(&inputs.lists, view.first_tile, view.end_tile, place);
        let origin = tile_origin(tile, &view.frame);
        let gaussian = inputs.lists.gaussian(place) as usize;
        let footprint = RayGaussian::load(&inputs, gaussian, &view);
        let plane = (view.frame.width * view.frame.height) as usize;
        let features = comptime!(view.shape.features);
        let columns = comptime!(row_len(view.shape, absolute));
        let own = ABSOLUTE_POS * comptime!(2 * TILE_PIXELS);
        let mut sums = PairSums::new();
        for unit in 0..comptime!(TILE_PIXELS as u32) {
            let weight = f32::reinterpret(table[own + 2 * unit as usize + 1]);
            if weight > 0.0 {
                let pixel = TilePixel::of(origin, unit, &view.frame);
                let layer = footprint.at(&RayPixel::of(pixel, &inputs), &view);
                let h = f32::reinterpret(table[own + 2 * unit as usize]);
                let mut seen = 0.0f32;
                if comptime!(view.shape.depth) {
                    seen = weight * grad[comptime!(features + 1) * plane + pixel.index];
                }
                sums.add(&footprint, &layer, h, seen, &view, absolute);
            }
        }
        sums.write(rows, row, &view, absolute);
        let at = row as usize * columns + comptime!(MOMENTS);
        for channel in 0..features {
            let mut sum = 0.0f32;
            for unit in 0..comptime!(TILE_PIXELS as u32) {
                let weight = f32::reinterpret(table[own + 2 * unit as usize + 1]);
                if weight > 0.0 {
                    sum += weight * grad[channel * plane + TilePixel::of(origin, unit, &view.frame).index];
                }
            }
            rows[at + channel] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Buffer;
    use crate::testing::gpu::gpus;

    const PLACES: u32 = 5;

    /// Steps after which the test gives up.
    const PATIENCE: u32 = 1_000;

    /// Follows the links of a table of one unit from `last`, as the walk does, and counts the layers.
    #[cube(launch_unchecked)]
    fn follow_kernel(table: &[u32], steps: &mut [u32], last: u32, layers: u32) {
        let mut link = last;
        let mut left = layers;
        let mut count = 0u32;
        while link > 0 && count < comptime!(PATIENCE) {
            left -= 1u32;
            link = link_before(table[(2 * link - 1) as usize], left, comptime!(PLACES));
            count += 1u32;
        }
        steps[0] = count;
    }

    #[test]
    fn no_table_makes_the_way_back_endless() {
        // The links of five places, the link to the last layer, the number of layers, and the number of steps.
        let tables = [
            ([0, 1, 2, 3, 4], 5, 5, 5),
            ([3, 0, 5, 0, 2], 1, 4, 4),
            ([2, 1, 0, 0, 0], 1, 3, 3),
            ([1, 0, 0, 0, 0], 1, 1, 1),
            ([u32::MAX, 0, 0, 0, 0], 1, 5, 1),
            ([6, 0, 0, 0, 0], 1, 5, 1),
        ];
        for (form, gpu) in gpus() {
            for (links, last, layers, expected) in tables {
                let table = Buffer::from_slice(&gpu, &links.map(|link| [0, link]).concat());
                let steps = Buffer::<u32>::new(&gpu, 1);
                // SAFETY: links within the table are read, and one number is written.
                unsafe {
                    follow_kernel::launch_unchecked(
                        &gpu.client,
                        CubeCount::Static(1, 1, 1),
                        CubeDim::new_1d(1),
                        table.arg(),
                        steps.arg(),
                        last,
                        layers,
                    );
                }
                assert_eq!(steps.read(&gpu), [expected], "{form}: {links:?} from {last}, {layers} layers");
            }
        }
    }
}
