//! Cameras with lenses: planes by the definition, gradients by finite differences, and the kernels against the twin.

use crate::camera::{CameraModel, Intrinsics, LEAST_NO_RAY, PictureRays};
use crate::intersect::IntersectionLists;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, Ellipse, Geometry, OPACITY, ProjectSpec};
use crate::rasterize::cpu::{rasterize_backward_cpu, rasterize_cpu};
use crate::rasterize::{Layers, PlaneParts, RasterizeSpec};
use crate::ray_space::cpu::ray_space_cpu;
use crate::ray_space::{LENS_COLUMNS as ROW, RAY_SPACE, bounds_cpu};
use crate::testing::blending::{PixelLayer, assert_close, blended, smooth};
use crate::testing::ceiling::rounded;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::lenses::lenses;
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
    /// Gaussians far apart in depth, so that no step and no rounding exchanges two of them. Some are much thinner than wide.
    fn random(
        seed: u64,
        count: usize,
        channels: usize,
        (width, height): (usize, usize),
        (model, distortion): (CameraModel, [f64; 8]),
        options: RenderOptions,
    ) -> Self {
        let mut random = Random::new(seed);
        let mut tensors = vec![Vec::new(); 3];
        for i in 0..count {
            let z = 0.8 * 1.4_f64.powi((5 * i % count) as i32);
            tensors[0].extend([random.between(-0.6, 0.6) * z, random.between(-0.5, 0.5) * z, z]);
            tensors[1].extend((0..4).map(|_| random.between(-1.5, 1.5)));
            let size = random.between(0.02, 0.07) * z;
            tensors[2].extend([size, size * random.between(0.1, 1.0), size * random.between(0.5, 1.0)]);
        }
        let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let opacities = random.fill(count, 0.3, 0.9);
        let plain = Intrinsics { fy: 0.8 * width as f64, ..Intrinsics::centred(width, height, 0.75 * width as f64) };
        let spec = RasterizeSpec { intrinsics: Intrinsics { model, distortion, ..plain }, options };
        let geometry = Geometry {
            means: &tensors[0][..],
            rotations: &tensors[1],
            scales: &tensors[2],
            opacities: &opacities,
            cam_from_world: &pose,
            mean2d: &[],
        };
        let project =
            ProjectSpec { intrinsics: spec.intrinsics, options: options.of_project(&spec.intrinsics), factors: false };
        let (packed, slopes) = (project_cpu(geometry, &project), ray_space_cpu(geometry, &project));
        let features = random.fill(count * channels, -1.0, 1.0);
        let inputs = [packed, slopes, features, random.fill(channels, -1.0, 1.0)];
        Self { inputs: inputs.map(|values| rounded(&values)), spec }
    }

    fn view(&self) -> Layers<&'_ [f64]> {
        let [projected, ray_space, features, background] = &self.inputs;
        Layers { projected, ray_space, features, background, mean2d_abs: &[] }
    }

    fn lists(&self) -> IntersectionLists {
        let (camera, alpha_min) = (&self.spec.intrinsics, self.spec.options.alpha_min);
        intersect_cpu(&bounds_cpu(&self.inputs[0], &self.inputs[1], &self.spec), camera, alpha_min.into())
    }

    fn planes(&self) -> Vec<f64> {
        rasterize_cpu(self.view(), &self.spec, &self.lists(), false).0
    }

    fn backward(&self, grad: &[f64], needs: Layers<bool>) -> Layers<Vec<f64>> {
        let grad = PlaneParts::split(grad, &self.spec, self.inputs[3].len());
        rasterize_backward_cpu(self.view(), grad, &self.spec, &self.lists(), None, needs)
    }

    fn random_grad(&self) -> Vec<f64> {
        let pixels = self.spec.intrinsics.width * self.spec.intrinsics.height;
        Random::new(77).fill(self.spec.planes(self.inputs[3].len()) * pixels, -1.0, 1.0)
    }

    /// Gaussian `i` at a pixel whose ray has these slopes: alpha, and the depth of the layer.
    fn seen(&self, slopes: [f64; 2], i: usize) -> [f64; 2] {
        let e = Ellipse::from_row(&self.inputs[0][i * COLUMNS..]);
        let t = &self.inputs[1][i * ROW..][..ROW];
        if slopes[0] > LEAST_NO_RAY || e.opacity == 0.0 {
            return [0.0; 2];
        }
        let frame = &t[RAY_SPACE..];
        let (x, y) = (slopes[0] - frame[0], slopes[1] - frame[1]);
        let ray = [frame[2] * x + frame[3] * y, frame[4] * x + frame[5] * y];
        let whiten = |[dx, dy]: [f64; 2], depth: f64| {
            let (u, v) = (dx / t[6], (dy - t[7] * dx) / t[8]);
            [u, v, (depth - t[0] * u - t[1] * v) / t[2]]
        };
        let (to, centre) = (whiten(ray, 1.0), whiten([t[4], t[5]], t[3]));
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let lambda = dot(to, centre) / dot(to, to);
        let apart = [0, 1, 2].map(|k| lambda * to[k] - centre[k]);
        let alpha = if lambda > 0.0 { e.opacity * (-0.5 * dot(apart, apart)).exp() } else { 0.0 };
        [alpha, lambda * e.depth]
    }
}

