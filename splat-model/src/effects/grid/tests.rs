use burn::tensor::Distribution;

use super::*;
use crate::gaussians::values_of;

fn picture(height: usize, width: usize, device: &Device) -> Tensor<3> {
    Tensor::random([height, width, 3], Distribution::Uniform(0.0, 1.0), device)
}

fn grid(device: &Device) -> Tensor<4> {
    Tensor::random([MAP, LEVELS, SIDE, SIDE], Distribution::Uniform(-1.0, 1.0), device)
}

/// Compares with trilinear interpolation, pixel by pixel.
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
    let mut grids = Grids::new(GridConfig::default(), 2, &device);
    let image = picture(7, 5, &device);
    let shown = values_of(apply(Tensor::from_inner(image.clone()), grids.grids.tracked(1)).inner());
    for (shown, image) in shown.into_iter().zip(values_of(image)) {
        assert!((shown - image).abs() < 1e-6, "{shown} instead of {image}");
    }
    assert_eq!(grids.pull(0).into_scalar::<f32>(), 0.0);
}

/// The gradient with respect to the render includes its luma. Compared with finite differences.
#[test]
fn gradients_follow_the_brightness() {
    let device = Device::flex();
    let (image, grid) = (picture(4, 3, &device), grid(&device));
    let weights = picture(4, 3, &device);
    let value = |image: Tensor<3>| {
        values_of((apply(image, grid.clone()) * weights.clone()).sum_dim(1)).iter().map(|&v| f64::from(v)).sum::<f64>()
    };
    let tracked = Tensor::from_inner(image.clone()).require_grad();
    let shown = apply(tracked.clone(), Tensor::from_inner(grid.clone()));
    let gradient = values_of(tracked.grad(&(shown * Tensor::from_inner(weights.clone())).sum().backward()).unwrap());
    let by = 2e-3;
    for i in 0..36 {
        let moved = |by: f32| {
            let mut values = values_of(image.clone());
            values[i] += by;
            value(Tensor::from_data(TensorData::new(values, [4, 3, 3]), &device))
        };
        let expected = (moved(by) - moved(-by)) / f64::from(2.0 * by);
        // A finite difference may cross from one level to the next, where the slope jumps.
        let near = (f64::from(gradient[i]) - expected).abs() < 0.02 * expected.abs().max(1.0);
        let luma: f32 = (0..3).map(|c| LUMA[c] * values_of(image.clone())[i / 3 * 3 + c]).sum::<f32>() * 7.0;
        assert!(near || (luma - luma.round()).abs() < 0.02, "{i}: {} instead of {expected}", gradient[i]);
    }
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
        let shown = apply(tracked.clone(), grids.grids.tracked(view));
        let error = (shown - Tensor::from_inner(truths[view].clone())).square().mean();
        errors.push(error.clone().inner().into_scalar::<f32>());
        let mut gradients = (error + grids.pull(view)).backward();
        grids.step(&mut gradients, EffectContext { view, step, steps, verdict: None });
    }
    assert!(errors[steps - 1] < 0.02 * errors[0], "from {} to {}", errors[0], errors[steps - 1]);
    let mean = (grids.grids.value(0) + grids.grids.value(1)) / 2.0 - grids.grids.neutral();
    assert!(mean.abs().max().into_scalar::<f32>() < 1e-5);
    assert_eq!(grids.bytes(), 2 * 3 * 4 * MAP * LEVELS * SIDE * SIDE);
}

/// Outside of 0 to 1 a pixel uses the map of the nearest level, so that the result continues linearly.
#[test]
fn what_is_brighter_than_white_or_darker_than_black_has_a_map() {
    let device = Device::flex();
    let grid = grid(&device);
    let shown =
        |colour: f32, grid: &Tensor<4>| values_of(apply(Tensor::full([5, 4, 3], colour, &device), grid.clone()));
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
        let mut gradients = (grids.grids.tracked(1) * Tensor::from_inner(up)).sum().backward();
        grids.step(&mut gradients, EffectContext { view: 1, step, steps: 10, verdict: None });
        let moved = values_of(grids.grids.value(1) - grids.grids.neutral());
        assert!((moved[5] + rate).abs() < 1e-6 && moved.iter().filter(|moved| **moved != 0.0).count() == 1);
        let expected = 10.0 * roughness(grids.grids.value(1)).into_scalar::<f32>();
        let found = grids.pull(1).into_scalar::<f32>();
        assert!(expected > 0.0 && (found - expected).abs() < 1e-3 * expected, "{found} instead of {expected}");
        assert_eq!(grids.pull(0).into_scalar::<f32>(), 0.0);
    }
}
