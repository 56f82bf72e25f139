//! Bilinear resampling as an operation. Its gradient, which sums in a fixed order, is found by the table's transpose.

#[cfg(feature = "cube")]
use cubecl::prelude::*;

#[cfg(feature = "cube")]
use crate::backend::cube::gpu_outputs;
use crate::backend::host::float_outputs;
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::{Buffer, elementwise};
use crate::tasks;

/// Number of rows per task.
const CHUNK: usize = 4096;

/// Takes the pixels of some pictures, `[T, K]`, and the tables of [`Tables`](super::Tables): fractions, corners, starts and entries.
/// Returns the resampled pixels, `[P, K]`.
#[derive(Clone, Debug)]
pub(super) struct Resample {
    /// Width of the pictures, px.
    pub row: usize,
}

/// Distance of a corner from the first of four, px.
pub(super) fn offset(corner: usize, row: usize) -> usize {
    corner % 2 + corner / 2 * row
}

fn weight<F: Real>(fractions: &[F], pixel: usize, corner: usize) -> F {
    let (x, y) = (fractions[2 * pixel], fractions[2 * pixel + 1]);
    (if corner % 2 == 1 { x } else { F::ONE - x }) * (if corner / 2 == 1 { y } else { F::ONE - y })
}

/// Returns `count` rows of `columns` numbers, each the sum of the rows of `from` that `terms` gives with their weights.
fn sums<F: Real, T: Iterator<Item = (usize, F)>>(
    count: usize,
    columns: usize,
    from: &[F],
    terms: impl Fn(usize) -> T + Sync,
) -> Vec<F> {
    let mut all = vec![F::ZERO; count * columns];
    tasks::for_each(all.chunks_mut(CHUNK * columns), |chunk, rows| {
        for (i, row) in rows.chunks_exact_mut(columns).enumerate() {
            for (at, weight) in terms(chunk * CHUNK + i) {
                let from = &from[at * columns..(at + 1) * columns];
                row.iter_mut().zip(from).for_each(|(sum, value)| *sum += weight * *value);
            }
        }
    });
    all
}

impl Operation for Resample {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let [Some(texels), Some(fractions), ..] = inputs else { unreachable!("the caller gives both") };
        vec![Some(texels.with_shape([fractions.shape[0], texels.shape[1]]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let ([texels, fractions], corners) = (args.all::<F, 2>(), args.ints(2));
        let terms = |pixel: usize| {
            let (first, fractions) = (corners[pixel] as usize, &fractions);
            (0..4).map(move |corner| (first + offset(corner, self.row), weight(fractions, pixel, corner)))
        };
        float_outputs([sums(corners.len(), args.shape(0)[1], &texels, terms)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, [texels, fractions], corners) = (args.gpu(), args.all(), args.buffer::<i32>(2));
        let columns = args.shape(0)[1];
        let out = Buffer::<f32>::new(&gpu, corners.len * columns);
        let (grid, dim) = elementwise(out.len);
        let (count, columns, row) = (out.len as u32, columns as u32, self.row as u32);
        let [texels, fractions] = [&texels, &fractions].map(Buffer::arg);
        // SAFETY: units beyond the last number do nothing, and corners lie within the pictures.
        unsafe {
            let (client, corners, out) = (&gpu.client, corners.arg(), out.arg());
            resample_kernel::launch_unchecked(client, grid, dim, texels, fractions, corners, out, row, columns, count);
        }
        gpu_outputs([out])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (fractions, starts, entries) = (args.floats::<F>(1), args.ints(3), args.ints(4));
        let terms = |texel: usize| {
            let entries = &entries[starts[texel] as usize..starts[texel + 1] as usize];
            let of = |&entry: &i32| (entry as usize / 4, weight(&fractions, entry as usize / 4, entry as usize % 4));
            entries.iter().map(of)
        };
        let grad = sums(starts.len() - 1, args.shape(0)[1], &args.only_grad(), terms);
        let mut outputs = float_outputs([grad]);
        outputs.resize_with(5, || HostOutput::Nothing);
        outputs
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, fractions, grad) = (args.gpu(), args.buffer::<f32>(1), args.only_grad());
        let [starts, entries] = [3, 4].map(|i| args.buffer::<i32>(i));
        let columns = args.shape(0)[1];
        let out = Buffer::<f32>::new(&gpu, (starts.len - 1) * columns);
        let (grid, dim) = elementwise(out.len);
        let (count, columns) = (out.len as u32, columns as u32);
        let [grad, fractions, to] = [&grad, &fractions, &out].map(Buffer::arg);
        // SAFETY: units beyond the last number do nothing, and entries are those of the picture.
        unsafe {
            let (client, starts, entries) = (&gpu.client, starts.arg(), entries.arg());
            transposed_kernel::launch_unchecked(client, grid, dim, grad, fractions, starts, entries, to, columns, count);
        }
        vec![Some(out.handle), None, None, None, None]
    }
}

#[cfg(feature = "cube")]
#[cube]
fn weight_of(fractions: &[f32], pixel: usize, corner: usize) -> f32 {
    let (x, y) = (fractions[2 * pixel], fractions[2 * pixel + 1]);
    select(corner % 2 == 1, x, 1.0 - x) * select(corner / 2 == 1, y, 1.0 - y)
}

/// A unit per pixel and column.
#[cfg(feature = "cube")]
#[cube(launch_unchecked)]
fn resample_kernel(
    texels: &[f32],
    fractions: &[f32],
    corners: &[i32],
    out: &mut [f32],
    row: u32,
    columns: u32,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let (pixel, column) = (ABSOLUTE_POS / columns as usize, ABSOLUTE_POS % columns as usize);
        let first = corners[pixel] as usize;
        let mut sum = 0.0f32;
        #[unroll]
        for corner in 0..4usize {
            let texel = first + corner % 2 + corner / 2 * row as usize;
            sum += weight_of(fractions, pixel, corner) * texels[texel * columns as usize + column];
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// A unit per pixel of the faces and column.
#[cfg(feature = "cube")]
#[cube(launch_unchecked)]
fn transposed_kernel(
    grad: &[f32],
    fractions: &[f32],
    starts: &[i32],
    entries: &[i32],
    out: &mut [f32],
    columns: u32,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let (texel, column) = (ABSOLUTE_POS / columns as usize, ABSOLUTE_POS % columns as usize);
        let mut sum = 0.0f32;
        let mut at = starts[texel];
        while at < starts[texel + 1] {
            let entry = entries[at as usize] as usize;
            sum += weight_of(fractions, entry / 4, entry % 4) * grad[entry / 4 * columns as usize + column];
            at += 1;
        }
        out[ABSOLUTE_POS] = sum;
    }
}
