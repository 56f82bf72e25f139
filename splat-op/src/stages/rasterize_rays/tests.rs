//! Compares `rasterize_rays` with a sum written out pixel by pixel and with central finite differences.

use crate::camera::Intrinsics;
use crate::intersect::IntersectionLists;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::{COLUMNS, Ellipse, OPACITY};
use crate::rasterize::cpu::{Trace, rasterize_backward_cpu, rasterize_cpu};
use crate::rasterize::{Layers, PlaneParts, RasterizeSpec};
use crate::ray_space::{RAY_SPACE, beyond, bounds_cpu};
use crate::testing::blending::{PixelLayer, assert_close, blended, small_ellipse, smooth};
use crate::testing::ellipses::ray_rows;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

const ALL: Layers<bool> =
    Layers { projected: true, ray_space: true, features: true, background: true, mean2d_abs: true };

/// Packed ellipses, rows in ray space, features, background.
#[derive(Clone)]
struct StageInputs {
    inputs: [Vec<f64>; 4],
    spec: RasterizeSpec,
}

impl StageInputs {
    /// `opacity` is the range of the opacities; `steep` and `thick` are the largest depth slope and thickness.
    fn random(
        seed: u64,
        count: usize,
        (width, height): (usize, usize),
        channels: usize,
        opacity: [f64; 2],
        [steep, thick]: [f64; 2],
        options: RenderOptions,
    ) -> Self {
        let mut random = Random::new(seed);
        let (mut packed, mut depth_slopes) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let depth = |random: &mut Random| random.between(0.0, 4.0).exp();
            packed.extend(small_ellipse(&mut random, [width, height], depth, opacity).to_row());
            let depth_slope = [random.between(-steep, steep), random.between(-steep, steep)];
            depth_slopes.extend([depth_slope[0], depth_slope[1], random.between(0.2 * thick, thick)]);
        }
        let features = random.fill(count * channels, -1.0, 1.0);
        let background = random.fill(channels, -1.0, 1.0);
        let spec = RasterizeSpec { intrinsics: Intrinsics::centred(width, height, 30.0), options };
        let rows = ray_rows(&packed, &depth_slopes, &spec.intrinsics);
        Self { inputs: [packed, rows, features, background], spec }
    }

    fn lists(&self) -> IntersectionLists {
        let (camera, alpha_min) = (&self.spec.intrinsics, self.spec.options.alpha_min);
        intersect_cpu(&bounds_cpu(&self.inputs[0], &self.inputs[1], &self.spec), camera, alpha_min.into())
    }

    fn planes(&self) -> Vec<f64> {
        rasterize_cpu(inputs(&self.inputs), &self.spec, &self.lists(), false).0
    }

    fn backward(&self, grad: &[f64], needs: Layers<bool>) -> Layers<Vec<f64>> {
        let grad = PlaneParts::split(grad, &self.spec, self.channels());
        rasterize_backward_cpu(inputs(&self.inputs), grad, &self.spec, &self.lists(), None, needs)
    }

    fn channels(&self) -> usize {
        self.inputs[3].len()
    }

    fn pixels(&self) -> usize {
        self.spec.intrinsics.width * self.spec.intrinsics.height
    }

    fn random_grad(&self, seed: u64) -> Vec<f64> {
        Random::new(seed).fill(self.spec.planes(self.channels()) * self.pixels(), -1.0, 1.0)
    }

    /// Gaussian `i` at `pixel`: alpha before its limit, and the camera z of its maximum along the ray.
    fn seen(&self, pixel: usize, i: usize) -> [f64; 2] {
        let width = self.spec.intrinsics.width;
        let e = Ellipse::from_row(&self.inputs[0][i * COLUMNS..]);
        let t = &self.inputs[1][i * RAY_SPACE..][..RAY_SPACE];
        // The ellipse is seen from the point of the picture next to the centre.
        let (base, away, shape) = (beyond(e.mean_px, &self.spec.intrinsics).0, [t[4], t[5], t[3]], [t[6], t[7], t[8]]);
        let whitened = |[dx, dy, depth]: [f64; 3]| {
            let (u, v) = (dx / shape[0], (dy - shape[1] * dx) / shape[2]);
            [u, v, (depth - t[0] * u - t[1] * v) / t[2]]
        };
        let at = [(pixel % width) as f64 + 0.5 - base[0], (pixel / width) as f64 + 0.5 - base[1], 1.0];
        let [to, centre] = [at, away].map(whitened);
        // Offset of the point λ of the ray from the centre, in the three whitened coordinates.
        let offset = |lambda: f64| -> [f64; 3] { std::array::from_fn(|k| lambda * to[k] - centre[k]) };
        let (at_0, at_1) = (offset(0.0), offset(1.0));
        let along: Vec<f64> = (0..3).map(|k| at_1[k] - at_0[k]).collect();
        let lambda = -(0..3).map(|k| along[k] * at_0[k]).sum::<f64>() / along.iter().map(|a| a * a).sum::<f64>();
        let nearest: f64 = offset(lambda).iter().map(|w| w * w).sum();
        if lambda > 0.0 { [e.opacity * (-0.5 * nearest).exp(), lambda * e.depth] } else { [0.0; 2] }
    }

    /// Indices of the Gaussians, front to back.
    fn order(&self) -> Vec<usize> {
        let depth = |i: usize| self.inputs[0][i * COLUMNS + 5];
        let mut order: Vec<usize> = (0..self.inputs[0].len() / COLUMNS).collect();
        order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
        order
    }

    fn check(&self, name: &str, stride: usize) {
        let grad = self.random_grad(77);
        let g = self.backward(&grad, ALL);
        let gradients = [&g.projected, &g.ray_space, &g.features, &g.background];
        for (i, part) in ["ellipses", "rows", "features", "background"].into_iter().enumerate() {
            check_gradient(&format!("{name}: {part}"), &self.inputs[i], gradients[i], stride, |moved| {
                let mut scene = self.clone();
                scene.inputs[i] = moved.to_vec();
                // All but the opacity decides in which coordinates a row is given, and has no gradient.
                let rows = scene.inputs[0].chunks_exact_mut(COLUMNS).zip(self.inputs[0].chunks_exact(COLUMNS));
                rows.for_each(|(row, own)| row[..OPACITY].copy_from_slice(&own[..OPACITY]));
                inner_product(&scene.planes(), &grad)
            });
        }
    }
}

