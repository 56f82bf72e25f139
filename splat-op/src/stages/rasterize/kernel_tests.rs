//! Tests of the kernels of `rasterize` against the CPU twin in f64, within the rounding of f32.

use super::cpu::{rasterize_backward_cpu, rasterize_cpu};
use super::launch::{columns_of, launch_rasterize, launch_rasterize_backward};
use super::layer::KernelShape;
use super::rows::Rows;
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu};
use crate::intersect::Cut;
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::launch::launch_intersect;
use crate::options::{Accumulation, RenderOptions};
use crate::project::COLUMNS;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::ellipses::ellipses;
use crate::testing::gpu::{gpu, gpus};
use crate::testing::random::Random;

pub(super) const ALL: Layers<bool> =
    Layers { projected: true, features: true, background: true, mean2d_abs: true, ray_space: false };

#[derive(Clone)]
pub(super) struct StageInputs {
    name: String,
    projected: Vec<f64>,
    pub features: Vec<f64>,
    pub background: Vec<f64>,
    pub spec: RasterizeSpec,
}

impl StageInputs {
    pub fn random(
        count: usize,
        [width, height]: [usize; 2],
        channels: usize,
        opacity: [f64; 2],
        options: RenderOptions,
    ) -> Self {
        let intrinsics = Intrinsics::centred(width, height, 30.0);
        let seed = (count + 7 * width + channels) as u64;
        let mut random = Random::new(seed);
        let round = |values: Vec<f64>| values.into_iter().map(|v| f64::from(v as f32)).collect();
        Self {
            name: format!("{count} splats, {width} × {height}, {channels} channels, depth {}", options.depth),
            projected: ellipses(seed, count, &intrinsics, opacity),
            features: round(random.fill(count * channels, -1.0, 1.0)),
            background: round(random.fill(channels, -1.0, 1.0)),
            spec: RasterizeSpec { intrinsics, options },
        }
    }

    /// Rounds the thresholds to f32, as the f32 path sees them.
    fn rounded(mut self) -> Self {
        let options = &mut self.spec.options;
        for threshold in [&mut options.alpha_min, &mut options.alpha_max, &mut options.transmittance_min] {
            *threshold = f64::from(*threshold as f32);
        }
        self
    }

