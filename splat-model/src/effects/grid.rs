//! What a camera's own processing does to a photograph: an affine map of colours that varies over the picture and with
//! brightness, a bilateral grid (Chen, Paris and Durand 2007) for each photograph, learnt beside the scene (Wang et al. 2024,
//! "Bilateral Guided Radiance Field Processing", section 4).
//!
//! The grid holds a map `[3, 4]` at each of 16 × 16 places of the picture and 8 levels of brightness. A pixel takes the map
//! that trilinear interpolation finds at its place and at the luma of the render there (Rec. 601), which is followed by the
//! gradient too. Grids begin as the identity and are held together by the mean squared difference of neighbours, weight 10 as
//! in the source's code. It is the stronger form of an [exposure](super::exposure), which is the same map everywhere; as there
//! the mean of all grids is set back to the identity.
//!
//! Interpolation is separable, so it is two products with matrices that have two non-zero entries per column, then a sum
//! over the levels with hat functions as weights: no gather, and no scatter in the backward pass. It takes 96 numbers per
//! pixel, 400 MB per megapixel, and as much again for gradients.

use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use super::centred::Centred;
use super::learned::{Falling, Moment};
use crate::state::{State, StateError};

/// Places along a side of the picture.
const SIDE: usize = 16;

/// Levels of brightness.
const LEVELS: usize = 8;

/// Numbers of a map.
const MAP: usize = 12;

/// Luma of RGB, Rec. 601, as the source has it.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// How grids are learnt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GridConfig {
    /// Learning rate: from 0.005 to 0.0005.
    pub rate: Falling,
    /// Weight of the mean squared difference between neighbours: 10.
    pub smoothness: f64,
}

impl Default for GridConfig {
    fn default() -> Self {
        Self { rate: Falling { from: 0.005, to: 0.0005 }, smoothness: 10.0 }
    }
}

/// The grids of all photographs of a run.
pub struct Grids {
    config: GridConfig,
    /// `[MAP, LEVELS, SIDE, SIDE]` each, levels from dark to bright, then rows and columns of the picture.
    grids: Centred<4>,
}

impl Grids {
    /// Identities, for so many photographs, on `device`.
    pub fn new(config: GridConfig, views: usize, device: &Device) -> Self {
        let diagonal = |entry: usize| if entry.is_multiple_of(5) { 1.0 } else { 0.0 };
        let entries: Vec<f32> = (0..MAP).map(diagonal).collect();
        let identity = Tensor::<1>::from_floats(entries.as_slice(), device).reshape([MAP, 1, 1, 1]);
        let identity = identity.repeat(&[1, LEVELS, SIDE, SIDE]);
        Self { config, grids: Centred::new(identity, views) }
    }

    /// What the photograph `view` shows of a render, both `[H, W, 3]`.
    pub fn apply(&self, image: Tensor<3>, view: usize) -> Tensor<3> {
        apply(image, self.grids.tracked(view))
    }

    /// What is added to the loss of a step on `view`, `[1]`.
    pub fn penalty(&self, view: usize) -> Tensor<1> {
        let grid = self.grids.tracked(view);
        let along = |dim: usize, count: usize| {
            let difference = grid.clone().narrow(dim, 1, count - 1) - grid.clone().narrow(dim, 0, count - 1);
            difference.square().mean()
        };
        (along(1, LEVELS) + along(2, SIDE) + along(3, SIDE)) * self.config.smoothness
    }

    /// Takes the gradient of a view's grid out of those of a loss.
    pub fn take_gradient(&self, view: usize, gradients: &mut burn::tensor::Gradients) -> Option<Tensor<4>> {
        self.grids.take_gradient(view, gradients)
    }

    /// Adam's step on the grid of the photograph.
    pub fn step(&mut self, gradient: Tensor<4>, at: Moment) {
        self.grids.step(gradient, self.config.rate.at(at.step, at.steps), at);
    }

    /// Keeps what was learnt.
    ///
    /// # Errors
    /// None that is to be expected.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.grids.save(to)
    }

    /// Goes on from what was kept.
    ///
    /// # Errors
    /// If something is missing or of another shape.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        self.grids.load(from)
    }

    /// Bytes of the grids and their moments.
    pub fn bytes(&self) -> usize {
        self.grids.bytes()
    }
}