fn inputs<F>([projected, ray_space, features, background]: &[Vec<F>; 4]) -> Layers<&'_ [F]> {
    Layers { projected, ray_space, features, background, mean2d_abs: &[] }
}

/// Planes by the definition, pixel by pixel.
fn planes_by_definition(scene: &StageInputs) -> Vec<f64> {
    let [_, _, features, background] = &scene.inputs;
    blended(&scene.spec, features, background, |pixel| {
        let layer = |i: usize| {
            let [alpha, depth] = scene.seen(pixel, i);
            PixelLayer { gaussian: i, alpha, depth }
        };
        scene.order().into_iter().map(layer).collect()
    })
}

/// The lists come from bounds or ellipses, so that a lost intersection shows.
#[test]
fn planes_are_those_of_the_definition() {
    for (seed, size) in [(37, 21), (16, 16), (1, 1), (1, 50), (90, 60)].into_iter().enumerate() {
        for options in [RenderOptions::standard(), RenderOptions::fast(), RenderOptions::exact(), smooth(0.95)] {
            let options = options.with_projection(Projection::RayMax).with_depth(seed % 2 == 0);
            let scene = StageInputs::random(seed as u64, 200, size, 1 + seed, [0.0, 1.0], [0.3, 0.3], options);
            let what = format!("{size:?}, {}", options.alpha_min);
            assert_close(&what, &scene.planes(), &planes_by_definition(&scene), 1e-11);
        }
    }
}

#[test]
fn without_a_depth_slope_it_is_rasterize() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax).with_depth(true);
    let mut scene = StageInputs::random(5, 300, (50, 40), 3, [0.0, 1.0], [0.0, 0.0], options);
    scene.inputs[1].chunks_exact_mut(RAY_SPACE).for_each(|row| row[..3].fill(0.0));
    let [projected, _, features, background] = &scene.inputs;
    let plain = Layers { projected: &projected[..], features, background, ..Layers::default() };
    let lists = intersect_cpu(projected, &scene.spec.intrinsics, options.alpha_min.into());
    let spec = RasterizeSpec { options: options.with_projection(Projection::Affine), ..scene.spec };
    let expected = rasterize_cpu(plain, &spec, &lists, false).0;
    assert_close("planes", &scene.planes(), &expected, 1e-13);
}

/// Smallest distance of any alpha before its limit from `value`.
fn nearest(scene: &StageInputs, value: f64) -> f64 {
    let count = scene.inputs[0].len() / COLUMNS;
    let pairs = (0..scene.pixels()).flat_map(|pixel| (0..count).map(move |i| (pixel, i)));
    pairs.map(|(pixel, i)| (scene.seen(pixel, i)[0] - value).abs()).fold(f64::MAX, f64::min)
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    for (channels, depth) in [(1, false), (3, true), (5, true)] {
        let options = smooth(0.8).with_depth(depth).with_projection(Projection::RayMax);
        let scene = |seed| StageInputs::random(seed, 8, (14, 10), channels, [0.4, 1.0], [0.4, 0.12], options);
        // The derivative does not exist where an alpha meets its limit, so the scene is one in which no finite-difference step
        // gets there.
        let clear = |scene: &StageInputs| nearest(scene, 0.8) > 1e-3;
        let first = 1000 * channels as u64;
        let mut scene = (first..first + 900).map(scene).find(clear).expect("one scene in some hundreds is clear of it");
        let what = format!("{channels} channels, depth {depth}");
        scene.check(&what, 1);
        // The camera is inside some of the Gaussians.
        scene.inputs[1].iter_mut().skip(2).step_by(2 * RAY_SPACE).for_each(|thickness| *thickness *= 6.0);
        if clear(&scene) {
            scene.check(&format!("{what}, thick"), 1);
        }
    }
}

