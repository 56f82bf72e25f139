//! Launches of the loss.

use cubecl::prelude::{CubeCount, CubeDim};

use super::forward::{
    PlanesLaunch, TermWeightsLaunch, columns_kernel, gradient_kernel, index_kernel, moments_kernel, photograph_kernel,
    strip_of, total_kernel,
};
use super::taps::Compared;
use crate::gpu::{Buffer, Gpu, UNITS, elementwise};

/// Returns the dispatch and the planes of a pass over `values` values.
fn pass(values: usize, [width, height]: [usize; 2], vertical: bool) -> (CubeCount, CubeDim, PlanesLaunch) {
    let len = if vertical { height } else { width };
    let (grid, dim) = elementwise(values / len * len.div_ceil(strip_of(vertical)));
    (grid, dim, PlanesLaunch::new(width as u32, height as u32, (values / (width * height)) as u32))
}

/// Returns the mean `μ` and `σ² + C2` of a photograph's planes of the given width and height.
pub(crate) fn launch_moments(gpu: &Gpu, photograph: &Buffer<f32>, size: [usize; 2]) -> [Buffer<f32>; 2] {
    let (client, values) = (&gpu.client, photograph.len);
    let columns: Buffer<f32> = Buffer::new(gpu, 3 * values);
    let [mean, variance] = [(); 2].map(|()| Buffer::new(gpu, values));
    // SAFETY: strips beyond the last plane and values beyond the line are guarded.
    unsafe {
        let (grid, dim, planes) = pass(values, size, true);
        moments_kernel::launch_unchecked(client, grid, dim, photograph.arg(), photograph.arg(), columns.arg(), planes);
        let (grid, dim, planes) = pass(values, size, false);
        photograph_kernel::launch_unchecked(client, grid, dim, columns.arg(), mean.arg(), variance.arg(), planes, 1.0);
    }
    [mean, variance]
}

/// Returns the loss, `[1]`, and, if `with_gradient` is set, its gradient, `[C, H, W]`.
pub(crate) fn launch_photometric(
    gpu: &Gpu,
    inputs: &Compared<Buffer<f32>>,
    size: [usize; 2],
    lambda: f64,
    with_gradient: bool,
) -> (Buffer<f32>, Option<Buffer<f32>>) {
    let (client, values) = (&gpu.client, inputs.image.len);
    let share = 1.0 / values as f64;
    let weights = || TermWeightsLaunch::new(((1.0 - lambda) * share) as f32, lambda as f32, share as f32, 1.0);
    let [image, truth, mean, variance] = inputs.each_ref().into_array();
    let cubes = values.div_ceil(UNITS * strip_of(false));
    let (shares, total) = (Buffer::<f32>::new(gpu, cubes), Buffer::new(gpu, 1));
    let derivatives = Buffer::<f32>::if_needed(gpu, with_gradient, 3 * values);
    let gradient = Buffer::if_needed(gpu, with_gradient, values);
    let moments: Buffer<f32> = Buffer::new(gpu, 3 * values);
    // SAFETY: strips beyond the last plane and values beyond the line are guarded.
    unsafe {
        let (grid, dim, planes) = pass(values, size, true);
        moments_kernel::launch_unchecked(client, grid, dim, image.arg(), truth.arg(), moments.arg(), planes);
        let (grid, dim, planes) = pass(values, size, false);
        index_kernel::launch_unchecked(
            client,
            grid,
            dim,
            image.arg(),
            truth.arg(),
            mean.arg(),
            variance.arg(),
            moments.arg(),
            shares.arg(),
            derivatives.as_ref().map(Buffer::arg).into(),
            planes,
            weights(),
            cubes as u32,
        );
        let (one, dim) = elementwise(1);
        total_kernel::launch_unchecked(client, one, dim, shares.arg(), total.arg(), cubes as u32);
    }
    if let (Some(derivatives), Some(gradient)) = (&derivatives, &gradient) {
        // The moments are not read again: their memory takes the derivatives' filtered columns.
        let (image, truth, filtered, gradient) = (image.arg(), truth.arg(), moments.arg(), gradient.arg());
        // SAFETY: as above.
        unsafe {
            let (grid, dim, planes) = pass(3 * values, size, true);
            columns_kernel::launch_unchecked(client, grid, dim, derivatives.arg(), moments.arg(), planes);
            let (grid, dim, planes) = pass(values, size, false);
            gradient_kernel::launch_unchecked(client, grid, dim, image, truth, filtered, gradient, planes, weights());
        };
    }
    (total, gradient)
}
