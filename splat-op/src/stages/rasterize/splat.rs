//! What a splat is to the kernels: its form in shared memory, its alpha at a pixel, and what a pair adds to its row of sums. The
//! kernels of both passes are written once, over this trait.

use cubecl::prelude::*;

use super::layer::{FEW, Four, KernelShape, RasterFrame, SplatInputs, TilePixel, layer, transmittance_after_bucket};
use crate::project::COLUMNS;

/// A block of a tile, whose pixels gave each place of a bucket a value `h = α ∂L/∂α` and a weight `α T`.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct BlockPairs {
    /// First column and row of the tile, and index of the block's first unit.
    pub origin: (u32, u32),
    pub first_unit: u32,
    /// Where a place's values begin in the tables of `h` and of weights.
    pub at: u32,
    /// Number of pixels of a plane of the picture.
    pub plane: usize,
}

/// A Gaussian as the pixels of a tile see it.
#[cube]
pub(crate) trait Splat: CubeType + Send + Sync + 'static {
    /// Number of vectors of four that it takes in shared memory.
    const VECTORS: usize;

    /// Number of columns of a row of sums between the channels and the sums of absolute values.
    const EXTRA_COLUMNS: usize;

    /// Whether its depth differs from pixel to pixel.
    const ALONG_RAYS: bool;

    /// Reads a Gaussian, for the tile whose first row has its centres at `top` px. One without a defined alpha does not show.
    fn of(inputs: &SplatInputs, gaussian: usize, top: f32, frame: &RasterFrame) -> Self;

    /// Stores it as entry `index` of a list in shared memory.
    fn store(splat: &Self, to: &mut Shared<[Four]>, index: usize);

    /// The inverse of [`Self::store`].
    fn load(from: &Shared<[Four]>, index: usize, inputs: &SplatInputs) -> Self;

    /// Returns the blocks in half `half` of a tile that may see it, one bit each. `left` is the centre of the tile's first
    /// column, px. No block that would see an alpha is left out.
    fn blocks_met(splat: &Self, left: f32, half: u32, frame: &RasterFrame) -> u32;

    /// Returns its alpha at a pixel, zero where it is below `alpha_min`, and, if [`Self::ALONG_RAYS`], its depth there.
    fn seen(splat: &Self, pixel: &TilePixel, frame: &RasterFrame) -> (f32, f32);

    /// Adds the pairs of a block to a row: all but the sums of the features. `grad` has the gradients of the planes.
    fn add_pairs(
        row: &mut Array<f32>,
        splat: &Self,
        pairs: BlockPairs,
        heights: &Shared<[f32]>,
        weights: &Shared<[f32]>,
        grad: &[f32],
        inputs: &SplatInputs,
        frame: &RasterFrame,
        #[comptime] shape: KernelShape,
        #[comptime] absolute: bool,
    );
}

/// Returns channel `channel` of a Gaussian. Depth follows the features; along rays it is `depth`, that of the pixel.
#[cube]
pub(super) fn colour<S: Splat>(
    inputs: &SplatInputs,
    gaussian: usize,
    channel: usize,
    depth: f32,
    #[comptime] shape: KernelShape,
) -> f32 {
    let is_depth = comptime!(shape.depth) && channel == comptime!(shape.features);
    let mut value = 0.0f32;
    if is_depth {
        if comptime!(S::ALONG_RAYS) {
            value = depth;
        } else {
            value = inputs.projected[gaussian * comptime!(COLUMNS) + 5];
        }
    }
    if !is_depth {
        value = inputs.features[gaussian * comptime!(shape.features) + channel];
    }
    value
}

/// Returns all channels of a Gaussian, of at most [`FEW`].
#[cube]
pub(super) fn colours_of<S: Splat>(inputs: &SplatInputs, gaussian: usize, #[comptime] shape: KernelShape) -> Four {
    let mut all = Four::empty();
    #[unroll]
    for channel in 0..comptime!(FEW) {
        let mut value = 0.0f32;
        if comptime!(channel < shape.channels()) {
            value = colour::<S>(inputs, gaussian, channel, 0.0, shape);
        }
        all.insert(channel, value);
    }
    all
}

/// Returns the transmittance of a pixel behind the places of a bucket's word, from that before the bucket. The bucket begins at entry
/// `first` of the list of splats.
#[cube]
pub(super) fn behind_word<S: Splat>(
    splats: &Shared<[Four]>,
    first: u32,
    word: u32,
    before: f32,
    pixel: &TilePixel,
    inputs: &SplatInputs,
    frame: &RasterFrame,
) -> f32 {
    let mut left = word;
    let mut through = 1.0f32;
    let mut stopped = 0.0f32;
    while left != 0 {
        let place = (first + left.trailing_zeros()) as usize;
        left &= left - 1;
        let (value, _) = S::seen(&S::load(splats, place, inputs), pixel, frame);
        let (_, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
        through = next;
        stopped = stops;
        if through < 0.0 {
            left = 0u32;
        }
    }
    transmittance_after_bucket(before, through, stopped)
}
