use burn::tensor::{DType, Device, Tensor, TensorData};

use super::cpu::{slice_backward_cpu, slice_cpu};
use super::*;
use crate::testing::finite::check_gradient;
use crate::testing::random::Random;

/// A picture whose lumas keep away from levels of the grid, where the slope jumps, and a grid; in f64.
pub(super) fn picture_and_grid(size: SliceSize) -> [Vec<f64>; 2] {
    let mut random = Random::new((size.width * 1000 + size.height) as u64);
    let mut image = random.fill(3 * size.width * size.height, -0.1, 1.1);
    let steps = (size.levels - 1) as f64;
    let pixels = size.width * size.height;
    for pixel in 0..pixels {
        let luma: f64 = (0..3).map(|channel| image[channel * pixels + pixel] * LUMA[channel]).sum();
        let level = luma * steps;
        let away = level.round() + (level - level.round()).abs().clamp(0.1, 0.5).copysign(level - level.round());
        (0..3).for_each(|channel| image[channel * pixels + pixel] += (away - level) / steps);
    }
    [image, random.fill(MAP * size.levels * size.rows * size.columns, -1.0, 1.0)]
}

/// The slice by its definition: each entry is a sum over all places of the grid.
pub(super) fn by_definition(image: &[f64], grid: &[f64], size: SliceSize) -> Vec<f64> {
    let hat = |at: usize, to: f64| (1.0 - (to - at as f64).abs()).max(0.0);
    let pixels = size.width * size.height;
    let mut out = vec![0.0; image.len()];
    for pixel in 0..pixels {
        let colour = [0, 1, 2].map(|channel| image[channel * pixels + pixel]);
        let (x, y) = (pixel % size.width, pixel / size.width);
        let x = (x as f64 + 0.5) / size.width as f64 * (size.columns - 1) as f64;
        let y = (y as f64 + 0.5) / size.height as f64 * (size.rows - 1) as f64;
        let luma: f64 = colour.iter().zip(LUMA).map(|(value, weight)| value * weight).sum();
        let z = luma.clamp(0.0, 1.0) * (size.levels - 1) as f64;
        let mut map = [0.0; MAP];
        for (index, value) in grid.iter().enumerate() {
            let (column, row) = (index % size.columns, index / size.columns % size.rows);
            let level = index / (size.columns * size.rows) % size.levels;
            map[index / (size.columns * size.rows * size.levels)] +=
                value * hat(column, x) * hat(row, y) * hat(level, z);
        }
        for (channel, row) in map.chunks_exact(4).enumerate() {
            out[channel * pixels + pixel] = row[0] * colour[0] + row[1] * colour[1] + row[2] * colour[2] + row[3];
        }
    }
    out
}

pub(super) const SIZES: [SliceSize; 4] = [
    SliceSize { width: 9, height: 23, levels: 8, rows: 16, columns: 16 },
    SliceSize { width: 40, height: 3, levels: 2, rows: 2, columns: 5 },
    SliceSize { width: 1, height: 1, levels: 3, rows: 2, columns: 2 },
    SliceSize { width: 33, height: 18, levels: 4, rows: 3, columns: 2 },
];

#[test]
fn a_pixel_has_the_map_at_its_place_and_brightness() {
    for size in SIZES {
        let [image, grid] = picture_and_grid(size);
        let found = slice_cpu(Sliced { image: &image[..], grid: &grid[..] }, size);
        for (found, expected) in found.iter().zip(by_definition(&image, &grid, size)) {
            assert!((found - expected).abs() < 1e-12, "{size:?}: {found} instead of {expected}");
        }
    }
}

#[test]
fn gradients_are_the_differences_of_the_definition() {
    for size in SIZES {
        let [image, grid] = picture_and_grid(size);
        let weights = Random::new(7).fill(image.len(), -1.0, 1.0);
        let total = |image: &[f64], grid: &[f64]| -> f64 {
            by_definition(image, grid, size).iter().zip(&weights).map(|(value, weight)| value * weight).sum()
        };
        let inputs = Sliced { image: &image[..], grid: &grid[..] };
        let found = slice_backward_cpu(inputs, &weights, size, Sliced { image: true, grid: true });
        let by = 1e-6;
        for (what, values, gradient) in [("image", &image, &found.image), ("grid", &grid, &found.grid)] {
            assert_eq!(gradient.len(), values.len());
            for i in (0..values.len()).step_by(values.len().div_ceil(150)) {
                let moved = |by: f64| {
                    let mut values = values.clone();
                    values[i] += by;
                    if what == "image" { total(&values, &grid) } else { total(&image, &values) }
                };
                let expected = (moved(by) - moved(-by)) / (2.0 * by);
                let error = (gradient[i] - expected).abs();
                assert!(error < 1e-7, "{size:?}, {what} {i}: {} instead of {expected}", gradient[i]);
            }
        }
    }
}

