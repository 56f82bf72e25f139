//! Compares `rasterize_rays` with a sum written out pixel by pixel and with central finite differences.

use super::RayLayers;
use super::cpu::{rasterize_rays_backward_cpu, rasterize_rays_cpu};
use crate::camera::Intrinsics;
use crate::intersect::IntersectionLists;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Order, Projection, RenderOptions};
use crate::project::{COLUMNS, Ellipse, OPACITY};
use crate::rasterize::cpu::rasterize_cpu;
use crate::rasterize::{PlaneParts, RasterizeSpec};
use crate::ray_space::{RAY_SPACE, beyond, bounds_cpu};
use crate::testing::blending::{PixelLayer, assert_close, blended, small_ellipse, smooth};
use crate::testing::ellipses::ray_rows;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

const ALL: RayLayers<bool> =
    RayLayers { projected: true, ray_space: true, features: true, background: true, mean2d_abs: true };

const CHOICES: [(Projection, Order); 4] = [
    (Projection::RayMax, Order::CentreDepth),
    (Projection::Affine, Order::PerPixelSort),
    (Projection::RayMax, Order::PerPixelSort),
    (Projection::Affine, Order::CentreDepth),
];

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
        (opacity, steep, thick): ([f64; 2], f64, f64),
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
        match self.spec.options.projection {
            Projection::RayMax => {
                intersect_cpu(&bounds_cpu(&self.inputs[0], &self.inputs[1], &self.spec), camera, alpha_min.into())
            }
            Projection::Affine => intersect_cpu(&self.inputs[0], camera, alpha_min.into()),
        }
    }

    fn planes(&self) -> Vec<f64> {
        rasterize_rays_cpu(inputs(&self.inputs), &self.spec, &self.lists(), false).0
    }

    fn backward(&self, grad: &[f64], needs: RayLayers<bool>) -> RayLayers<Vec<f64>> {
        let grad = PlaneParts::split(grad, &self.spec, self.channels());
        rasterize_rays_backward_cpu(inputs(&self.inputs), grad, &self.spec, (&self.lists(), None), needs)
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

    /// Gaussian `i` at `pixel`: alpha before its limit, the depth of the layer, and the camera z of its maximum along the ray.
    fn seen(&self, pixel: usize, i: usize) -> [f64; 3] {
        let (width, options) = (self.spec.intrinsics.width, &self.spec.options);
        let e = Ellipse::from_row(&self.inputs[0][i * COLUMNS..]);
        let t = &self.inputs[1][i * RAY_SPACE..][..RAY_SPACE];
        // The ellipse is seen from the point of the picture next to the centre, or from the centre itself.
        let (base, away, shape) = match options.projection {
            Projection::RayMax => (beyond(e.mean_px, &self.spec.intrinsics).0, [t[4], t[5], t[3]], [t[6], t[7], t[8]]),
            Projection::Affine => (e.mean_px, [0.0, 0.0, 1.0], [e.sigma_u, e.shear, e.sigma_v]),
        };
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
        match options.projection {
            Projection::Affine => {
                [e.opacity * (-0.5 * (to[0] * to[0] + to[1] * to[1])).exp(), e.depth, lambda * e.depth]
            }
            Projection::RayMax if lambda > 0.0 => {
                [e.opacity * (-0.5 * nearest).exp(), lambda * e.depth, lambda * e.depth]
            }
            Projection::RayMax => [0.0, 0.0, 0.0],
        }
    }

    /// Indices of the Gaussians, front to back.
    fn order(&self, pixel: usize) -> Vec<usize> {
        let key = |i: usize| match self.spec.options.order {
            Order::CentreDepth => self.inputs[0][i * COLUMNS + 5],
            Order::PerPixelSort => self.seen(pixel, i)[2],
        };
        let keys: Vec<f64> = (0..self.inputs[0].len() / COLUMNS).map(key).collect();
        let mut order: Vec<usize> = (0..keys.len()).collect();
        order.sort_by(|&a, &b| keys[a].total_cmp(&keys[b]));
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
                if self.spec.options.projection == Projection::RayMax {
                    // All but the opacity decides in which coordinates a row is given, and has no gradient.
                    let rows = scene.inputs[0].chunks_exact_mut(COLUMNS).zip(self.inputs[0].chunks_exact(COLUMNS));
                    rows.for_each(|(row, own)| row[..OPACITY].copy_from_slice(&own[..OPACITY]));
                }
                inner_product(&scene.planes(), &grad)
            });
        }
    }
}

fn inputs<F>([projected, ray_space, features, background]: &[Vec<F>; 4]) -> RayLayers<&'_ [F]> {
    RayLayers { projected, ray_space, features, background, mean2d_abs: &[] }
}

/// Planes by the definition, pixel by pixel.
fn planes_by_definition(scene: &StageInputs) -> Vec<f64> {
    let [_, _, features, background] = &scene.inputs;
    blended(&scene.spec, features, background, |pixel| {
        let layer = |i: usize| {
            let [alpha, depth, _] = scene.seen(pixel, i);
            PixelLayer { gaussian: i, alpha, depth }
        };
        scene.order(pixel).into_iter().map(layer).collect()
    })
}

