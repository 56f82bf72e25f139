//! The slice as tensor code, by its definition.

use burn::tensor::{DType, Int, Tensor, TensorData};

use super::{LUMA, MAP};

/// The mapped picture, `[3, H, W]`, of planes `[3, H, W]`. Takes 96 numbers per pixel.
pub(super) fn slice(planes: Tensor<3>, grid: Tensor<4>) -> Tensor<3> {
    let ([_, height, width], levels) = (planes.dims(), grid.dims()[1]);
    let options = (&planes.device(), planes.dtype());
    let luma = Tensor::<3>::from_data(TensorData::new(LUMA.to_vec(), [3, 1, 1]), options);
    let luma = (planes.clone() * luma).sum_dim(0).clamp(0.0, 1.0);
    let places: Vec<f64> = (0..levels).map(|level| level as f64).collect();
    let places = Tensor::<3>::from_data(TensorData::new(places, [levels, 1, 1]), options);
    let of_levels = ((luma * (levels - 1) as f64 - places).abs().neg() + 1.0).clamp_min(0.0);
    let maps = stretched(stretched(grid, 3, width), 2, height);
    let map = (maps * of_levels.unsqueeze_dim(0)).sum_dim(1).reshape([MAP / 4, 4, height, width]);
    let colours = Tensor::cat(vec![planes, Tensor::ones([1, height, width], options)], 0);
    (map * colours.unsqueeze_dim(0)).sum_dim(1).squeeze_dim(1)
}

/// The grid at the centres of so many pixels along one of its sides.
fn stretched(grid: Tensor<4>, side: usize, pixels: usize) -> Tensor<4> {
    let last = grid.dims()[side] - 1;
    let at = |pixel: usize| (pixel as f64 + 0.5) / pixels as f64 * last as f64;
    let below: Vec<i32> = (0..pixels).map(|pixel| (at(pixel) as usize).min(last - 1) as i32).collect();
    let share: Vec<f64> = below.iter().enumerate().map(|(pixel, below)| at(pixel) - f64::from(*below)).collect();
    let mut shape = [1; 4];
    shape[side] = pixels;
    let share = Tensor::<4>::from_data(TensorData::new(share, shape), (&grid.device(), grid.dtype()));
    let below = Tensor::<1, Int>::from_data(TensorData::new(below, [pixels]), (&grid.device(), DType::I32));
    let (low, high) = (grid.clone().select(side, below.clone()), grid.select(side, below + 1));
    low.clone() + (high - low) * share
}
