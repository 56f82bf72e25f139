//! Groups of layers in the backward pass, for few channels: what `backward_groups.rs` is made of.
//!
//! A unit is a pixel while it passes the layers of a group, and a run of pixels of one layer while sums are made: what a layer gives
//! each pixel goes through a small table in shared memory. Each plane has a table, or each block of pixels.

use cubecl::prelude::*;

use super::MOMENTS;
use super::blocks::{BLOCK_PIXELS, pixel_of};
use super::ellipse::LayerEllipse;
use super::layer::{BUCKET, Four, KernelShape, RasterFrame, SEGMENT, SplatInputs, TilePixel, layer};
use super::segment::Segment;
use super::splat::{Splat, colours_of};
use super::suffix::plane_of;
use super::trace::WORDS;
use crate::intersect::TILE_PIXELS;

/// Which units share a table, and the sizes of it. A compile-time parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Sharing {
    /// Whether the units of a plane share it; otherwise those of a block do.
    pub planes: bool,
    /// Number of units that share it.
    pub units: usize,
    /// Number of layers in a group, and number of pixels that a unit sums. The alphas of a group stay in registers.
    pub together: usize,
    /// Number of places whose Gaussians are in shared memory at a time.
    held: usize,
    /// Length of a table, at least [`Self::layers`].
    pub table: usize,
}

impl Sharing {
    pub const fn of_planes(units: u32) -> Self {
        let sharing = Self { planes: true, units: units as usize, together: 8, held: SEGMENT, table: 0 };
        Self { table: sharing.layers(), ..sharing }
    }

    /// A block's table also has room for a column of its units for each sum.
    pub const fn of_blocks(columns: usize) -> Self {
        let sharing =
            Self { planes: false, units: BLOCK_PIXELS, together: 4, held: BUCKET, table: BLOCK_PIXELS * columns };
        if sharing.table > sharing.layers() { sharing } else { Self { table: sharing.layers(), ..sharing } }
    }

    /// Length of a layer's row: one more than its pixels, so that units that read a column meet no bank twice.
    const fn row(&self) -> usize {
        self.units + 1
    }

    /// Length of what a group's layers take of a table: for each a row of `h`, then for each a row of weights `α T`.
    const fn layers(&self) -> usize {
        2 * self.together * self.row()
    }

    /// Number of units that sum a layer.
    pub const fn of_layer(&self) -> u32 {
        (self.units / self.together) as u32
    }

    /// Largest number of groups of a bucket.
    pub const fn most_groups(&self) -> u32 {
        (BUCKET / self.together) as u32
    }

    /// Number of groups of a bucket for which a unit keeps the transmittance before them.
    pub const fn marks(&self) -> usize {
        if self.planes { 1 } else { self.most_groups() as usize }
    }

    /// Whether all planes take as many turns. In Mesa's driver in software, whose planes have 8 units, the barrier of a plane waits for
    /// the cube (`visit_barrier` of `lp_bld_nir.c`).
    pub const fn in_step(&self) -> bool {
        self.planes && self.units == 8
    }

    const fn tables(&self) -> usize {
        TILE_PIXELS / self.units
    }

    /// Bytes of shared memory of the kernel: those of [`GroupMemory`], and the number of turns.
    pub const fn shared_bytes(&self, shape: KernelShape) -> usize {
        let of_places = self.held * (4 * LayerEllipse::VECTORS + 4 + 1) + WORDS + 1;
        4 * (of_places + TILE_PIXELS * shape.channels() + self.tables() * (self.table + self.together))
    }
}

/// Shared memory of a cube.
#[derive(CubeType)]
pub(super) struct GroupMemory {
    pub words: Shared<[u32]>,
    /// Of the places that are held.
    pub ellipses: Shared<[Four]>,
    pub colours: Shared<[Four]>,
    /// Gaussians, to whose rows the sums are added.
    pub targets: Shared<[u32]>,
    /// `[channel][unit]`: `g` of the pixels.
    pub gradients: Shared<[f32]>,
    pub tables: Shared<[f32]>,
    /// `[table][layer]`: the layer's place in its bucket.
    pub group: Shared<[u32]>,
}