/// `[SIDE, pixels]`: the share of each place of the grid in each pixel along a side. The grid's ends lie on the picture's.
fn hats(pixels: usize, device: &Device) -> Tensor<2> {
    let mut values = vec![0.0_f32; SIDE * pixels];
    for pixel in 0..pixels {
        let at = (pixel as f64 + 0.5) / pixels as f64 * (SIDE - 1) as f64;
        let below = (at as usize).min(SIDE - 2);
        let share = (at - below as f64) as f32;
        values[below * pixels + pixel] = 1.0 - share;
        values[(below + 1) * pixels + pixel] = share;
    }
    Tensor::from_data(TensorData::new(values, [SIDE, pixels]), device)
}

/// Every pixel of `image`, `[H, W, 3]`, mapped by `grid`, `[12, 8, 16, 16]`; differentiable in both.
pub fn apply(image: Tensor<3>, grid: Tensor<4>) -> Tensor<3> {
    let [height, width, channels] = image.dims();
    let plain = image.device().inner();
    let constant = |values: Tensor<2>| if grid.is_autodiff() { Tensor::from_inner(values) } else { values };
    let (across, down) = (constant(hats(width, &plain)), constant(hats(height, &plain)));
    // Columns: [12·8·16, 16] × [16, W]. Rows: [H, 16] × [16, 12·8·W].
    let columns = grid.clone().reshape([MAP * LEVELS * SIDE, SIDE]).matmul(across).reshape([MAP * LEVELS, SIDE, width]);
    let columns = columns.permute([1, 0, 2]).reshape([SIDE, MAP * LEVELS * width]);
    let maps = down.transpose().matmul(columns).reshape([height, MAP, LEVELS, width]);
    // [H, 3, W]: rows of planes, as the maps lie.
    let colours = image.permute([0, 2, 1]);
    let luma = Tensor::<1>::from_floats(LUMA, &plain).reshape([1, channels, 1]);
    let luma = if colours.is_autodiff() { Tensor::from_inner(luma) } else { luma };
    let luma = (colours.clone() * luma).sum_dim(1).clamp(0.0, 1.0) * (LEVELS - 1) as f32;
    let mut map: Option<Tensor<3>> = None;
    for level in 0..LEVELS {
        let share = ((luma.clone() - level as f32).abs().neg() + 1.0).clamp_min(0.0);
        let part = maps.clone().narrow(2, level, 1).reshape([height, MAP, width]) * share;
        map = Some(map.map_or(part.clone(), |map| map + part));
    }
    let map = map.expect("there are levels").reshape([height, channels, channels + 1, width]);
    let linear = map.clone().narrow(2, 0, channels) * colours.unsqueeze_dim::<4>(1);
    let shown = linear.sum_dim(2) + map.narrow(2, channels, 1);
    shown.reshape([height, channels, width]).permute([0, 2, 1])
}

#[cfg(test)]
mod tests {
    use burn::tensor::Distribution;

    use super::*;
    use crate::gaussians::values_of;

    fn picture(height: usize, width: usize, device: &Device) -> Tensor<3> {
        Tensor::random([height, width, 3], Distribution::Uniform(0.0, 1.0), device)
    }

    fn grid(device: &Device) -> Tensor<4> {
        Tensor::random([MAP, LEVELS, SIDE, SIDE], Distribution::Uniform(-1.0, 1.0), device)
    }

    /// Trilinear interpolation, pixel by pixel.
    #[test]
    fn a_pixel_takes_the_map_at_its_place_and_brightness() {
        let device = Device::flex();
        let (height, width) = (23, 9);
        let (image, grid) = (picture(height, width, &device), grid(&device));
        let found = values_of(apply(image.clone(), grid.clone()));
        let (image, grid) = (values_of(image), values_of(grid));
        for y in 0..height {
            for x in 0..width {
                let colour = &image[3 * (y * width + x)..][..3];
                let luma: f32 = (0..3).map(|c| LUMA[c] * colour[c]).sum();
                let at = [
                    f64::from(luma) * (LEVELS - 1) as f64,
                    (y as f64 + 0.5) / height as f64 * (SIDE - 1) as f64,
                    (x as f64 + 0.5) / width as f64 * (SIDE - 1) as f64,
                ];
                let entry = |map: usize| {
                    let mut sum = 0.0;
                    for corner in 0..8 {
                        let of = [corner >> 2, corner >> 1 & 1, corner & 1];
                        let place: Vec<usize> = (0..3).map(|i| at[i].floor() as usize + of[i]).collect();
                        let share: f64 = (0..3).map(|i| 1.0 - (at[i] - place[i] as f64).abs()).product();
                        let index = ((map * LEVELS + place[0].min(LEVELS - 1)) * SIDE + place[1]) * SIDE + place[2];
                        sum += share * f64::from(grid[index]);
                    }
                    sum
                };
                for channel in 0..3 {
                    let linear: f64 = (0..3).map(|k| entry(4 * channel + k) * f64::from(colour[k])).sum();
                    let (expected, found) = (linear + entry(4 * channel + 3), found[3 * (y * width + x) + channel]);
                    assert!((f64::from(found) - expected).abs() < 1e-5, "({x}, {y}): {found} instead of {expected}");
                }
            }
        }
    }