#[test]
fn roughness_is_the_mean_squared_difference_of_neighbours_with_its_derivative() {
    for size in SIZES {
        let [_, grid] = picture_and_grid(size);
        let SliceSize { levels, rows, columns, .. } = size;
        let by_definition = |grid: &[f64]| -> f64 {
            let at = |i: usize| [i / (rows * columns) % levels, i / columns % rows, i % columns];
            let along = |axis: usize, count: usize, stride: usize| {
                let lower: Vec<usize> = (0..grid.len()).filter(|&i| at(i)[axis] + 1 < count).collect();
                lower.iter().map(|&i| (grid[i + stride] - grid[i]).powi(2)).sum::<f64>() / lower.len() as f64
            };
            along(0, levels, rows * columns) + along(1, rows, columns) + along(2, columns, 1)
        };
        let data = TensorData::new(grid.clone(), [MAP, levels, rows, columns]);
        let tracked = Tensor::<4>::from_data(data, (&Device::flex(), DType::F64));
        let tracked = Tensor::from_inner(tracked).require_grad();
        let value = super::roughness(&tracked).unwrap();
        let gradient = tracked.grad(&value.backward()).expect("tracked").into_data().try_to_vec::<f64>().unwrap();
        let value = value.into_scalar::<f64>();
        assert!((value / by_definition(&grid) - 1.0).abs() < 1e-12, "{size:?}: {value}");
        check_gradient("roughness", &grid, &gradient, 1 + grid.len() / 150, by_definition);
    }
}

#[test]
fn roughness_is_differentiable_where_it_is_tracked() {
    let device = Device::flex();
    let grid = Tensor::<1, burn::tensor::Int>::arange(0..96, &device).float().reshape([12, 2, 2, 2]);
    let expected = 16.0 + 4.0 + 1.0;
    assert_eq!(super::roughness(&grid).unwrap().into_scalar::<f32>(), expected);
    let tracked = Tensor::from_inner(grid).require_grad();
    let value = super::roughness(&tracked).unwrap() * 2.0;
    let gradient = tracked.grad(&value.backward()).unwrap();
    assert_eq!(value.into_scalar::<f32>(), 2.0 * expected);
    // Each of 48 differences along the levels is 4, and 2 · 2 · 4/48 for the upper neighbour.
    let first = gradient.into_data().try_to_vec::<f32>().unwrap()[0];
    assert!((first + 4.0 * (4.0 + 2.0 + 1.0) / 48.0).abs() < 1e-6, "{first}");
    assert!(super::roughness(&Tensor::zeros([9, 2, 2, 2], &device)).is_err());
}

#[test]
fn threads_change_no_bit() {
    let size = SliceSize { width: 61, height: 90, levels: 8, rows: 16, columns: 16 };
    let [image, grid] = picture_and_grid(size).map(|values| crate::testing::ceiling::to_f32(&values));
    let inputs = Sliced { image: &image[..], grid: &grid[..] };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| slice_backward_cpu(inputs, &image, size, Sliced { image: true, grid: true }))
    };
    let (one, five) = (run(1), run(5));
    assert!(one.image == five.image && one.grid == five.grid);
}

#[test]
fn tensors_of_other_shapes_are_refused() {
    let device = Device::flex();
    let zeros = |image: [usize; 3], grid: [usize; 4]| {
        slice(&Tensor::zeros(image, &device), &Tensor::zeros(grid, &device)).map(|out| out.dims())
    };
    assert_eq!(zeros([4, 5, 3], [12, 2, 2, 2]), Ok([4, 5, 3]));
    assert_eq!(zeros([0, 5, 3], [12, 2, 2, 2]), Ok([0, 5, 3]));
    for (image, grid) in [([4, 5, 4], [12, 2, 2, 2]), ([4, 5, 3], [9, 2, 2, 2]), ([4, 5, 3], [12, 2, 1, 2])] {
        assert!(matches!(zeros(image, grid), Err(SplatError::Shape { .. })), "{image:?}, {grid:?}");
    }
}

#[test]
fn only_tracked_inputs_get_a_gradient() {
    let device = Device::flex().autodiff();
    let size = SliceSize { width: 4, height: 3, levels: 2, rows: 2, columns: 2 };
    let [image, grid] = picture_and_grid(size);
    let image = Tensor::<3>::from_data(TensorData::new(image, [3, 4, 3]), &device);
    let grid = Tensor::<4>::from_data(TensorData::new(grid, [12, 2, 2, 2]), &device);
    let (tracked_image, tracked_grid) = (image.clone().require_grad(), grid.clone().require_grad());
    let gradients = |image: &Tensor<3>, grid: &Tensor<4>| slice(image, grid).unwrap().sum().backward();
    let of_image = gradients(&tracked_image, &grid);
    assert!(tracked_image.grad(&of_image).is_some());
    let of_grid = gradients(&image, &tracked_grid);
    assert_eq!(tracked_grid.grad(&of_grid).map(|grad| grad.dims()), Some([12, 2, 2, 2]));
}