#[test]
fn gradients_hold_where_pixels_finish_and_small_alphas_are_cut() {
    let options = RenderOptions { transmittance_min: 1e-2, alpha_min: 1e-2, ..RenderOptions::standard() };
    let options = options.with_depth(true).with_projection(Projection::RayMax);
    let scene = StageInputs::random(61, 160, (9, 7), 3, [0.2, 0.9], [0.2, 0.1], options);
    let finished = scene.planes()[3 * scene.pixels()..4 * scene.pixels()].iter().filter(|a| **a > 0.9).count();
    assert!(finished > scene.pixels() / 2, "{finished} pixels nearly finished");
    scene.check("with thresholds", 1);
}

#[test]
fn absolute_gradients_are_the_sum_over_pixels_of_absolute_values() {
    let options = RenderOptions::standard().with_depth(true).with_projection(Projection::RayMax);
    let scene = StageInputs::random(70, 60, (20, 13), 3, [0.05, 0.6], [0.3, 0.2], options);
    let grad = scene.random_grad(71);
    let found = scene.backward(&grad, ALL).mean2d_abs;
    let mut expected = vec![0.0; found.len()];
    for pixel in 0..scene.pixels() {
        let mut alone = vec![0.0; grad.len()];
        let planes = (pixel..grad.len()).step_by(scene.pixels());
        planes.for_each(|i| alone[i] = grad[i]);
        let g = scene.backward(&alone, Layers { mean2d_abs: false, ..ALL });
        for (i, sum) in expected.chunks_exact_mut(2).enumerate() {
            let moved = &g.ray_space[i * RAY_SPACE + 4..];
            sum.iter_mut().zip(moved).for_each(|(sum, gradient)| *sum += gradient.abs());
        }
    }
    assert_close("mean2d_abs", &found, &expected, 1e-12);
}

#[test]
fn each_gradient_is_the_same_alone() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let scene = StageInputs::random(80, 120, (20, 13), 3, [0.05, 0.9], [0.3, 0.2], options.with_depth(true));
    let grad = scene.random_grad(81);
    let list = |g: Layers<Vec<f64>>| [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs];
    let all = list(scene.backward(&grad, ALL));
    for alone in 0..5 {
        let [projected, ray_space, features, background, mean2d_abs] = std::array::from_fn(|i| i == alone);
        let needs = Layers { projected, ray_space, features, background, mean2d_abs };
        for (i, gradient) in list(scene.backward(&grad, needs)).iter().enumerate() {
            let expected = if i == alone { all[i].as_slice() } else { &[] };
            assert_eq!(gradient, expected, "gradient {i}, asked for {alone}");
        }
    }
}

/// A trace that names every block changes no bit of a gradient.
#[test]
fn the_trace_leaves_out_only_what_contributes_nothing() {
    let options = RenderOptions { transmittance_min: 1e-2, ..RenderOptions::standard() }.with_depth(true);
    let options = options.with_projection(Projection::RayMax);
    let scene = StageInputs::random(85, 900, (40, 37), 3, [0.2, 1.0], [0.3, 0.2], options);
    let (grad, lists) = (scene.random_grad(86), scene.lists());
    let kept = || rasterize_cpu(inputs(&scene.inputs), &scene.spec, &lists, true).1.expect("asked for");
    let (mut kept, mut whole) = (kept(), kept());
    whole.reached().for_each(|blocks| *blocks = u16::MAX);
    let count = |trace: &mut Trace<f64>| trace.reached().map(|blocks| blocks.count_ones() as usize).sum::<usize>();
    let (few, all) = (count(&mut kept), count(&mut whole));
    assert!(2 * few < all && few > lists.gaussian.len(), "{few} of {all} blocks");
    let with = |trace| {
        let grad = PlaneParts::split(&grad, &scene.spec, scene.channels());
        let g = rasterize_backward_cpu(inputs(&scene.inputs), grad, &scene.spec, &lists, Some(trace), ALL);
        [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs]
    };
    assert!(with(&kept) == with(&whole));
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let scene = StageInputs::random(95, 1500, (90, 70), 3, [0.0, 1.0], [0.2, 0.1], options.with_depth(true));
    let grad = scene.random_grad(96);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
        pool.install(|| {
            let g = scene.backward(&grad, ALL);
            [scene.planes(), g.projected, g.ray_space, g.features, g.background, g.mean2d_abs]
        })
    };
    assert!(with(1) == with(2), "one thread and two give different bits");
}
