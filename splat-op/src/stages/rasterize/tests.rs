//! Tests of `rasterize` against a sum written out pixel by pixel and against central finite differences.

use super::cpu::{rasterize_backward_cpu, rasterize_cpu};
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::{Cut, IntersectionLists};
use crate::options::RenderOptions;
use crate::project::{COLUMNS, Ellipse};
use crate::simd::real::Real;
use crate::testing::blending::{PixelLayer, assert_close, blended, small_ellipse, smooth};
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

const ALL: Layers<bool> =
    Layers { projected: true, features: true, background: true, mean2d_abs: true, ray_space: false };

/// Inputs of the stage: packed ellipses, features, background.
#[derive(Clone)]
struct StageInputs {
    inputs: [Vec<f64>; 3],
    spec: RasterizeSpec,
}

impl StageInputs {
    /// Draws a random scene. `opacity` is the range of the opacities.
    fn random(
        seed: u64,
        count: usize,
        (width, height): (usize, usize),
        channels: usize,
        opacity: [f64; 2],
        options: RenderOptions,
    ) -> Self {
        let mut random = Random::new(seed);
        let mut packed = Vec::new();
        for _ in 0..count {
            let depth = |random: &mut Random| random.between(1.0, 9.0);
            packed.extend(small_ellipse(&mut random, [width, height], depth, opacity).to_row());
        }
        let features = random.fill(count * channels, -1.0, 1.0);
        let background = random.fill(channels, -1.0, 1.0);
        let spec = RasterizeSpec { intrinsics: Intrinsics::centred(width, height, 30.0), options };
        Self { inputs: [packed, features, background], spec }
    }

    fn lists(&self) -> IntersectionLists {
        intersect_cpu(&self.inputs[0], &self.spec.intrinsics, Cut::of(&self.spec.options))
    }

    fn planes(&self) -> Vec<f64> {
        rasterize_cpu(inputs(&self.inputs), &self.spec, &self.lists(), false).0
    }

    fn backward(&self, grad: &[f64], needs: Layers<bool>) -> Layers<Vec<f64>> {
        let lists = self.lists();
        let (_, trace) = rasterize_cpu(inputs(&self.inputs), &self.spec, &lists, true);
        let grad = PlaneParts::split(grad, &self.spec, self.channels());
        rasterize_backward_cpu(inputs(&self.inputs), grad, &self.spec, &lists, trace.as_ref(), needs)
    }

    fn channels(&self) -> usize {
        self.inputs[2].len()
    }

    fn pixels(&self) -> usize {
        self.spec.intrinsics.width * self.spec.intrinsics.height
    }

    fn random_grad(&self, seed: u64) -> Vec<f64> {
        Random::new(seed).fill(self.spec.planes(self.channels()) * self.pixels(), -1.0, 1.0)
    }

    /// Returns the alpha of an ellipse at a pixel, before the limit.
    fn alpha(&self, pixel: usize, e: &Ellipse<f64>) -> f64 {
        let width = self.spec.intrinsics.width;
        let (dx, dy) = ((pixel % width) as f64 + 0.5 - e.mean_px[0], (pixel / width) as f64 + 0.5 - e.mean_px[1]);
        let (u, v) = (dx / e.sigma_u, (dy - e.shear * dx) / e.sigma_v);
        e.opacity * (-0.5 * (u * u + v * v)).exp()
    }

    fn check(&self, name: &str, stride: usize) {
        let grad = self.random_grad(77);
        let g = self.backward(&grad, ALL);
        let gradients = [&g.projected, &g.features, &g.background];
        for (i, part) in ["ellipses", "features", "background"].into_iter().enumerate() {
            check_gradient(&format!("{name}: {part}"), &self.inputs[i], gradients[i], stride, |moved| {
                let mut scene = self.clone();
                scene.inputs[i] = moved.to_vec();
                inner_product(&scene.planes(), &grad)
            });
        }
    }
}

fn inputs<F>([projected, features, background]: &[Vec<F>; 3]) -> Layers<&'_ [F]> {
    Layers { projected, features, background, ..Layers::default() }
}

/// Computes the planes by the definition, pixel by pixel.
fn planes_by_definition(scene: &StageInputs) -> Vec<f64> {
    let [packed, features, background] = &scene.inputs;
    let ellipses: Vec<Ellipse<f64>> = packed.chunks_exact(COLUMNS).map(Ellipse::from_row).collect();
    let mut order: Vec<usize> = (0..ellipses.len()).collect();
    order.sort_by(|&a, &b| ellipses[a].depth.total_cmp(&ellipses[b].depth));
    blended(&scene.spec, features, background, |pixel| {
        let layer =
            |&i: &usize| PixelLayer { gaussian: i, alpha: scene.alpha(pixel, &ellipses[i]), depth: ellipses[i].depth };
        order.iter().map(layer).collect()
    })
}