    fn inputs(&self) -> Layers<&'_ [f64]> {
        let Self { projected, features, background, .. } = self;
        Layers { projected, features, background, ..Layers::default() }
    }

    fn planes(&self) -> Vec<f64> {
        let lists = intersect_cpu(&self.projected, &self.spec.intrinsics, Cut::of(&self.spec.options));
        rasterize_cpu(self.inputs(), &self.spec, &lists, false).0
    }

    fn backward(&self, grad: &[f64]) -> Layers<Vec<f64>> {
        let lists = intersect_cpu(&self.projected, &self.spec.intrinsics, Cut::of(&self.spec.options));
        let grad = PlaneParts::split(grad, &self.spec, self.background.len());
        rasterize_backward_cpu(self.inputs(), grad, &self.spec, &lists, None, ALL)
    }

    /// Returns the scene with other inputs: projected, features, background.
    fn with(&self, inputs: &[Vec<f64>]) -> Self {
        let [projected, features, background] = [0, 1, 2].map(|i| inputs[i].clone());
        Self { projected, features, background, ..self.clone() }
    }

    /// Returns the pixels whose result jumps when a threshold moves by as much as rounding moves an alpha or a
    /// transmittance.
    fn band(&self) -> Vec<bool> {
        let pixels = self.spec.intrinsics.width * self.spec.intrinsics.height;
        let plain = self.planes();
        let mut band = vec![false; pixels];
        for shift in [1.0 - 1e-4, 1.0 + 1e-4] {
            let mut alpha = self.clone();
            alpha.spec.options.alpha_min *= shift;
            let mut transmittance = self.clone();
            transmittance.spec.options.transmittance_min *= shift;
            for variant in [alpha, transmittance] {
                for (i, (a, b)) in variant.planes().iter().zip(&plain).enumerate() {
                    band[i % pixels] |= a != b;
                }
            }
        }
        band
    }

    pub fn device(&self, gpu: &Gpu) -> Layers<Buffer<f32>> {
        let buffer = |values: &[f64]| Buffer::from_slice(gpu, &values.iter().map(|&v| v as f32).collect::<Vec<_>>());
        Layers {
            projected: buffer(&self.projected),
            features: buffer(&self.features),
            background: buffer(&self.background),
            mean2d_abs: Buffer::new(gpu, 0),
            ray_space: Buffer::new(gpu, 0),
        }
    }

    /// Returns planes and gradients computed on the device.
    fn on(&self, gpu: &Gpu, grad: &[f64], needs: Layers<bool>) -> (Vec<f32>, Layers<Option<Buffer<f32>>>) {
        let inputs = self.device(gpu);
        let lists = launch_intersect(gpu, &inputs.projected, &self.spec.intrinsics, Cut::of(&self.spec.options));
        let grad = Buffer::from_slice(gpu, &grad.iter().map(|&v| v as f32).collect::<Vec<_>>());
        let (planes, trace) = launch_rasterize(gpu, &inputs, &lists, &self.spec, true);
        let plain = launch_rasterize(gpu, &inputs, &lists, &self.spec, false).0.read(gpu);
        let planes = planes.read(gpu);
        assert!(planes == plain, "{}: keeping a trace changes the picture", self.name);
        let trace = trace.expect("asked for");
        (planes, launch_rasterize_backward(gpu, &inputs, &grad, &lists, &trace, &self.spec, needs))
    }

    fn check(self) {
        let scene = self.rounded();
        let band = scene.band();
        let share = band.iter().filter(|&&b| b).count() as f64 / band.len() as f64;
        assert!(share < 0.25, "{}: the band covers {share} of the picture, which then proves little", scene.name);
        let outside = |i: usize, v: f64| if band[i % band.len()] { 0.0 } else { v };
        let mask = |values: Vec<f64>| values.into_iter().enumerate().map(|(i, v)| outside(i, v)).collect::<Vec<_>>();
        let planes = scene.spec.planes(scene.background.len());
        let grad = mask(rounded(&Random::new(3).fill(planes * band.len(), -1.0, 1.0)));
        let inputs = [scene.projected.clone(), scene.features.clone(), scene.background.clone(), grad.clone()];
        // The gradient is zero at pixels in the band, so those of the other pixels prove as much as they can.
        let reference = PerturbedReference::new(&inputs, |inputs| {
            let scene = scene.with(inputs);
            let g = scene.backward(&inputs[3]);
            vec![mask(scene.planes()), g.projected, g.features, g.background, g.mean2d_abs]
        });
        let classes = |rows: usize| vec![Some(0); rows];
        let (count, channels) = (scene.projected.len() / COLUMNS, scene.background.len());
        for (form, gpu) in gpus() {
            for accumulation in [Accumulation::Atomic, Accumulation::Ordered] {
                let name = |what: &str| format!("{}, {form}, {accumulation:?}: {what}", scene.name);
                let mut scene = scene.clone();
                scene.spec.options.accumulation = accumulation;
                let (planes, grads) = scene.on(&gpu, &grad, ALL);
                assert!(planes.iter().all(|v| v.is_finite()), "{}", name("a pixel was not written"));
                let planes: Vec<f32> = planes.iter().enumerate().map(|(i, &v)| outside(i, v.into()) as f32).collect();
                reference.check(&name("planes"), 0, &planes, &classes(planes.len()));
                let found = [grads.projected, grads.features, grads.background, grads.mean2d_abs];
                for (which, (found, rows)) in found.into_iter().zip([count, count, channels, count]).enumerate() {
                    let name = name(["projected", "features", "background", "mean2d_abs"][which]);
                    let found = found.expect("asked for").read(&gpu);
                    reference.check_gradient(&name, which + 1, &found, &classes(rows), &[]);
                }
            }
        }
    }
}

#[test]
fn pictures_and_gradients_agree_with_the_twin() {
    let options = RenderOptions::standard();
    for (count, size) in [(1, [1, 1]), (3, [17, 5]), (100, [33, 47]), (1_000, [100, 70]), (20_000, [331, 203])] {
        StageInputs::random(count, size, 3, [0.02, 1.0], options).check();
    }
}

#[test]
fn any_number_of_channels() {
    for (channels, depth) in
        [(1, false), (2, true), (3, true), (4, true), (11, true), (16, false), (37, false), (64, true)]
    {
        StageInputs::random(300, [50, 35], channels, [0.05, 0.9], RenderOptions::standard().with_depth(depth)).check();
    }
}

#[test]
fn hundreds_of_layers() {
    // Faint Gaussians, so that no pixel finishes early; then opaque ones, so that all do.
    StageInputs::random(3_000, [40, 24], 3, [0.004, 0.01], RenderOptions::standard()).check();
    StageInputs::random(3_000, [40, 24], 3, [0.9, 1.0], RenderOptions::standard()).check();
}

#[test]
fn other_thresholds() {
    StageInputs::random(400, [61, 40], 3, [0.02, 1.0], RenderOptions::exact()).check();
    StageInputs::random(400, [61, 40], 3, [0.02, 1.0], RenderOptions::fast().with_depth(true)).check();
    // Opaque layers let nothing through, and nothing may be divided by the share let through.
    let opaque = RenderOptions { alpha_max: 1.0, ..RenderOptions::exact() };
    StageInputs::random(400, [61, 40], 3, [1.0, 1.0], opaque).check();
}

