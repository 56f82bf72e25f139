//! Backward pass over the layers of a bucket at the pixels of one unit, for few channels. `backward_few_channels.rs`
//! calls it once the values of a Gaussian are loaded. All of its state lies in registers.

#![allow(clippy::too_many_arguments, reason = "functions of a kernel take what it was launched with")]

use cubecl::prelude::*;

use super::backward::{MOMENTS, plane_of};
use super::layer::{KernelShape, LayerEllipse, RasterFrame, layer};
use crate::intersect::{TILE, TILE_PIXELS};

/// Number of places that are processed together. Their alphas and weights lie in registers.
pub(super) const STEP: usize = 4;

/// Number of pixels of a unit.
pub(super) const STRIP: usize = 8;

/// State of a unit's pixels: the values that are the same for every layer, and the progress of a pass.
#[derive(CubeType)]
pub(super) struct UnitPixels {
    /// Centre of the column and of the tile's first row, px, and the row of the strip's first pixel within the tile.
    x: f32,
    top: f32,
    row: f32,
    /// The transmittance before the bucket, negative where the pixel was finished.
    before: Array<f32>,
    /// `ρ` behind the last layer passed.
    rho: Array<f32>,
    grad_alpha: Array<f32>,
    /// `[pixel][channel]`.
    gradients: Array<f32>,
    /// Shares let through and stopped: arguments of [`layer`].
    through: Array<f32>,
    stopped: Array<f32>,
}

#[cube]
impl UnitPixels {
    /// Allocates the strip that begins at `column` and `row` of a tile. [`Self::load`] fills each pixel.
    pub fn new(tile: u32, column: u32, row: u32, frame: RasterFrame, #[comptime] shape: KernelShape) -> UnitPixels {
        let pixels = comptime!(STRIP);
        UnitPixels {
            x: f32::cast_from(tile % frame.tiles_x * comptime!(TILE as u32) + column) + 0.5,
            top: f32::cast_from(tile / frame.tiles_x * comptime!(TILE as u32)) + 0.5,
            row: f32::cast_from(row),
            before: Array::<f32>::new(pixels),
            rho: Array::<f32>::new(pixels),
            grad_alpha: Array::<f32>::new(pixels),
            gradients: Array::<f32>::new(comptime!(pixels * shape.channels())),
            through: Array::<f32>::new(pixels),
            stopped: Array::<f32>::new(pixels),
        }
    }

    /// Reads pixel `p` and sets it to the state before the bucket's first layer.
    pub fn load(
        &mut self,
        kept: &[f32],
        suffix_rho: &[f32],
        grad: &[f32],
        bucket_index: u32,
        tile: u32,
        column: u32,
        row: u32,
        frame: RasterFrame,
        #[comptime] shape: KernelShape,
        #[comptime] p: usize,
    ) {
        let channels = comptime!(shape.channels());
        let in_tile = (row * comptime!(TILE as u32) + column) as usize + comptime!(p * TILE);
        self.before[p] = kept[bucket_index as usize * comptime!(shape.kept() * TILE_PIXELS) + in_tile];
        self.rho[p] = suffix_rho[bucket_index as usize * comptime!(TILE_PIXELS) + in_tile];
        self.grad_alpha[p] = 0.0f32;
        #[unroll]
        for channel in 0..channels {
            self.gradients[comptime!(p * channels) + channel] = 0.0f32;
        }
        let column = tile % frame.tiles_x * comptime!(TILE as u32) + column;
        let row = tile / frame.tiles_x * comptime!(TILE as u32) + row + comptime!(p as u32);
        if column < frame.width && row < frame.height {
            let plane = (frame.width * frame.height) as usize;
            let pixel = (row * frame.width + column) as usize;
            if comptime!(shape.grad_alpha) {
                self.grad_alpha[p] = grad[comptime!(shape.features) * plane + pixel];
            }
            #[unroll]
            for channel in 0..channels {
                self.gradients[comptime!(p * channels) + channel] = grad[plane_of(channel, shape) * plane + pixel];
            }
        }
        self.through[p] = select(self.before[p] >= 0.0, 1.0f32, -1.0f32);
        self.stopped[p] = 0.0f32;
    }