#[test]
fn planes_are_those_of_the_definition() {
    let sizes = [(37, 21), (16, 16), (1, 1), (1, 50), (50, 1)];
    for (seed, size) in sizes.into_iter().enumerate() {
        for options in [RenderOptions::standard(), RenderOptions::fast(), RenderOptions::exact(), smooth(0.95)] {
            for (channels, depth) in [(1, false), (3, true), (3, false), (4, false), (7, true)] {
                let options = options.with_depth(depth);
                let scene = StageInputs::random(seed as u64, 300, size, channels, [0.0, 1.0], options);
                assert_close(&format!("{size:?}"), &scene.planes(), &planes_by_definition(&scene), 1e-13);
            }
        }
    }
}

/// Returns the smallest distance of any alpha, before the clamp, from `value`.
fn nearest_alpha(scene: &StageInputs, value: f64) -> f64 {
    let pairs =
        scene.inputs[0].chunks_exact(COLUMNS).flat_map(|row| (0..scene.pixels()).map(move |pixel| (row, pixel)));
    let alphas = pairs.map(|(row, pixel)| scene.alpha(pixel, &Ellipse::from_row(row)));
    alphas.map(|alpha| (alpha - value).abs()).fold(f64::MAX, f64::min)
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    // Each number of channels that has a loop of its own, with and without depth as one more channel.
    for channels in [1, 3, 4, 7] {
        for depth in [false, true] {
            let options = smooth(0.8).with_depth(depth);
            let scene = |seed| StageInputs::random(seed, 14, (20, 13), channels, [0.4, 1.0], options);
            // There is no derivative where an alpha meets its limit, so the test takes a scene in which no step gets
            // there.
            let first = 1000 * channels as u64 + 500 * u64::from(depth);
            let scene = (first..first + 500).map(scene).find(|scene| nearest_alpha(scene, 0.8) > 1e-3);
            let scene = scene.expect("one scene in some tens is clear of the limit");
            let opaque = scene.inputs[0].chunks_exact(COLUMNS).filter(|row| row[6] > 0.8).count();
            assert!(opaque > 0, "some alphas are held at their limit");
            scene.check(&format!("{channels} channels, depth {depth}"), 1);
        }
    }
}

#[test]
fn gradients_hold_over_several_checkpoints() {
    // 150 Gaussians in one tile and a half: three chunks. The last layers still shine through.
    for channels in [3, 5] {
        let scene = StageInputs::random(50, 150, (24, 9), channels, [0.01, 0.1], smooth(0.99).with_depth(true));
        scene.check(&format!("{channels} channels"), 3);
    }
}

#[test]
fn gradients_hold_on_long_lists() {
    // Enough faint Gaussians over every pixel that the tile is rasterized with compensation, in any number of channels.
    for channels in [3, 5] {
        let mut scene = StageInputs::random(51, 400, (12, 9), channels, [0.002, 0.03], smooth(0.99).with_depth(true));
        for (i, row) in scene.inputs[0].chunks_exact_mut(COLUMNS).enumerate().filter(|(_, row)| row[5] > 0.0) {
            // Depths farther apart than finite differences move them, in no order.
            row[5] = 1.01_f64.powi((171 * i % 400) as i32);
        }
        scene.check(&format!("{channels} channels"), 41);
    }
}

#[test]
fn gradients_hold_where_pixels_finish_and_small_alphas_are_cut() {
    // Dense enough that pixels finish, in different chunks. No pair is within a step of a threshold for these seeds.
    let options = RenderOptions { transmittance_min: 1e-2, alpha_min: 1e-2, ..RenderOptions::standard() };
    let scene = StageInputs::random(61, 160, (9, 7), 3, [0.2, 0.9], options.with_depth(true));
    let finished = scene.planes()[3 * scene.pixels()..4 * scene.pixels()].iter().filter(|a| **a > 0.9).count();
    assert!(finished > scene.pixels() / 2, "{finished} pixels nearly finished");
    scene.check("with thresholds", 1);
}

#[test]
fn absolute_gradients_are_the_sum_over_pixels_of_absolute_values() {
    for (channels, depth) in [(3, true), (5, false)] {
        let scene =
            StageInputs::random(70, 90, (20, 13), channels, [0.05, 0.6], RenderOptions::standard().with_depth(depth));
        let grad = scene.random_grad(71);
        let found = scene.backward(&grad, ALL).mean2d_abs;
        let mut expected = vec![0.0; found.len()];
        for pixel in 0..scene.pixels() {
            let mut alone = vec![0.0; grad.len()];
            let planes = (pixel..grad.len()).step_by(scene.pixels());
            planes.for_each(|i| alone[i] = grad[i]);
            let g = scene.backward(&alone, Layers { features: false, background: false, mean2d_abs: false, ..ALL });
            for (sum, row) in expected.chunks_exact_mut(2).zip(g.projected.chunks_exact(COLUMNS)) {
                sum[0] += row[0].abs();
                sum[1] += row[1].abs();
            }
        }
        assert_close("mean2d_abs", &found, &expected, 1e-12);
    }
}