#[test]
#[ignore = "long: a minute on a software driver"]
fn a_hundred_thousand_splats() {
    StageInputs::random(100_000, [961, 539], 3, [0.02, 1.0], RenderOptions::standard().with_depth(true)).check();
}

#[test]
fn nothing_to_draw() {
    let Some(gpu) = gpu() else { return };
    for projected in [vec![], [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0].repeat(40)] {
        let mut scene =
            StageInputs::random(projected.len() / COLUMNS, [20, 18], 3, [0.1, 0.9], RenderOptions::standard());
        scene.projected = projected;
        let (planes, grads) = scene.on(&gpu, &vec![1.0; 4 * 20 * 18], ALL);
        let background: Vec<f32> = scene.background.iter().map(|&v| v as f32).collect();
        assert!(planes[..3 * 360].chunks(360).zip(background).all(|(plane, b)| plane.iter().all(|&v| v == b)));
        assert!(planes[3 * 360..].iter().all(|&v| v == 0.0));
        assert!(grads.background.expect("asked for").read(&gpu).iter().all(|&v| v == 360.0));
        for zero in [grads.projected, grads.features, grads.mean2d_abs] {
            assert!(zero.expect("asked for").read(&gpu).iter().all(|&v| v == 0.0));
        }
    }
}

#[test]
fn only_what_is_needed() {
    let Some(gpu) = gpu() else { return };
    let scene = StageInputs::random(200, [40, 33], 3, [0.02, 1.0], RenderOptions::standard());
    let grad = Random::new(4).fill(4 * 40 * 33, -1.0, 1.0);
    let all = scene.on(&gpu, &grad, ALL).1;
    let all = [all.projected, all.features, all.background, all.mean2d_abs].map(|b| b.expect("asked for").read(&gpu));
    for mask in 0..16_usize {
        let bit = |i: usize| mask >> i & 1 == 1;
        let needs =
            Layers { projected: bit(0), features: bit(1), background: bit(2), mean2d_abs: bit(3), ray_space: false };
        let some = scene.on(&gpu, &grad, needs).1;
        let some = [some.projected, some.features, some.background, some.mean2d_abs];
        for (i, some) in some.into_iter().enumerate() {
            assert_eq!(some.is_some(), bit(i), "gradient {i} of needs {mask:04b}");
            if let Some(some) = some {
                let tolerance = |v: &f32| 1e-4 * v.abs().max(1e-3);
                let close = some.read(&gpu).iter().zip(&all[i]).all(|(a, b)| (a - b).abs() <= tolerance(b));
                assert!(close, "gradient {i} of needs {mask:04b} differs");
            }
        }
    }
}

#[test]
fn a_gradient_of_the_features_alone_is_one_with_zeros_for_alpha() {
    for (form, gpu) in gpus() {
        for channels in [3, 16] {
            let options = RenderOptions::standard().with_accumulation(Accumulation::Ordered);
            let scene = StageInputs::random(500, [70, 50], channels, [0.02, 1.0], options);
            let mut grad = Random::new(4).fill((channels + 1) * 70 * 50, -1.0, 1.0);
            grad[channels * 70 * 50..].fill(0.0);
            let [all, alone] = [&grad[..], &grad[..channels * 70 * 50]].map(|grad| {
                let grads = scene.on(&gpu, grad, ALL).1;
                let grads = [grads.projected, grads.features, grads.background, grads.mean2d_abs];
                grads.map(|b| b.expect("asked for").read(&gpu))
            });
            assert!(all == alone && all.iter().all(|g| g.iter().any(|v| *v != 0.0)), "{form}, {channels} channels");
        }
    }
}

#[test]
fn ordered_sums_are_the_same_in_every_run() {
    for (form, gpu) in gpus() {
        let options = RenderOptions::standard().with_accumulation(Accumulation::Ordered);
        let scene = StageInputs::random(5_000, [200, 150], 3, [0.02, 1.0], options);
        let grad = Random::new(4).fill(4 * 200 * 150, -1.0, 1.0);
        let run = || {
            let (planes, grads) = scene.on(&gpu, &grad, ALL);
            let grads = [grads.projected, grads.features, grads.background, grads.mean2d_abs];
            (planes, grads.map(|b| b.expect("asked for").read(&gpu).iter().map(|v| v.to_bits()).collect::<Vec<_>>()))
        };
        let first = run();
        for _ in 0..3 {
            assert!(run() == first, "{form}");
        }
    }
}

