//! The gradients of Gaussians through `project`, `ray_space` and `rasterize_rays`. Only all three stages together have a gradient that
//! finite differences can prove: the gradient of a row holds its coordinates fixed, which move with the Gaussian.

use crate::camera::{CameraModel, Intrinsics};
use crate::intersect::IntersectionLists;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::cpu::{project_backward_cpu, project_cpu};
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::cpu::{rasterize_backward_cpu, rasterize_cpu};
use crate::rasterize::{Layers, PlaneParts, RasterizeSpec};
use crate::ray_space::cpu::{ray_space_backward_cpu, ray_space_cpu};
use crate::ray_space::{RAY_SPACE, bounds_cpu};
use crate::testing::blending::{assert_close, smooth};
use crate::testing::ceiling::{PerturbedReference, rounded};
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::lenses::lenses;
use crate::testing::random::Random;

const POSE: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

const BACKGROUND: [f64; 3] = [0.1, 0.2, 0.3];

const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: true, cam_from_world: true, mean2d: true };

/// Means, rotations, scales, opacities, pose, features.
#[derive(Clone)]
struct Scene {
    tensors: Vec<Vec<f64>>,
    intrinsics: Intrinsics,
    options: RenderOptions,
}

impl Scene {
    fn geometry(&self) -> Geometry<&'_ [f64]> {
        let [means, rotations, scales, opacities, cam_from_world, _] = &self.tensors[..] else {
            unreachable!("six tensors")
        };
        Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
    }

    fn specs(&self) -> (ProjectSpec, RasterizeSpec) {
        let Self { intrinsics, options, .. } = *self;
        let project = ProjectSpec { intrinsics, options: options.of_project(&intrinsics), factors: false };
        (project, RasterizeSpec { intrinsics, options })
    }

    /// Packed ellipses and their rows.
    fn projected(&self) -> [Vec<f64>; 2] {
        let (spec, _) = self.specs();
        [project_cpu(self.geometry(), &spec), ray_space_cpu(self.geometry(), &spec)]
    }

    fn layers<'a>(&'a self, [projected, ray_space]: &'a [Vec<f64>; 2]) -> Layers<&'a [f64]> {
        Layers { projected, ray_space, features: &self.tensors[5], background: &BACKGROUND, mean2d_abs: &[] }
    }

    fn lists(&self, [projected, rows]: &[Vec<f64>; 2]) -> IntersectionLists {
        let spec = self.specs().1;
        intersect_cpu(&bounds_cpu(projected, rows, &spec), &spec.intrinsics, spec.options.alpha_min.into())
    }

    fn planes(&self) -> Vec<f64> {
        let rows = self.projected();
        rasterize_cpu(self.layers(&rows), &self.specs().1, &self.lists(&rows), false).0
    }

    /// A random gradient of the planes.
    fn grad(&self, seed: u64) -> Vec<f64> {
        let spec = self.specs().1;
        Random::new(seed).fill(spec.planes(3) * spec.intrinsics.width * spec.intrinsics.height, -1.0, 1.0)
    }

    /// The gradients of the Gaussians by those of the planes. `pass` hands on the gradients between the stages.
    fn backward(&self, grad: &[f64], pass: impl Fn(&[f64]) -> Vec<f64>) -> Geometry<Vec<f64>> {
        let (rows, (project, spec)) = (self.projected(), self.specs());
        let wanted = Layers { projected: true, ray_space: true, features: false, background: false, mean2d_abs: false };
        let grad = PlaneParts::split(grad, &spec, 3);
        let lists = self.lists(&rows);
        let grads = rasterize_backward_cpu(self.layers(&rows), grad, &spec, &lists, None, wanted);
        let through_ellipses = project_backward_cpu(self.geometry(), &pass(&grads.projected), &project, ALL);
        let through_rows = ray_space_backward_cpu(self.geometry(), &pass(&grads.ray_space), &project, ALL);
        through_ellipses.zip(through_rows).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect())
    }
}

