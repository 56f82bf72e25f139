//! Features that are not finite: they reach the pixels that see their Gaussian, and no other.

use super::cpu::{rasterize_backward_cpu, rasterize_cpu};
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::intersect::Cut;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::COLUMNS;
use crate::ray_space::bounds_cpu;
use crate::simd::real::Real;
use crate::testing::ellipses::ray_rows;
use crate::testing::random::Random;

const SIZE: [usize; 2] = [20, 17];

/// The first Gaussian has the features that are not finite. It shares a tile and blocks of pixels with all others, but no pixel.
struct Scene {
    projected: Vec<f64>,
    rows: Vec<f64>,
    features: Vec<f64>,
    background: Vec<f64>,
    grad: Vec<f64>,
    spec: RasterizeSpec,
}

impl Scene {
    fn new(count: usize, channels: usize, options: RenderOptions) -> Self {
        let mut random = Random::new((count + channels) as u64);
        let mut projected = vec![1.5, 3.5, 0.4, 0.1, 0.7, 3.0, 0.9];
        for _ in 1..count {
            let opacity = random.between(0.6, 0.9) / if count > 100 { 40.0 } else { 1.0 };
            projected.extend([random.between(6.5, 7.5), random.between(2.5, 6.5), 0.7, 0.2, 0.8]);
            projected.extend([random.between(1.0, 9.0), opacity]);
        }
        let slopes: Vec<f64> = (0..count).flat_map(|_| [0.05, -0.03, 0.02]).collect();
        let intrinsics = Intrinsics::centred(SIZE[0], SIZE[1], 30.0);
        let spec = RasterizeSpec { intrinsics, options };
        Self {
            rows: ray_rows(&projected, &slopes, &intrinsics),
            projected,
            features: random.fill(count * channels, 0.0, 1.0),
            background: random.fill(channels, 0.0, 1.0),
            grad: random.fill(spec.planes(channels) * SIZE[0] * SIZE[1], -1.0, 1.0),
            spec,
        }
    }

    fn with(&self, feature: f64, opacity: f64) -> Self {
        let (mut projected, mut features) = (self.projected.clone(), self.features.clone());
        (projected[6], features[0]) = (opacity, feature);
        Self {
            projected,
            features,
            rows: self.rows.clone(),
            background: self.background.clone(),
            grad: self.grad.clone(),
            ..*self
        }
    }

    /// Checks the planes, and the gradients of all Gaussians but the first, that `render` returns.
    fn check(&self, name: &str, render: impl Fn(&Self) -> [Vec<f64>; 3]) {
        let pixels = SIZE[0] * SIZE[1];
        let [without, of_ellipses, of_features] = render(&self.with(0.5, 0.0));
        let [seen, ..] = render(&self.with(0.5, 0.9));
        let seen: Vec<bool> = seen.iter().zip(&without).map(|(a, b)| a != b).collect();
        assert!(seen.iter().any(|seen| *seen) && seen.iter().filter(|seen| **seen).count() < seen.len() / 5, "{name}");
        for feature in [f64::NAN, f64::INFINITY] {
            let [planes, ellipses, features] = render(&self.with(feature, 0.9));
            let all = planes.iter().zip(&without).enumerate();
            let same =
                all.filter(|(i, _)| !seen[*i] && !(0..seen.len()).skip(i % pixels).step_by(pixels).any(|i| seen[i]));
            for (i, (found, expected)) in same {
                assert!(found == expected, "{name}: {feature} at pixel {i}: {found} instead of {expected}");
            }
            assert!(planes.iter().any(|value| !value.is_finite()), "{name}: {feature} shows where it is seen");
            assert!(ellipses[COLUMNS..] == of_ellipses[COLUMNS..], "{name}: {feature} changes gradients of ellipses");
            let channels = self.background.len();
            assert!(features[channels..] == of_features[channels..], "{name}: {feature} changes gradients of features");
        }
    }
}

fn scenes() -> impl Iterator<Item = (String, Scene)> {
    let forms = [(1, false), (3, false), (3, true), (4, false), (6, true)];
    forms.into_iter().flat_map(|(channels, depth)| {
        [5, 400].map(|count| {
            let mut options = RenderOptions::standard().with_depth(depth);
            if count == 400 {
                options.alpha_min = 1e-4;
            }
            (format!("{count} Gaussians, {channels} channels, depth {depth}"), Scene::new(count, channels, options))
        })
    })
}