/// The lists come from bounds or ellipses, so that a lost intersection shows.
#[test]
fn planes_are_those_of_the_definition() {
    for (seed, size) in [(37, 21), (16, 16), (1, 1), (1, 50), (90, 60)].into_iter().enumerate() {
        for (projection, order) in CHOICES {
            for options in [RenderOptions::standard(), RenderOptions::fast(), RenderOptions::exact(), smooth(0.95)] {
                let options = options.with_projection(projection).with_order(order).with_depth(seed % 2 == 0);
                let scene = StageInputs::random(seed as u64, 200, size, 1 + seed, ([0.0, 1.0], 0.3, 0.3), options);
                let what = format!("{size:?}, {projection:?}, {order:?}, {}", options.alpha_min);
                assert_close(&what, &scene.planes(), &planes_by_definition(&scene), 1e-11);
            }
        }
    }
}

#[test]
fn without_a_depth_slope_it_is_rasterize() {
    for (projection, order) in CHOICES {
        let options = RenderOptions::standard().with_projection(projection).with_order(order).with_depth(true);
        let mut scene = StageInputs::random(5, 300, (50, 40), 3, ([0.0, 1.0], 0.0, 0.0), options);
        scene.inputs[1].chunks_exact_mut(RAY_SPACE).for_each(|row| row[..3].fill(0.0));
        let [projected, _, features, background] = &scene.inputs;
        let plain = crate::rasterize::Layers { projected: &projected[..], features, background, mean2d_abs: &[] };
        let lists = intersect_cpu(projected, &scene.spec.intrinsics, options.alpha_min.into());
        let expected = rasterize_cpu(plain, &scene.spec, &lists, false).0;
        assert_close(&format!("{projection:?}, {order:?}"), &scene.planes(), &expected, 1e-13);
    }
}

/// Smallest distance of any alpha before its limit from `value`, and smallest relative distance of two keys that could swap.
fn nearest(scene: &StageInputs, value: f64) -> f64 {
    let count = scene.inputs[0].len() / COLUMNS;
    let mut nearest = f64::MAX;
    for pixel in 0..scene.pixels() {
        let seen: Vec<[f64; 3]> = (0..count).map(|i| scene.seen(pixel, i)).collect();
        for (i, a) in seen.iter().enumerate() {
            nearest = nearest.min((a[0] - value).abs());
            if scene.spec.options.order == Order::PerPixelSort {
                let pairs = seen[..i].iter().filter(|b| a[0] * b[0] > 1e-11);
                nearest = pairs.map(|b| (a[2] - b[2]).abs() / a[2].abs().max(b[2].abs())).fold(nearest, f64::min);
            }
        }
    }
    nearest
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    for (projection, order) in CHOICES {
        for (channels, depth) in [(1, false), (3, true), (5, true)] {
            let options = smooth(0.8).with_depth(depth).with_projection(projection).with_order(order);
            let range = ([0.4, 1.0], 0.4, 0.12);
            let scene = |seed| StageInputs::random(seed, 8, (14, 10), channels, range, options);
            // The derivative does not exist where an alpha meets its limit or layers swap, so the scene is one
            // in which no finite-difference step gets there.
            let first = 1000 * channels as u64;
            let scene = (first..first + 900).map(scene).find(|scene| nearest(scene, 0.8) > 1e-3);
            let scene = scene.expect("one scene in some hundreds is clear of both");
            if order == Order::PerPixelSort {
                let orders: std::collections::BTreeSet<_> = (0..scene.pixels()).map(|p| scene.order(p)).collect();
                assert!(orders.len() > 3, "pixels see different orders");
            }
            let what = format!("{channels} channels, depth {depth}, {projection:?}, {order:?}");
            let mut scene = scene;
            if projection == Projection::Affine {
                // The depth slope has no gradient, and finite differences agree.
                let g = scene.backward(&scene.random_grad(77), ALL);
                assert!(g.ray_space.iter().all(|g| *g == 0.0), "{what}");
            }
            scene.check(&what, 1);
            // The camera is inside some of the Gaussians.
            scene.inputs[1].iter_mut().skip(2).step_by(2 * RAY_SPACE).for_each(|thickness| *thickness *= 6.0);
            if order == Order::CentreDepth && nearest(&scene, 0.8) > 1e-3 {
                scene.check(&format!("{what}, thick"), 1);
            }
        }
    }
}

#[test]
fn gradients_hold_where_pixels_finish_and_small_alphas_are_cut() {
    for (projection, order) in CHOICES.into_iter().filter(|(_, order)| *order == Order::CentreDepth) {
        let options = RenderOptions { transmittance_min: 1e-2, alpha_min: 1e-2, ..RenderOptions::standard() };
        let options = options.with_depth(true).with_projection(projection).with_order(order);
        let scene = StageInputs::random(61, 160, (9, 7), 3, ([0.2, 0.9], 0.2, 0.1), options);
        let finished = scene.planes()[3 * scene.pixels()..4 * scene.pixels()].iter().filter(|a| **a > 0.9).count();
        assert!(finished > scene.pixels() / 2, "{finished} pixels nearly finished");
        scene.check(&format!("with thresholds, {projection:?}"), 1);
    }
}

