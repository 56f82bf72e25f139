//! Launches of the slice.

use super::kernels::{SizesLaunch, grid_backward_kernel, image_backward_kernel, slice_kernel};
use super::{SliceSize, Sliced};
use crate::gpu::{Buffer, Gpu, launch_unchecked};

fn sizes(size: SliceSize) -> SizesLaunch {
    let SliceSize { width, height, levels, rows, columns } = size;
    SizesLaunch::new(width as u32, height as u32, levels as u32, rows as u32, columns as u32)
}

/// Returns the mapped picture, `[3, H, W]`.
pub(crate) fn launch_slice(gpu: &Gpu, inputs: &Sliced<Buffer<f32>>, size: SliceSize) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.image.len);
    // SAFETY: units beyond the last pixel do nothing, and a pixel's corners are limited to the grid.
    launch_unchecked!(gpu.units(out.len / 3), slice_kernel(&inputs.image, &inputs.grid, &out, sizes(size)));
    out
}

/// Returns the gradients that are needed from `grad`, that of the mapped picture.
pub(crate) fn launch_slice_backward(
    gpu: &Gpu,
    inputs: &Sliced<Buffer<f32>>,
    grad: &Buffer<f32>,
    size: SliceSize,
    needs: Sliced<bool>,
) -> Sliced<Option<Buffer<f32>>> {
    let found = Sliced {
        image: Buffer::if_needed(gpu, needs.image, inputs.image.len),
        grid: Buffer::if_needed(gpu, needs.grid, inputs.grid.len),
    };
    if let Some(out) = &found.image {
        let Sliced { image, grid } = inputs;
        // SAFETY: as in `launch_slice`.
        launch_unchecked!(gpu.units(out.len / 3), image_backward_kernel(image, grid, grad, out, sizes(size)));
    }
    if let Some(out) = &found.grid {
        let places = gpu.cubes(size.levels * size.rows * size.columns);
        // SAFETY: cubes beyond the last place do nothing, and the pixels of a place are limited to the picture.
        launch_unchecked!(places, grid_backward_kernel(&inputs.image, grad, out, sizes(size)));
    }
    found
}