#[test]
fn buffers_in_several_parts_change_nothing() {
    let Some(gpu) = gpu() else { return };
    let options = RenderOptions::standard().with_accumulation(Accumulation::Ordered);
    for channels in [3, 5] {
        let mut scene = StageInputs::random(1_700, [150, 100], channels, [0.006, 0.02], options);
        // Large ellipses, so that every tile has a long list.
        for row in scene.projected.chunks_exact_mut(COLUMNS) {
            row[2] *= 60.0;
            row[4] *= 60.0;
        }
        let (spec, inputs) = (&scene.spec, scene.device(&gpu));
        let grad = Random::new(4).fill((channels + 1) * 150 * 100, -1.0, 1.0);
        let grad = Buffer::from_slice(&gpu, &grad.iter().map(|&v| v as f32).collect::<Vec<_>>());
        let lists = launch_intersect(&gpu, &inputs.projected, &spec.intrinsics, Cut::of(&spec.options));
        let outcome = |limit: u64, spec: &RasterizeSpec| {
            let limited = Gpu { buffer_limit: limit, ..gpu.clone() };
            let (planes, trace) = launch_rasterize(&limited, &inputs, &lists, spec, true);
            let trace = trace.expect("asked for");
            let grads = launch_rasterize_backward(&limited, &inputs, &grad, &lists, &trace, spec, ALL);
            let grads = [grads.projected, grads.features, grads.background, grads.mean2d_abs];
            let parts = Rows::of_intersections(
                &limited,
                &lists,
                columns_of(KernelShape::of(channels, &spec.options), spec, true),
            );
            let grads = grads.map(|grad| grad.expect("asked for").read(&gpu));
            ([trace.runs(), parts.len()], planes.read(&gpu), grads)
        };
        let (parts, planes, grads) = outcome(gpu.buffer_limit, spec);
        assert_eq!(parts, [1, 1]);
        let limit = 4 * (channels as u64 + 2) * 150 * 100;
        let (parts, split_planes, split_grads) = outcome(limit, spec);
        assert!(parts[0] > 1 && parts[1] > 2, "{channels} channels: {parts:?} parts prove little");
        assert!(split_planes == planes && split_grads == grads, "{channels} channels, {parts:?} parts");
        // Atomic sums differ in their order; all buffers keep to the limit.
        let atomic = RasterizeSpec { options: options.with_accumulation(Accumulation::Atomic), ..*spec };
        let (_, split_planes, split_grads) = outcome(limit, &atomic);
        assert!(split_planes == planes, "{channels} channels");
        for (found, expected) in split_grads.iter().zip(&grads) {
            let largest = expected.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-5 * largest);
            assert!(close, "{channels} channels: a gradient differs");
        }
    }
}

/// The CPU twin decides the same: the distance is undefined or infinite, and no such distance is near enough to show.
#[test]
fn an_ellipse_without_a_defined_alpha_does_not_show() {
    for channels in [3, 5] {
        let options = RenderOptions::standard().with_depth(true).with_accumulation(Accumulation::Ordered);
        let scene = StageInputs::random(60, [40, 33], channels, [0.3, 1.0], options);
        let planes = scene.spec.planes(channels);
        let grad = to_f32(&Random::new(4).fill(planes * 40 * 33, -1.0, 1.0));
        for (form, gpu) in gpus() {
            let sound = scene.device(&gpu);
            let cut = Cut::of(&scene.spec.options);
            let lists = launch_intersect(&gpu, &sound.projected, &scene.spec.intrinsics, cut);
            let grad = Buffer::from_slice(&gpu, &grad);
            let with = |numbers: &[(usize, f32)]| {
                let mut rows = sound.projected.read(&gpu);
                for row in rows.chunks_exact_mut(COLUMNS).step_by(3) {
                    numbers.iter().for_each(|&(column, value)| row[column] = value);
                }
                let inputs = Layers { projected: Buffer::from_slice(&gpu, &rows), ..sound.clone() };
                let (planes, trace) = launch_rasterize(&gpu, &inputs, &lists, &scene.spec, true);
                let trace = trace.expect("asked for");
                let found = launch_rasterize_backward(&gpu, &inputs, &grad, &lists, &trace, &scene.spec, ALL);
                (planes.read(&gpu), found.features.expect("asked for").read(&gpu))
            };
            let expected = with(&[(6, 0.0)]);
            let (nan, infinity) = (f32::NAN, f32::INFINITY);
            let one = [(0, nan), (1, infinity), (2, 0.0), (2, nan), (3, nan), (4, 0.0), (6, nan), (6, infinity)];
            // Times the shear, a distance overflows, and no reciprocal brings it back.
            let sheared = [(3, f32::MAX), (4, infinity)];
            for numbers in one.iter().map(std::slice::from_ref).chain([&sheared[..]]) {
                let (planes, features) = with(numbers);
                assert!(planes == expected.0, "{form}, {channels} channels: {numbers:?} shows");
                assert!(features == expected.1, "{form}, {channels} channels: {numbers:?} changes gradients");
            }
        }
    }
}