#[test]
fn absolute_gradients_are_the_sum_over_pixels_of_absolute_values() {
    for (projection, order) in CHOICES {
        let options = RenderOptions::standard().with_depth(true).with_projection(projection).with_order(order);
        let scene = StageInputs::random(70, 60, (20, 13), 3, ([0.05, 0.6], 0.3, 0.2), options);
        let grad = scene.random_grad(71);
        let found = scene.backward(&grad, ALL).mean2d_abs;
        let mut expected = vec![0.0; found.len()];
        for pixel in 0..scene.pixels() {
            let mut alone = vec![0.0; grad.len()];
            let planes = (pixel..grad.len()).step_by(scene.pixels());
            planes.for_each(|i| alone[i] = grad[i]);
            let g = scene.backward(&alone, RayLayers { mean2d_abs: false, ..ALL });
            let moved = |i: usize| match projection {
                Projection::RayMax => &g.ray_space[i * RAY_SPACE + 4..],
                Projection::Affine => &g.projected[i * COLUMNS..],
            };
            for (i, sum) in expected.chunks_exact_mut(2).enumerate() {
                sum.iter_mut().zip(moved(i)).for_each(|(sum, gradient)| *sum += gradient.abs());
            }
        }
        assert_close("mean2d_abs", &found, &expected, 1e-12);
    }
}

#[test]
fn each_gradient_is_the_same_alone() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax).with_order(Order::PerPixelSort);
    let scene = StageInputs::random(80, 120, (20, 13), 3, ([0.05, 0.9], 0.3, 0.2), options.with_depth(true));
    let grad = scene.random_grad(81);
    let list = |g: RayLayers<Vec<f64>>| [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs];
    let all = list(scene.backward(&grad, ALL));
    for alone in 0..5 {
        let [projected, ray_space, features, background, mean2d_abs] = std::array::from_fn(|i| i == alone);
        let needs = RayLayers { projected, ray_space, features, background, mean2d_abs };
        for (i, gradient) in list(scene.backward(&grad, needs)).iter().enumerate() {
            let expected = if i == alone { all[i].as_slice() } else { &[] };
            assert_eq!(gradient, expected, "gradient {i}, asked for {alone}");
        }
    }
}

/// A trace that names every block changes no bit of a gradient.
#[test]
fn the_trace_leaves_out_only_what_contributes_nothing() {
    for (projection, order) in CHOICES {
        let options = RenderOptions { transmittance_min: 1e-2, ..RenderOptions::standard() }.with_depth(true);
        let options = options.with_projection(projection).with_order(order);
        let scene = StageInputs::random(85, 900, (40, 37), 3, ([0.2, 1.0], 0.3, 0.2), options);
        let (grad, lists) = (scene.random_grad(86), scene.lists());
        let kept = rasterize_rays_cpu(inputs(&scene.inputs), &scene.spec, &lists, true).1.expect("asked for");
        let whole = kept.whole();
        let (few, all) = (kept.pairs(), whole.pairs());
        assert!(2 * few < all && few > lists.gaussian.len(), "{few} of {all} blocks, {projection:?}, {order:?}");
        let with = |trace| {
            let grad = PlaneParts::split(&grad, &scene.spec, scene.channels());
            let g = rasterize_rays_backward_cpu(inputs(&scene.inputs), grad, &scene.spec, (&lists, Some(trace)), ALL);
            [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs]
        };
        assert!(with(&kept) == with(&whole), "{projection:?}, {order:?}");
    }
}

/// Behind an opaque layer the per-pixel sort evaluates only what might lie in front of it.
#[test]
fn what_lies_behind_finished_pixels_is_not_evaluated() {
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = RenderOptions::standard().with_projection(projection).with_order(Order::PerPixelSort);
        let mut scene = StageInputs::random(87, 600, (16, 16), 3, ([0.5, 1.0], 0.05, 0.05), options);
        // Broad Gaussians, one behind the other.
        for (i, row) in scene.inputs[0].chunks_exact_mut(COLUMNS).enumerate() {
            (row[2], row[4], row[5]) = (30.0, 30.0, 1.0 + 0.05 * i as f64);
        }
        scene.inputs[1].chunks_exact_mut(RAY_SPACE).for_each(|row| (row[6], row[8]) = (30.0, 30.0));
        let trace = |scene: &StageInputs| {
            rasterize_rays_cpu(inputs(&scene.inputs), &scene.spec, &scene.lists(), true).1.expect("asked for")
        };
        let (few, planes) = (trace(&scene).pairs(), scene.planes());
        assert_close("planes", &planes, &planes_by_definition(&scene), 1e-12);
        scene.spec.options.transmittance_min = 0.0;
        let all = trace(&scene).pairs();
        assert!(5 * few < all, "{few} of {all} blocks, {projection:?}");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax).with_order(Order::PerPixelSort);
    let scene = StageInputs::random(95, 1500, (90, 70), 3, ([0.0, 1.0], 0.2, 0.1), options.with_depth(true));
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