#[test]
fn planes_are_those_of_the_definition() {
    for (seed, lens) in lenses().into_iter().enumerate() {
        for options in [RenderOptions::standard(), RenderOptions::exact(), smooth(0.95)] {
            let options = options.with_projection(Projection::RayMax).with_depth(seed % 2 == 0);
            let scene = StageInputs::random(seed as u64, 14, 3, (61, 37), lens, options);
            let rays = PictureRays::of(&scene.spec.intrinsics).expect("a lens");
            let [_, _, features, background] = &scene.inputs;
            let mut order: Vec<usize> = (0..14).collect();
            let depth = |i: usize| scene.inputs[0][i * COLUMNS + 5];
            order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
            let expected = blended(&scene.spec, features, background, |pixel| {
                let layer = |&gaussian: &usize| {
                    let [alpha, depth] = scene.seen(rays.slopes[pixel], gaussian);
                    PixelLayer { gaussian, alpha, depth }
                };
                order.iter().map(layer).collect()
            });
            assert_close(&format!("{lens:?}, {}", options.alpha_min), &scene.planes(), &expected, 1e-11);
        }
    }
}

/// The columns of a lens and all but the opacity of an ellipse decide in which coordinates a row is given, and have no gradient.
#[test]
fn every_gradient_agrees_with_finite_differences() {
    for (seed, lens) in lenses().into_iter().enumerate() {
        let options = smooth(1.0).with_projection(Projection::RayMax).with_depth(true);
        let scene = StageInputs::random(seed as u64, 7, 2, (24, 17), lens, options);
        let grad = scene.random_grad();
        let g = scene.backward(&grad, ALL);
        assert!(g.ray_space.chunks_exact(ROW).all(|row| row[RAY_SPACE..].iter().all(|value| *value == 0.0)));
        let gradients = [&g.projected, &g.ray_space, &g.features, &g.background];
        for (i, part) in ["ellipses", "rows", "features", "background"].into_iter().enumerate() {
            check_gradient(&format!("{part}, {lens:?}"), &scene.inputs[i], gradients[i], 1, |moved| {
                let mut at = scene.clone();
                at.inputs[i] = moved.to_vec();
                let [projected, rows, ..] = &mut at.inputs;
                for (row, old) in rows.chunks_exact_mut(ROW).zip(scene.inputs[1].chunks_exact(ROW)) {
                    row[RAY_SPACE..].copy_from_slice(&old[RAY_SPACE..]);
                }
                let ellipses = projected.chunks_exact_mut(COLUMNS).zip(scene.inputs[0].chunks_exact(COLUMNS));
                ellipses.for_each(|(row, old)| row[..OPACITY].copy_from_slice(&old[..OPACITY]));
                inner_product(&at.planes(), &grad)
            });
        }
    }
}