/// Gaussians in the picture and beside it, small, wide and thin.
fn gaussians(seed: u64, intrinsics: Intrinsics, options: RenderOptions) -> Scene {
    let mut random = Random::new(seed);
    let mut tensors = vec![Vec::new(); 6];
    let count = 9;
    for i in 0..count {
        let z = 0.9 * 1.4_f64.powi((5 * i % count) as i32);
        // Beyond the picture of a pinhole along one axis or both; what a lens sees ends there.
        let beside = if intrinsics.model == CameraModel::Pinhole && i % 3 != 0 { 1.5 } else { 0.5 };
        tensors[0].extend([random.between(-beside, beside) * z, random.between(-beside, beside) * z, z]);
        tensors[1].extend((0..4).map(|_| random.between(-1.5, 1.5)));
        let size = [0.15, 0.6, 0.4][i % 3] * z;
        let thin = if i % 4 == 1 { 0.05 } else { 0.7 };
        tensors[2].extend([size, size * thin, size * random.between(0.3, 1.0)]);
        tensors[3].push(random.between(0.3, 0.9));
        tensors[5].extend((0..3).map(|_| random.between(0.0, 1.0)));
    }
    tensors[4] = vec![1.0, 0.02, -0.05, 0.1, -0.03, 0.98, 0.04, -0.2, 0.06, -0.02, 1.03, 0.3];
    Scene { tensors, intrinsics, options }
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    let pinhole = Intrinsics { fy: 17.0, cx: 9.0, ..Intrinsics::centred(20, 14, 16.0) };
    let bent = lenses().into_iter().map(|(model, distortion)| Intrinsics { model, distortion, ..pinhole });
    for (seed, intrinsics) in [pinhole, pinhole].into_iter().chain(bent).enumerate() {
        for (blur, antialias) in [(0.3, false), (0.3, true), (0.0, false)] {
            let options = RenderOptions { blur, antialias, ..smooth(0.99) };
            let options = options.with_projection(Projection::RayMax).with_depth(seed % 2 == 0);
            let scene = gaussians(seed as u64, intrinsics, options);
            let beyond =
                scene.projected()[1].chunks_exact(RAY_SPACE).filter(|row| row[4] != 0.0 || row[5] != 0.0).count();
            assert!(intrinsics.model != CameraModel::Pinhole || beyond > 1, "{beyond} beyond the picture");
            let grad = scene.grad(seed as u64 + 40);
            let g = scene.backward(&grad, <[f64]>::to_vec);
            let names = [(&g.means, "means"), (&g.rotations, "rotations"), (&g.scales, "scales")];
            let names = names.into_iter().chain([(&g.opacities, "opacities"), (&g.cam_from_world, "pose")]);
            for (i, (gradient, name)) in names.enumerate() {
                let what = format!("{name}, {:?}, blur {blur}, antialias {antialias}, {seed}", intrinsics.model);
                check_gradient(&what, &scene.tensors[i], gradient, 1, |moved| {
                    let mut at = scene.clone();
                    at.tensors[i] = moved.to_vec();
                    inner_product(&at.planes(), &grad)
                });
            }
        }
    }
}

/// A step of the projected centre, px, moves the Gaussian across the camera's axis as far as a pixel is wide at its depth.
#[test]
fn the_gradient_of_a_projected_centre_is_that_of_a_step_across() {
    let intrinsics = Intrinsics { fy: 17.0, cx: 9.0, ..Intrinsics::centred(20, 14, 16.0) };
    let mut scene = gaussians(5, intrinsics, smooth(0.99).with_projection(Projection::RayMax));
    scene.tensors[4] = POSE.to_vec();
    let g = scene.backward(&scene.grad(6), <[f64]>::to_vec);
    for (i, (mean, gradient)) in scene.tensors[0].chunks_exact(3).zip(g.mean2d.chunks_exact(2)).enumerate() {
        let across = [g.means[3 * i] * mean[2] / intrinsics.fx, g.means[3 * i + 1] * mean[2] / intrinsics.fy];
        assert_close(&format!("Gaussian {i}"), gradient, &across, 1e-12);
    }
}

/// The scene of the hard case "larger than the scene, beside the view".
fn beside() -> Scene {
    let (hard, depth) = ([-5e5, 7e5], 3.0);
    let mean = [(hard[0] - 28.5) / 60.0 * depth, (hard[1] - 22.5) / 63.0 * depth, depth];
    let tensors = [
        [&mean[..], &[0.125, -0.2, 5.0]].concat(),
        [0.9, 0.2, -0.3, 0.25].repeat(2),
        [[1.0, 0.8, 1.2].map(|s| s * 1e7 * depth / 60.0), [1.0, 0.8, 1.25].map(|s| s * 4.0 * 5.0 / 60.0)].concat(),
        vec![0.7; 2],
        POSE.to_vec(),
        vec![0.9, 0.4, 0.2, 0.2, 0.3, 0.9],
    ];
    Scene {
        tensors: tensors.iter().map(|values| rounded(values)).collect(),
        intrinsics: Intrinsics { fx: 60.0, fy: 63.0, cx: 28.5, cy: 22.5, ..Intrinsics::centred(60, 44, 60.0) },
        options: smooth(0.99).with_projection(Projection::RayMax).with_depth(true),
    }
}

/// What correct rounding of the gradients between the stages costs, all else in f64. The gradient of a centre's camera z is the sum of
/// few terms, none of them much larger than the sum.
#[test]
fn rounded_gradients_between_the_stages_keep_their_digits_beside_the_view() {
    let of_centre = |tensors: &[Vec<f64>], seed: u64, pass: fn(&[f64]) -> Vec<f64>| -> Vec<f64> {
        let scene = Scene { tensors: tensors.to_vec(), ..beside() };
        scene.backward(&scene.grad(seed), pass).means[..3].to_vec()
    };
    let scene = beside();
    for seed in 1..=8 {
        let reference =
            PerturbedReference::new(&scene.tensors, |tensors| vec![of_centre(tensors, seed, <[f64]>::to_vec)]);
        let (expected, spread) = (&reference.expected[0], &reference.spread[0]);
        let largest = expected.iter().fold(0.0_f64, |largest, g| largest.max(g.abs()));
        let found = of_centre(&scene.tensors, seed, rounded);
        let used = |k: usize| (found[k] - expected[k]).abs() / (16.0 * spread[k] + 1e-6 * largest);
        let used = [0, 1, 2].map(used);
        assert!(used.iter().all(|used| *used <= 0.5), "loss {seed}: {used:?} ceilings");
    }
}