fn narrowed<F: Real>(values: &[f64]) -> Vec<F> {
    values.iter().map(|value| F::of(*value)).collect()
}

fn widened<F: Real>(values: Vec<F>) -> Vec<f64> {
    values.into_iter().map(Real::f64).collect()
}

fn on_cpu<F: Real>(scene: &Scene) -> [Vec<f64>; 3] {
    let [projected, ray_space, features, background, grad] =
        [&scene.projected, &scene.rows, &scene.features, &scene.background, &scene.grad].map(|v| narrowed::<F>(v));
    let inputs = Layers {
        projected: &projected[..],
        features: &features,
        background: &background,
        mean2d_abs: &[],
        ray_space: &ray_space,
    };
    let spec = &scene.spec;
    let bounds = if spec.options.along_rays() { &bounds_cpu(&projected, &ray_space, spec) } else { &projected };
    let lists = intersect_cpu(bounds, &spec.intrinsics, Cut::of(&spec.options));
    let (planes, trace) = rasterize_cpu(inputs, spec, &lists, true);
    let needs = Layers { projected: true, features: true, ..Layers::default() };
    let grad = PlaneParts::split(&grad, spec, background.len());
    let grads = rasterize_backward_cpu(inputs, grad, spec, &lists, trace.as_ref(), needs);
    [planes, grads.projected, grads.features].map(widened)
}

#[test]
fn features_that_are_not_finite_reach_no_other_pixel() {
    for (name, mut scene) in scenes() {
        for projection in [Projection::Affine, Projection::RayMax] {
            scene.spec.options.projection = projection;
            scene.check(&format!("f32, {projection:?}, {name}"), on_cpu::<f32>);
            scene.check(&format!("f64, {projection:?}, {name}"), on_cpu::<f64>);
        }
    }
}

#[cfg(feature = "cube")]
mod kernels {
    use super::*;
    use crate::gpu::{Buffer, Gpu};
    use crate::intersect::launch::launch_intersect;
    use crate::options::Accumulation;
    use crate::rasterize::launch::{launch_rasterize, launch_rasterize_backward};
    use crate::ray_space::launch::launch_bounds;
    use crate::testing::ceiling::to_f32;
    use crate::testing::gpu::gpus;

    fn on_gpu(scene: &Scene, gpu: &Gpu) -> [Vec<f64>; 3] {
        let buffer = |values: &[f64]| Buffer::from_slice(gpu, &to_f32(values));
        let inputs = Layers {
            projected: buffer(&scene.projected),
            features: buffer(&scene.features),
            background: buffer(&scene.background),
            mean2d_abs: Buffer::new(gpu, 0),
            ray_space: buffer(&scene.rows),
        };
        let spec = &scene.spec;
        let bounds = spec.options.along_rays().then(|| launch_bounds(gpu, &inputs.projected, &inputs.ray_space, spec));
        let bounds = bounds.as_ref().unwrap_or(&inputs.projected);
        let lists = launch_intersect(gpu, bounds, &spec.intrinsics, Cut::of(&spec.options));
        let (planes, trace) = launch_rasterize(gpu, &inputs, &lists, spec, true);
        let needs = Layers { projected: true, features: true, ..Layers::default() };
        let (trace, grad) = (trace.expect("asked for"), buffer(&scene.grad));
        let grads = launch_rasterize_backward(gpu, &inputs, &grad, &lists, &trace, spec, needs);
        let [ellipses, features] = [grads.projected, grads.features].map(|grad| grad.expect("asked for"));
        [planes.read(gpu), ellipses.read(gpu), features.read(gpu)].map(widened)
    }

    /// Lists of up to 32 places, in which a place more or less changes no rounding.
    #[test]
    fn features_that_are_not_finite_reach_no_other_pixel() {
        for (form, gpu) in gpus() {
            for (name, mut scene) in scenes().filter(|(_, scene)| scene.projected.len() < 32 * COLUMNS) {
                scene.spec.options.accumulation = Accumulation::Ordered;
                for projection in [Projection::Affine, Projection::RayMax] {
                    scene.spec.options.projection = projection;
                    scene.check(&format!("{form}, {projection:?}, {name}"), |scene| on_gpu(scene, &gpu));
                }
            }
        }
    }
}