    #[test]
    fn identities_change_nothing_and_cost_nothing() {
        let device = Device::flex();
        let grids = Grids::new(GridConfig::default(), 2, &device);
        let image = picture(7, 5, &device);
        let shown = values_of(grids.apply(Tensor::from_inner(image.clone()), 1).inner());
        for (shown, image) in shown.into_iter().zip(values_of(image)) {
            assert!((shown - image).abs() < 1e-6, "{shown} instead of {image}");
        }
        assert_eq!(grids.penalty(0).into_scalar::<f32>(), 0.0);
    }

    /// The gradient to the render goes through its brightness too: against finite differences.
    #[test]
    fn gradients_follow_the_brightness() {
        let device = Device::flex();
        let (image, grid) = (picture(4, 3, &device), grid(&device));
        let weights = picture(4, 3, &device);
        let value = |image: Tensor<3>| {
            values_of((apply(image, grid.clone()) * weights.clone()).sum_dim(1))
                .iter()
                .map(|&v| f64::from(v))
                .sum::<f64>()
        };
        let tracked = Tensor::from_inner(image.clone()).require_grad();
        let shown = apply(tracked.clone(), Tensor::from_inner(grid.clone()));
        let gradient =
            values_of(tracked.grad(&(shown * Tensor::from_inner(weights.clone())).sum().backward()).unwrap());
        let by = 2e-3;
        for i in 0..36 {
            let moved = |by: f32| {
                let mut values = values_of(image.clone());
                values[i] += by;
                value(Tensor::from_data(TensorData::new(values, [4, 3, 3]), &device))
            };
            let expected = (moved(by) - moved(-by)) / f64::from(2.0 * by);
            // A pixel may cross from one level to the next, where the slope jumps.
            let near = (f64::from(gradient[i]) - expected).abs() < 0.02 * expected.abs().max(1.0);
            let luma: f32 = (0..3).map(|c| LUMA[c] * values_of(image.clone())[i / 3 * 3 + c]).sum::<f32>() * 7.0;
            assert!(near || (luma - luma.round()).abs() < 0.02, "{i}: {} instead of {expected}", gradient[i]);
        }
    }

    /// A vignette, which no single map of colours explains.
    #[test]
    fn a_vignette_is_found() {
        let device = Device::flex();
        let (height, width) = (24, 32);
        let image = picture(height, width, &device);
        let dark: Vec<f32> = (0..height * width)
            .map(|i| {
                let [x, y] = [(i % width) as f32 / width as f32 - 0.5, (i / width) as f32 / height as f32 - 0.5];
                1.0 - 0.8 * (x * x + y * y)
            })
            .collect();
        let dark = Tensor::<3>::from_data(TensorData::new(dark, [height, width, 1]), &device);
        let config = GridConfig { smoothness: 0.1, ..GridConfig::default() };
        let mut grids = Grids::new(config, 2, &device);
        // Two photographs, one darkened and one brightened as much: their mean is the scene.
        let truths = [image.clone() * dark.clone(), image.clone() * (dark.neg() + 2.0)];
        let tracked = Tensor::from_inner(image);
        let mut errors = Vec::new();
        let steps = 400;
        for step in 1..=steps {
            let view = step % 2;
            let shown = grids.apply(tracked.clone(), view);
            let error = (shown - Tensor::from_inner(truths[view].clone())).square().mean();
            errors.push(error.clone().inner().into_scalar::<f32>());
            let mut gradients = (error + grids.penalty(view)).backward();
            let gradient = grids.take_gradient(view, &mut gradients).unwrap();
            grids.step(gradient, Moment { view, step, steps, verdict: None });
        }
        assert!(errors[steps - 1] < 0.02 * errors[0], "from {} to {}", errors[0], errors[steps - 1]);
        let mean = (grids.grids.value(0) + grids.grids.value(1)) / 2.0 - grids.grids.neutral();
        assert!(mean.abs().max().into_scalar::<f32>() < 1e-5);
        assert_eq!(grids.bytes(), 2 * 3 * 4 * MAP * LEVELS * SIDE * SIDE);
    }
}
