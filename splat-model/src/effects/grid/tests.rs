use burn::tensor::{Distribution, TensorData};

use super::*;
use crate::effects::{Effect, EffectContext};
use crate::gaussians::values_of;

fn picture(height: usize, width: usize, device: &Device) -> Tensor<3> {
    Tensor::random([height, width, 3], Distribution::Uniform(0.0, 1.0), device)
}

fn grid(device: &Device) -> Tensor<4> {
    Tensor::random([MAP, LEVELS, SIDE, SIDE], Distribution::Uniform(-1.0, 1.0), device)
}

fn roughness(grid: Tensor<4>) -> Tensor<1> {
    bilateral::roughness(&grid).unwrap()
}

#[test]
fn identities_change_nothing_and_cost_nothing() {
    let device = Device::flex();
    let mut grids = Grids::new(GridConfig::default(), 2, &device);
    let image = picture(7, 5, &device);
    let shown = values_of(apply(&Tensor::from_inner(image.clone()), &grids.tracked(1)).inner());
    for (shown, image) in shown.into_iter().zip(values_of(image)) {
        assert!((shown - image).abs() < 1e-6, "{shown} instead of {image}");
    }
    assert_eq!(grids.pulled(0).into_scalar::<f32>(), 0.0);
}

/// A vignette, which no single colour map represents.
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
    // Two photographs, one darkened and one brightened by the same amount: their mean is the scene.
    let truths = [image.clone() * dark.clone(), image.clone() * (dark.neg() + 2.0)];
    let tracked = Tensor::from_inner(image);
    let mut errors = Vec::new();
    let steps = 400;
    for step in 1..=steps {
        let view = step % 2;
        let shown = apply(&tracked, &grids.tracked(view));
        let error = (shown - Tensor::from_inner(truths[view].clone())).square().mean();
        errors.push(error.clone().inner().into_scalar::<f32>());
        let mut gradients = (error + grids.pulled(view)).backward();
        grids.step(&mut gradients, EffectContext { view, step, steps, verdict: None });
    }
    assert!(errors[steps - 1] < 0.02 * errors[0], "from {} to {}", errors[0], errors[steps - 1]);
    let mean = (grids.value(0) + grids.value(1)) / 2.0 - grids.neutral();
    assert!(mean.abs().max().into_scalar::<f32>() < 1e-5);
}

/// Outside of 0 to 1 a pixel uses the map of the nearest level, so that the result continues linearly.
#[test]
fn what_is_brighter_than_white_or_darker_than_black_has_a_map() {
    let device = Device::flex();
    let grid = grid(&device);
    let shown = |colour: f32, grid: &Tensor<4>| values_of(apply(&Tensor::full([5, 4, 3], colour, &device), grid));
    for (colour, level) in [(-0.5, 0), (1.5, LEVELS - 1)] {
        let alone = grid.clone().narrow(1, level, 1).repeat(&[1, LEVELS, 1, 1]);
        let ends = shown(0.0, &alone).into_iter().zip(shown(1.0, &alone));
        for (found, (black, white)) in shown(colour, &grid).into_iter().zip(ends) {
            let expected = black + colour * (white - black);
            assert!((found - expected).abs() < 1e-5, "{colour}: {found} instead of {expected}");
        }
    }
}

#[test]
fn neighbours_are_held_together_in_all_directions() {
    let device = Device::flex();
    let rising = |by: [f32; 3]| {
        let entry = |i: usize| {
            let [column, row, level] = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE) % LEVELS];
            by[0] * level as f32 + by[1] * row as f32 + by[2] * column as f32
        };
        let values: Vec<f32> = (0..MAP * LEVELS * SIDE * SIDE).map(entry).collect();
        roughness(Tensor::from_data(TensorData::new(values, [MAP, LEVELS, SIDE, SIDE]), &device)).into_scalar::<f32>()
    };
    for by in [[0.5, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.125], [0.5, 0.25, 0.125]] {
        let expected: f32 = by.iter().map(|by| by * by).sum();
        assert!((rising(by) - expected).abs() < 1e-5, "{by:?}");
    }
}

/// Two photographs, of which only one takes steps, so that the mean is not reset.
#[test]
fn a_step_is_as_long_as_its_rate_and_rough_grids_cost() {
    let device = Device::flex();
    for (step, rate) in [(1, 0.005), (10, 0.0005)] {
        let mut grids = Grids::new(GridConfig::default(), 2, &device);
        let mut up = vec![0.0; MAP * LEVELS * SIDE * SIDE];
        up[5] = 1.0;
        let up = Tensor::<4>::from_data(TensorData::new(up, [MAP, LEVELS, SIDE, SIDE]), &device);
        let mut gradients = (grids.tracked(1) * Tensor::from_inner(up)).sum().backward();
        grids.step(&mut gradients, EffectContext { view: 1, step, steps: 10, verdict: None });
        let moved = values_of(grids.value(1) - grids.neutral());
        assert!((moved[5] + rate).abs() < 1e-6 && moved.iter().filter(|moved| **moved != 0.0).count() == 1);
        let expected = 10.0 * roughness(grids.value(1)).into_scalar::<f32>();
        let found = grids.pulled(1).into_scalar::<f32>();
        assert!(expected > 0.0 && (found - expected).abs() < 1e-3 * expected, "{found} instead of {expected}");
        assert_eq!(grids.pulled(0).into_scalar::<f32>(), 0.0);
    }
}