/// Tiles without a gradient are left out: the gradients of two losses add up that share no pixel of a plane. In a third of the tiles the
/// first has a gradient of alpha and depth alone.
#[test]
fn tiles_without_a_gradient_are_left_out_and_nothing_else() {
    let options = RenderOptions::standard().with_depth(true);
    let scene = StageInputs::random(75, 90, (70, 50), 3, [0.05, 0.9], options);
    let all = scene.random_grad(76);
    let part = |first: bool| -> Vec<f64> {
        let of = |(i, g): (usize, &f64)| {
            let (plane, pixel) = (i / scene.pixels(), i % scene.pixels());
            let in_first = match (pixel / 70 / 16 + pixel % 70 / 16) % 3 {
                0 => true,
                1 => plane >= 3,
                _ => false,
            };
            if in_first == first { *g } else { 0.0 }
        };
        all.iter().enumerate().map(of).collect()
    };
    let list = |g: Layers<Vec<f64>>| [g.projected, g.features, g.background];
    let [whole, first, second] = [all.clone(), part(true), part(false)].map(|grad| list(scene.backward(&grad, ALL)));
    for ((whole, first), second) in whole.iter().zip(first).zip(second) {
        let sum: Vec<f64> = first.iter().zip(second).map(|(a, b)| a + b).collect();
        assert_close("the gradients of two losses", &sum, whole, 1e-12);
    }
}

#[test]
fn each_gradient_is_the_same_alone_and_without_a_trace() {
    let scene = StageInputs::random(80, 120, (20, 13), 3, [0.05, 0.9], RenderOptions::standard().with_depth(true));
    let (grad, lists) = (scene.random_grad(81), scene.lists());
    let list = |g: Layers<Vec<f64>>| [g.projected, g.features, g.background, g.mean2d_abs];
    let all = list(scene.backward(&grad, ALL));
    let parts = PlaneParts::split(&grad, &scene.spec, scene.channels());
    let without = rasterize_backward_cpu(inputs(&scene.inputs), parts, &scene.spec, &lists, None, ALL);
    assert_eq!(list(without), all, "a trace is a cache");
    for alone in 0..4 {
        let [projected, features, background, mean2d_abs] = std::array::from_fn(|i| i == alone);
        let needs = Layers { projected, features, background, mean2d_abs, ray_space: false };
        for (i, gradient) in list(scene.backward(&grad, needs)).iter().enumerate() {
            let expected = if i == alone { all[i].as_slice() } else { &[] };
            assert_eq!(gradient, expected, "gradient {i}, asked for {alone}");
        }
    }
}

#[test]
fn many_layers_behind_an_opaque_one_keep_their_digits() {
    // Where 1 − alpha is 1e-9, dividing by it, or subtracting a prefix sum from a total, would leave noise.
    let mut scene = StageInputs::random(90, 200, (6, 5), 3, [0.3, 1.0], smooth(1.0 - 1e-9));
    let wall = Ellipse { mean_px: [2.5, 2.5], sigma_u: 4.0, shear: 0.1, sigma_v: 3.0, depth: 4.0, opacity: 1.0 };
    scene.inputs[0][..COLUMNS].copy_from_slice(&wall.to_row());
    let double = scene.backward(&scene.random_grad(91), ALL);
    let single_inputs = scene.inputs.each_ref().map(|values| values.iter().map(|v| *v as f32).collect::<Vec<f32>>());
    let single_grad: Vec<f32> = scene.random_grad(91).iter().map(|v| *v as f32).collect();
    let lists = intersect_cpu(&single_inputs[0], &scene.spec.intrinsics, 0.0.into());
    let single_grad = PlaneParts::split(&single_grad, &scene.spec, scene.channels());
    let single = rasterize_backward_cpu(inputs(&single_inputs), single_grad, &scene.spec, &lists, None, ALL);
    for (name, single, double) in
        [("ellipses", &single.projected, &double.projected), ("features", &single.features, &double.features)]
    {
        let largest = double.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        let found: Vec<f64> = single.iter().map(|g| g.f64() / largest).collect();
        let expected: Vec<f64> = double.iter().map(|g| g / largest).collect();
        assert_close(name, &found, &expected, 2e-5);
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let scene = StageInputs::random(95, 3000, (90, 70), 3, [0.0, 1.0], RenderOptions::standard().with_depth(true));
    let grad = scene.random_grad(96);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
        pool.install(|| {
            let g = scene.backward(&grad, ALL);
            [scene.planes(), g.projected, g.features, g.background, g.mean2d_abs]
        })
    };
    assert!(with(1) == with(2), "one thread and two give different bits");
}
