//! Launches of the loss.

use super::forward::{
    HalfWindowLaunch, PlanesLaunch, TermWeightsLaunch, gradient_kernel, index_kernel, moments_kernel, window_kernel,
};
use super::taps::{Compared, half_window};
use crate::gpu::{Buffer, Gpu, elementwise};

/// Number of values of a unit down a column.
const DOWN: usize = 8;

/// Number of values of a unit along a row. Neighbouring units read a row together, so each takes one value of it.
const ALONG: usize = 1;

fn window() -> HalfWindowLaunch {
    let [t0, t1, t2, t3, t4, t5] = half_window().map(|tap| tap as f32);
    HalfWindowLaunch::new(t0, t1, t2, t3, t4, t5)
}

/// Returns the number of units for a pass over `values` values in lines of `len`, with `strip` values per unit.
fn units(values: usize, len: usize, strip: usize) -> usize {
    values / len * len.div_ceil(strip)
}

/// Returns `Kx` of planes of the given width and height.
pub(crate) fn launch_window(gpu: &Gpu, planes: &Buffer<f32>, [width, height]: [usize; 2]) -> Buffer<f32> {
    let (down, along) = (Buffer::new(gpu, planes.len), Buffer::new(gpu, planes.len));
    launch_direction(gpu, planes, &down, [width, height], true);
    launch_direction(gpu, &down, &along, [width, height], false);
    along
}

/// Applies the window along one axis.
fn launch_direction(gpu: &Gpu, from: &Buffer<f32>, to: &Buffer<f32>, [width, height]: [usize; 2], vertical: bool) {
    let (len, strip) = if vertical { (height, DOWN) } else { (width, ALONG) };
    let (grid, dim) = elementwise(units(from.len, len, strip));
    let planes = PlanesLaunch::new(width as u32, height as u32, (from.len / (width * height)) as u32);
    // SAFETY: strips beyond the last plane and values beyond the line are guarded.
    unsafe {
        window_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            from.arg(),
            to.arg(),
            window(),
            planes,
            vertical,
            strip,
        );
    }
}

/// Returns the shares of the loss and, if `with_gradient` is set, its gradient, each `[C, H, W]`.
pub(crate) fn launch_photometric(
    gpu: &Gpu,
    inputs: &Compared<Buffer<f32>>,
    size: [usize; 2],
    lambda: f64,
    with_gradient: bool,
) -> (Buffer<f32>, Option<Buffer<f32>>) {
    let job = LossLaunch { gpu, inputs, size, lambda };
    let values = inputs.image.len;
    let shares = Buffer::new(gpu, values);
    let derivatives = Buffer::new(gpu, if with_gradient { 3 * values } else { 0 });
    let gradient = Buffer::if_needed(gpu, with_gradient, values);
    job.launch(&shares, &derivatives, gradient.as_ref());
    (shares, gradient)
}

/// Arguments of one evaluation of the loss.
struct LossLaunch<'a> {
    gpu: &'a Gpu,
    inputs: &'a Compared<Buffer<f32>>,
    size: [usize; 2],
    lambda: f64,
}

impl LossLaunch<'_> {
    fn planes(&self) -> PlanesLaunch {
        let [width, height] = self.size;
        PlanesLaunch::new(width as u32, height as u32, (self.inputs.image.len / (width * height)) as u32)
    }

    fn weights(&self) -> TermWeightsLaunch {
        let share = 1.0 / self.inputs.image.len as f64;
        TermWeightsLaunch::new(((1.0 - self.lambda) * share) as f32, self.lambda as f32, share as f32)
    }

    /// Writes the shares and, if `gradient` is given, the derivatives of the index and the gradient of the loss.
    fn launch(&self, shares: &Buffer<f32>, derivatives: &Buffer<f32>, gradient: Option<&Buffer<f32>>) {
        let Self { gpu, inputs, size: [width, height], .. } = *self;
        let values = inputs.image.len;
        let moments: Buffer<f32> = Buffer::new(gpu, 3 * values);
        // SAFETY: strips beyond the last plane and values beyond the line are guarded.
        unsafe {
            let (grid, dim) = elementwise(units(values, height, DOWN));
            moments_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.image.arg(),
                inputs.truth.arg(),
                moments.arg(),
                window(),
                self.planes(),
                DOWN,
            );
            let (grid, dim) = elementwise(units(values, width, ALONG));
            index_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.image.arg(),
                inputs.truth.arg(),
                inputs.mean.arg(),
                inputs.variance.arg(),
                moments.arg(),
                shares.arg(),
                derivatives.arg(),
                window(),
                self.planes(),
                self.weights(),
                gradient.is_some(),
                ALONG,
            );
        }
        let Some(gradient) = gradient else { return };
        // The moments are not read again: their memory takes the derivatives' filtered columns.
        launch_direction(gpu, derivatives, &moments, [width, height], true);
        let (grid, dim) = elementwise(units(values, width, ALONG));
        // SAFETY: as above.
        unsafe {
            gradient_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.image.arg(),
                inputs.truth.arg(),
                moments.arg(),
                gradient.arg(),
                window(),
                self.planes(),
                self.weights(),
                ALONG,
            );
        }
    }
}