#[cube]
impl GroupMemory {
    pub fn new(#[comptime] shape: KernelShape, #[comptime] sharing: Sharing) -> GroupMemory {
        GroupMemory {
            words: Shared::<[u32]>::new_slice(comptime!(WORDS)),
            ellipses: Shared::<[Four]>::new_slice(comptime!(sharing.held * LayerEllipse::VECTORS)),
            colours: Shared::<[Four]>::new_slice(sharing.held),
            targets: Shared::<[u32]>::new_slice(sharing.held),
            gradients: Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS * shape.channels())),
            tables: Shared::<[f32]>::new_slice(comptime!(sharing.tables() * sharing.table)),
            group: Shared::<[u32]>::new_slice(comptime!(sharing.tables() * sharing.together)),
        }
    }
}

/// Loads the Gaussians of a segment's places from `first` on. Two units load a Gaussian.
#[cube]
pub(super) fn load_places(
    memory: &mut GroupMemory,
    first: u32,
    segment: &Segment,
    inputs: &SplatInputs,
    top: f32,
    frame: &RasterFrame,
    #[comptime] shape: KernelShape,
    #[comptime] sharing: Sharing,
) {
    let i = UNIT_POS % comptime!(sharing.held as u32);
    if first + i < segment.count && UNIT_POS < comptime!(2 * sharing.held as u32) {
        let gaussian = inputs.lists.gaussian(segment.first + segment.start + first + i);
        if UNIT_POS < comptime!(sharing.held as u32) {
            let ellipse = LayerEllipse::of(inputs, gaussian as usize, top, frame);
            LayerEllipse::store(&ellipse, &mut memory.ellipses, i as usize);
        } else {
            memory.colours[i as usize] = colours_of::<LayerEllipse>(inputs, gaussian as usize, shape);
            memory.targets[i as usize] = gaussian;
        }
    }
}

/// Loads the words of a segment's slot, and `g` of the unit's pixel, which stays in `gradient` as well.
#[cube]
pub(super) fn load_pixel(
    memory: &mut GroupMemory,
    gradient: &mut Array<f32>,
    slot: u32,
    words: &[u32],
    grad: &[f32],
    pixel: &TilePixel,
    frame: &RasterFrame,
    #[comptime] shape: KernelShape,
) {
    if UNIT_POS < comptime!(WORDS as u32) {
        memory.words[UNIT_POS as usize] = words[(slot * comptime!(WORDS as u32) + UNIT_POS) as usize];
    }
    let plane = (frame.width * frame.height) as usize;
    #[unroll]
    for channel in 0..comptime!(shape.channels()) {
        gradient[channel] = 0.0f32;
        if pixel.inside {
            gradient[channel] = grad[plane_of(channel, shape) * plane + pixel.index];
        }
        memory.gradients[comptime!(channel * TILE_PIXELS) + UNIT_POS as usize] = gradient[channel];
    }
}

/// Passes the layer of a place at a pixel, as [`layer`] does.
#[cube]
pub(super) fn pass_layer(
    ellipses: &Shared<[Four]>,
    place: u32,
    through: f32,
    stopped: f32,
    before: f32,
    pixel: &TilePixel,
    inputs: &SplatInputs,
    frame: &RasterFrame,
) -> (f32, f32, f32) {
    let ellipse = LayerEllipse::load(ellipses, place as usize, inputs);
    layer(ellipse.alpha(pixel.x, pixel.row, frame), through, stopped, before, frame.transmittance_min)
}