#[test]
fn each_gradient_is_the_same_alone() {
    let options = smooth(0.9).with_projection(Projection::RayMax);
    let scene = StageInputs::random(80, 12, 3, (20, 13), lenses()[1], options);
    let grad = scene.random_grad();
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

#[cfg(feature = "cube")]
mod kernels {
    use super::*;
    use crate::gpu::{Buffer, launch_scale};
    use crate::intersect::launch::launch_intersect;
    use crate::rasterize::launch::{launch_rasterize, launch_rasterize_backward};
    use crate::testing::ceiling::{PerturbedReference, to_f32};
    use crate::testing::gpu::{gpu, gpus};

    #[test]
    fn the_slopes_of_a_picture_stay_on_the_device() {
        let Some(gpu) = gpu() else { return };
        // No other test has a picture of this size.
        let [(model, distortion), ..] = lenses()[..] else { panic!("there are lenses") };
        let camera = Intrinsics::centred(23, 19, 20.0).with_lens(model, distortion);
        let rays = PictureRays::of(&camera).expect("a lens");
        let slopes: Vec<f64> = rays.slopes.as_flattened().to_vec();
        let first = rays.on(&gpu);
        assert_eq!(first.read(&gpu), to_f32(&slopes));
        launch_scale(&gpu, &first, &Buffer::from_slice(&gpu, &[0.0]));
        let again = PictureRays::of(&camera).expect("a lens").on(&gpu).read(&gpu);
        assert!(again.iter().all(|slope| *slope == 0.0), "the slopes were sent again");
    }

    #[test]
    fn kernels_agree_with_the_twin() {
        for (seed, lens) in lenses().into_iter().enumerate() {
            let mut options = smooth(1.0).with_projection(Projection::RayMax).with_depth(true);
            options.alpha_max = f64::from(0.95f32);
            let mut scene = StageInputs::random(seed as u64, 14, 3, (45, 37), lens, options);
            // No opacity is near the limit of alphas.
            scene.inputs[0].chunks_exact_mut(COLUMNS).for_each(|row| row[6] = row[6].min(0.875));
            let grad = rounded(&scene.random_grad());
            let inputs: Vec<Vec<f64>> = scene.inputs.iter().cloned().chain([grad]).collect();
            let reference = PerturbedReference::new(&inputs, |inputs| {
                let at = StageInputs { inputs: std::array::from_fn(|i| inputs[i].clone()), ..scene.clone() };
                let g = at.backward(&inputs[4], ALL);
                vec![at.planes(), g.projected, g.ray_space, g.features, g.background, g.mean2d_abs]
            });
            for (form, gpu) in gpus() {
                let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&inputs[i]));
                let device = Layers {
                    projected: buffer(0),
                    ray_space: buffer(1),
                    features: buffer(2),
                    background: buffer(3),
                    mean2d_abs: Buffer::new(&gpu, 0),
                };
                let lists = launch_intersect(&gpu, &device.projected, &scene.spec.intrinsics, 0.0.into());
                let (planes, trace) = launch_rasterize(&gpu, &device, &lists, &scene.spec, true);
                let (planes, trace) = (planes.read(&gpu), trace.expect("asked for"));
                let name = |what: &str| format!("{what}, {form}, {lens:?}");
                reference.check(&name("planes"), 0, &planes, &vec![Some(0); planes.len()]);
                let g = launch_rasterize_backward(&gpu, &device, &buffer(4), &lists, &trace, &scene.spec, ALL);
                let found = [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs];
                for (which, (found, rows)) in found.into_iter().zip([14, 14, 14, 3, 14]).enumerate() {
                    let name = name(["projected", "rows", "features", "background", "mean2d_abs"][which]);
                    let found = found.expect("asked for").read(&gpu);
                    reference.check_gradient(&name, which + 1, &found, &vec![Some(0); rows], &[]);
                }
            }
        }
    }
}
