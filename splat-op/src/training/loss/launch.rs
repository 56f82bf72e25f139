//! Launches of the loss.

use super::forward::{
    PlanesLaunch, TermWeightsLaunch, columns_kernel, gradient_kernel, index_kernel, moments_kernel, photograph_kernel,
    strip_of, total_kernel,
};
use super::taps::Compared;
use crate::gpu::{Buffer, Dispatch, Gpu, UNITS, launch_unchecked};

/// Returns the dispatch and the planes of a pass over `values` values.
fn pass(gpu: &Gpu, values: usize, [width, height]: [usize; 2], vertical: bool) -> (Dispatch<'_>, PlanesLaunch) {
    let len = if vertical { height } else { width };
    let dispatch = gpu.units(values / len * len.div_ceil(strip_of(vertical)));
    (dispatch, PlanesLaunch::new(width as u32, height as u32, (values / (width * height)) as u32))
}

/// Returns the mean `μ` and `σ² + C2` of a photograph's planes of the given width and height.
pub(crate) fn launch_moments(gpu: &Gpu, photograph: &Buffer<f32>, size: [usize; 2]) -> [Buffer<f32>; 2] {
    let values = photograph.len;
    let columns: Buffer<f32> = Buffer::new(gpu, 3 * values);
    let [mean, variance] = [(); 2].map(|()| Buffer::new(gpu, values));
    let (dispatch, planes) = pass(gpu, values, size, true);
    // SAFETY: strips beyond the last plane and values beyond the line are guarded, here and below.
    launch_unchecked!(dispatch, moments_kernel(photograph, photograph, &columns, planes));
    let (dispatch, planes) = pass(gpu, values, size, false);
    launch_unchecked!(dispatch, photograph_kernel(&columns, &mean, &variance, planes, 1.0_f32));
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
    let values = inputs.image.len;
    let share = 1.0 / values as f64;
    let weights = || TermWeightsLaunch::new(((1.0 - lambda) * share) as f32, lambda as f32, share as f32, 1.0);
    let Compared { image, truth, mean, variance } = inputs;
    let cubes = values.div_ceil(UNITS * strip_of(false));
    let (shares, total) = (Buffer::<f32>::new(gpu, cubes), Buffer::new(gpu, 1));
    let derivatives = Buffer::<f32>::if_needed(gpu, with_gradient, 3 * values);
    let gradient = Buffer::if_needed(gpu, with_gradient, values);
    let moments: Buffer<f32> = Buffer::new(gpu, 3 * values);
    let (dispatch, planes) = pass(gpu, values, size, true);
    // SAFETY: strips beyond the last plane and values beyond the line are guarded, here and below.
    launch_unchecked!(dispatch, moments_kernel(image, truth, &moments, planes));
    let (dispatch, planes) = pass(gpu, values, size, false);
    launch_unchecked!(
        dispatch,
        index_kernel(image, truth, mean, variance, &moments, &shares, &derivatives, planes, weights(), cubes)
    );
    launch_unchecked!(gpu.units(1), total_kernel(&shares, &total, cubes));
    if let (Some(derivatives), Some(gradient)) = (&derivatives, &gradient) {
        // The moments are not read again: their memory takes the derivatives' filtered columns.
        let (dispatch, planes) = pass(gpu, 3 * values, size, true);
        launch_unchecked!(dispatch, columns_kernel(derivatives, &moments, planes));
        let (dispatch, planes) = pass(gpu, values, size, false);
        launch_unchecked!(dispatch, gradient_kernel(image, truth, &moments, gradient, planes, weights()));
    }
    (total, gradient)
}