/// Passes the layers of a group, the first `here` of `left`: forwards for `α` and `T`, then backwards for `∂L/∂α`. Leaves `h` and the
/// weights in the unit's table, and returns `ρ` in front of the group, from `behind`. The bucket begins at entry `first` of the places.
#[cube]
pub(super) fn pass_group(
    memory: &mut GroupMemory,
    gradient: &Array<f32>,
    first: u32,
    here: u32,
    left: u32,
    through: f32,
    stopped: f32,
    before: f32,
    behind: f32,
    pixel: &TilePixel,
    inputs: &SplatInputs,
    frame: &RasterFrame,
    #[comptime] shape: KernelShape,
    #[comptime] sharing: Sharing,
) -> f32 {
    let together = comptime!(sharing.together);
    let lane = UNIT_POS % comptime!(sharing.units as u32);
    let sharer = (UNIT_POS / comptime!(sharing.units as u32)) as usize;
    let mut left = left;
    let mut through = through;
    let mut stopped = stopped;
    let mut behind = behind;
    let mut alphas = Array::<f32>::new(together);
    let mut weights = Array::<f32>::new(together);
    let mut places = Array::<u32>::new(together);
    #[unroll]
    for k in 0..together {
        alphas[k] = 0.0f32;
        weights[k] = 0.0f32;
        places[k] = 0u32;
        if comptime!(k as u32) < here {
            let i = left.trailing_zeros();
            left &= left - 1;
            places[k] = i;
            let (alpha, next, stops) =
                pass_layer(&memory.ellipses, first + i, through, stopped, before, pixel, inputs, frame);
            alphas[k] = alpha;
            weights[k] = alpha * (before * through);
            through = next;
            stopped = stops;
        }
    }
    #[unroll]
    for back in 0..together {
        let k = comptime!(together - 1 - back);
        if comptime!(k as u32) < here {
            let all = memory.colours[(first + places[k]) as usize];
            let mut along = 0.0f32;
            #[unroll]
            for channel in 0..comptime!(shape.channels()) {
                along += gradient[channel] * all.extract(channel);
            }
            // Where the layer does not show, its features may be infinite or undefined.
            let ahead = select(alphas[k] > 0.0, along - behind, 0.0);
            behind += alphas[k] * ahead;
            let at = sharer * comptime!(sharing.table) + comptime!(k * sharing.row()) + lane as usize;
            memory.tables[at] = select(alphas[k] < frame.alpha_max, weights[k] * ahead, 0.0);
            memory.tables[at + comptime!(together * sharing.row())] = weights[k];
            if lane == 0 {
                memory.group[sharer * together + k] = places[k];
            }
        }
    }
    behind
}

/// The run of pixels that a unit sums, and their layer of the group.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Run {
    pub layer: u32,
    /// Unit of its first pixel.
    pub start: u32,
    /// Column centre of its first pixel, px, and row within the tile.
    x: f32,
    row: f32,
    /// Where the table has `h` of its first pixel.
    at: usize,
}

#[cube]
impl Run {
    pub fn of_unit(origin: (u32, u32), inputs: &SplatInputs, frame: &RasterFrame, #[comptime] sharing: Sharing) -> Run {
        let lane = UNIT_POS % comptime!(sharing.units as u32);
        let layer = lane / comptime!(sharing.of_layer());
        let in_table = lane % comptime!(sharing.of_layer()) * comptime!(sharing.together as u32);
        let start = UNIT_POS - lane + in_table;
        let first = TilePixel::of(origin, pixel_of(start), inputs, frame);
        let table = (UNIT_POS / comptime!(sharing.units as u32)) as usize * comptime!(sharing.table);
        let at = table + layer as usize * comptime!(sharing.row()) + in_table as usize;
        Run { layer, start, x: first.x, row: first.row, at }
    }
}

/// Adds the pixels of a run to `values`, those of a row of sums. The layer's Gaussian is at entry `place` of the places.
#[cube]
pub(super) fn sum_run(
    values: &mut Array<f32>,
    memory: &GroupMemory,
    run: &Run,
    place: usize,
    inputs: &SplatInputs,
    #[comptime] shape: KernelShape,
    #[comptime] sharing: Sharing,
    #[comptime] absolute: bool,
) {
    let channels = comptime!(shape.channels());
    let ellipse = LayerEllipse::load(&memory.ellipses, place, inputs);
    #[unroll]
    for i in 0..comptime!(sharing.together) {
        let h = memory.tables[run.at + i];
        let weight = memory.tables[run.at + comptime!(sharing.together * sharing.row() + i)];
        let (u, below) = ellipse.along_column(run.x + comptime!(i as f32));
        let v = (below + run.row) * ellipse.inverse_v;
        let hu = h * u;
        let hv = h * v;
        values[0] += h;
        values[1] += hu;
        values[2] += hv;
        values[3] += hu * u;
        values[4] += hv * u;
        values[5] += hv * v;
        #[unroll]
        for channel in 0..channels {
            let of_pixel = memory.gradients[comptime!(channel * TILE_PIXELS + i) + run.start as usize];
            values[comptime!(MOMENTS + channel)] += weight * of_pixel;
        }
        if comptime!(absolute) {
            let slope = ellipse.inverse_v * ellipse.shear;
            values[comptime!(MOMENTS + channels)] += (hu * ellipse.inverse_u - hv * slope).abs();
            values[comptime!(MOMENTS + channels + 1)] += (hv * ellipse.inverse_v).abs();
        }
    }
}