    /// Returns the state of the forward pass at pixel `p` as one number: the share stopped while that is little, else the
    /// negated share let through; two where the pixel is finished.
    pub fn checkpoint(&self, #[comptime] p: usize) -> f32 {
        let (through, stopped) = (self.through[p], self.stopped[p]);
        // A zero would lose its sign in comparisons.
        let open = select(stopped < 0.5, stopped, -max(through, f32::MIN_POSITIVE));
        select(through >= 0.0, open, 2.0)
    }

    /// Resets pixel `p` to a checkpoint.
    pub fn restore(&mut self, checkpoint: f32, #[comptime] p: usize) {
        let faint = checkpoint >= 0.0;
        let through = select(faint, 1.0 - checkpoint, -checkpoint);
        self.through[p] = select(checkpoint >= 1.0, -1.0f32, through);
        self.stopped[p] = select(faint, checkpoint, 1.0);
    }

    /// Passes a Gaussian forwards at pixel `p`. Returns its alpha, zero if it does not contribute, and its weight
    /// `α T`.
    pub fn pass(
        &mut self,
        footprint: LayerEllipse,
        frame: &RasterFrame,
        #[comptime] shape: KernelShape,
        #[comptime] p: usize,
    ) -> (f32, f32) {
        let (u, v) = footprint.whiten(self.x, self.top, self.row + comptime!(p as f32));
        let alpha = footprint.alpha(u, v, frame, shape);
        let (alpha, through, stopped) =
            layer(alpha, self.through[p], self.stopped[p], self.before[p], frame.transmittance_min);
        let weight = alpha * (self.before[p] * self.through[p]);
        self.through[p] = through;
        self.stopped[p] = stopped;
        (alpha, weight)
    }

    /// Passes the Gaussian at place `k` of its step backwards and adds its sums over the pixels to `row`.
    pub fn add_sums(
        &mut self,
        footprint: LayerEllipse,
        colour: &Array<f32>,
        alphas: &Array<f32>,
        weights: &Array<f32>,
        row: &mut Array<f32>,
        alpha_max: f32,
        #[comptime] shape: KernelShape,
        #[comptime] absolute: bool,
        #[comptime] k: usize,
    ) {
        let pixels = comptime!(STRIP);
        let channels = comptime!(shape.channels());
        let slope = footprint.inverse_v * footprint.shear;
        let (u, below) = footprint.along_column(self.x, self.top);
        // Sums of `h, h v, h v²` down the column, where `u` is the same.
        let mut h_sum = 0.0f32;
        let mut hv_sum = 0.0f32;
        let mut hvv_sum = 0.0f32;
        #[unroll]
        for p in 0..pixels {
            let alpha = alphas[comptime!(k * pixels + p)];
            let weight = weights[comptime!(k * pixels + p)];
            let mut along = self.grad_alpha[p];
            #[unroll]
            for channel in 0..channels {
                let gradient = self.gradients[comptime!(p * channels) + channel];
                along += gradient * colour[channel];
                row[comptime!(MOMENTS) + channel] += weight * gradient;
            }
            let ahead = along - self.rho[p];
            self.rho[p] += alpha * ahead;
            let h = select(alpha < alpha_max, weight * ahead, 0.0);
            let v = (below + (self.row + comptime!(p as f32))) * footprint.inverse_v;
            let hv = h * v;
            h_sum += h;
            hv_sum += hv;
            hvv_sum += hv * v;
            if comptime!(absolute) {
                row[comptime!(MOMENTS + channels)] += (h * u * footprint.inverse_u - hv * slope).abs();
                row[comptime!(MOMENTS + channels + 1)] += (hv * footprint.inverse_v).abs();
            }
        }
        row[0] += h_sum;
        row[1] += h_sum * u;
        row[2] += hv_sum;
        row[3] += h_sum * u * u;
        row[4] += hv_sum * u;
        row[5] += hvv_sum;
    }
}
