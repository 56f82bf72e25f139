//! Compares the kernels along rays with the CPU twin in f64, within f32 precision.

use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu};
use crate::intersect::IntersectionLists;
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::launch::{DeviceIntersections, launch_intersect};
use crate::options::{Accumulation, Projection, RenderOptions};
use crate::project::COLUMNS;
use crate::rasterize::cpu::{rasterize_backward_cpu, rasterize_cpu};
use crate::rasterize::launch::{columns_of, launch_rasterize, launch_rasterize_backward};
use crate::rasterize::layer::KernelShape;
use crate::rasterize::rows::Rows;
use crate::rasterize::{Layers, PlaneParts, RasterizeSpec};
use crate::ray_space::launch::launch_bounds;
use crate::ray_space::{RAY_SPACE, bounds_cpu};
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::ellipses::{ellipses, ray_rows};
use crate::testing::gpu::{gpu, gpus};
use crate::testing::random::Random;

const ALL: Layers<bool> =
    Layers { projected: true, ray_space: true, features: true, background: true, mean2d_abs: true };

/// Packed ellipses, rows in ray space, features, background.
#[derive(Clone)]
struct StageInputs {
    name: String,
    inputs: Vec<Vec<f64>>,
    spec: RasterizeSpec,
}

impl StageInputs {
    fn random(
        count: usize,
        [width, height]: [usize; 2],
        channels: usize,
        opacity: [f64; 2],
        options: RenderOptions,
    ) -> Self {
        let intrinsics = Intrinsics::centred(width, height, 30.0);
        let seed = (count + 7 * width + channels) as u64;
        let mut random = Random::new(seed);
        let depth_slopes = (0..count).flat_map(|_| [[-0.2, 0.2], [-0.2, 0.2], [0.01, 0.25]]);
        let depth_slopes: Vec<f64> = depth_slopes.map(|[low, high]| random.between(low, high)).collect();
        let mut options = options;
        for threshold in [&mut options.alpha_min, &mut options.alpha_max, &mut options.transmittance_min] {
            *threshold = f64::from(*threshold as f32);
        }
        let features = random.fill(count * channels, -1.0, 1.0);
        let packed = rounded(&ellipses(seed, count, &intrinsics, opacity));
        let rows = ray_rows(&packed, &depth_slopes, &intrinsics);
        let inputs = [packed, rows, features, random.fill(channels, -1.0, 1.0)];
        Self {
            name: format!("{count} splats, {width} × {height}, {channels} channels"),
            inputs: inputs.iter().map(|values| rounded(values)).collect(),
            spec: RasterizeSpec { intrinsics, options },
        }
    }

    fn with(&self, inputs: &[Vec<f64>]) -> Self {
        Self { inputs: inputs[..4].to_vec(), ..self.clone() }
    }

    fn view(&self) -> Layers<&'_ [f64]> {
        let [projected, ray_space, features, background] = &self.inputs[..] else { unreachable!("four inputs") };
        Layers { projected, ray_space, features, background, mean2d_abs: &[] }
    }

    fn lists(&self) -> IntersectionLists {
        let (camera, options) = (&self.spec.intrinsics, &self.spec.options);
        let bounds = bounds_cpu(&self.inputs[0], &self.inputs[1], &self.spec);
        intersect_cpu(&bounds, camera, options.alpha_min.into())
    }

    fn planes(&self) -> Vec<f64> {
        rasterize_cpu(self.view(), &self.spec, &self.lists(), false).0
    }

    fn backward(&self, grad: &[f64]) -> Layers<Vec<f64>> {
        let grad = PlaneParts::split(grad, &self.spec, self.inputs[3].len());
        rasterize_backward_cpu(self.view(), grad, &self.spec, &self.lists(), None, ALL)
    }

    /// Marks the pixels whose result jumps when rounding moves a threshold.
    fn band(&self) -> Vec<bool> {
        let mut band = vec![false; self.spec.intrinsics.width * self.spec.intrinsics.height];
        let plain = self.planes();
        for shift in [1.0 - 1e-4, 1.0 + 1e-4] {
            let mut alpha = self.clone();
            alpha.spec.options.alpha_min *= shift;
            let mut transmittance = self.clone();
            transmittance.spec.options.transmittance_min *= shift;
            for variant in [alpha, transmittance] {
                for (i, (a, b)) in variant.planes().iter().zip(&plain).enumerate() {
                    band[i % (plain.len() / self.spec.planes(self.inputs[3].len()))] |= a != b;
                }
            }
        }
        band
    }

    fn device(&self, gpu: &Gpu) -> (Layers<Buffer<f32>>, DeviceIntersections) {
        let buffer = |i: usize| Buffer::from_slice(gpu, &to_f32(&self.inputs[i]));
        let inputs = Layers {
            projected: buffer(0),
            ray_space: buffer(1),
            features: buffer(2),
            background: buffer(3),
            mean2d_abs: Buffer::new(gpu, 0),
        };
        let (camera, options) = (&self.spec.intrinsics, &self.spec.options);
        let rows = launch_bounds(gpu, &inputs.projected, &inputs.ray_space, &self.spec);
        let lists = launch_intersect(gpu, &rows, camera, options.alpha_min.into());
        (inputs, lists)
    }

    /// Returns planes and gradients computed on the device.
    fn on(&self, gpu: &Gpu, grad: &[f64], needs: Layers<bool>) -> (Vec<f32>, Layers<Option<Buffer<f32>>>) {
        let (inputs, lists) = self.device(gpu);
        let grad = Buffer::from_slice(gpu, &to_f32(grad));
        let (planes, trace) = launch_rasterize(gpu, &inputs, &lists, &self.spec, true);
        let trace = trace.expect("asked for");
        (planes.read(gpu), launch_rasterize_backward(gpu, &inputs, &grad, &lists, &trace, &self.spec, needs))
    }

    fn check(&self) {
        let band = self.band();
        let share = band.iter().filter(|&&b| b).count() as f64 / band.len() as f64;
        assert!(share < 0.35, "{}: the band covers {share} of the picture, which then proves little", self.name);
        let outside = |i: usize, v: f64| if band[i % band.len()] { 0.0 } else { v };
        let mask = |values: Vec<f64>| values.into_iter().enumerate().map(|(i, v)| outside(i, v)).collect::<Vec<_>>();
        let (count, channels) = (self.inputs[0].len() / COLUMNS, self.inputs[3].len());
        let planes = self.spec.planes(channels);
        let grad = mask(rounded(&Random::new(3).fill(planes * band.len(), -1.0, 1.0)));
        let inputs: Vec<Vec<f64>> = self.inputs.iter().cloned().chain([grad.clone()]).collect();
        // The gradient of a pixel in the band is set to zero, so that the other pixels are compared in full.
        let reference = PerturbedReference::new(&inputs, |inputs| {
            let scene = self.with(inputs);
            let g = scene.backward(&inputs[4]);
            vec![mask(scene.planes()), g.projected, g.ray_space, g.features, g.background, g.mean2d_abs]
        });
        let classes = |rows: usize| vec![Some(0); rows];
        let accumulations = [Accumulation::Atomic, Accumulation::Ordered];
        for ((form, gpu), accumulation) in gpus().iter().flat_map(|gpu| accumulations.map(|order| (gpu, order))) {
            let name = |what: &str| format!("{}, {form}, {accumulation:?}: {what}", self.name);
            let mut scene = self.clone();
            scene.spec.options.accumulation = accumulation;
            let (planes, grads) = scene.on(gpu, &grad, ALL);
            assert!(planes.iter().all(|v| v.is_finite()), "{}", name("a pixel nobody wrote"));
            let planes: Vec<f32> = planes.iter().enumerate().map(|(i, &v)| outside(i, v.into()) as f32).collect();
            reference.check(&name("planes"), 0, &planes, &classes(planes.len()));
            let found = [grads.projected, grads.ray_space, grads.features, grads.background, grads.mean2d_abs];
            for (which, (found, rows)) in found.into_iter().zip([count, count, count, channels, count]).enumerate() {
                let name = name(["projected", "ray_space", "features", "background", "mean2d_abs"][which]);
                let found = found.expect("asked for").read(gpu);
                reference.check_gradient(&name, which + 1, &found, &classes(rows), &[]);
            }
        }
    }
}

#[test]
fn pictures_and_gradients_agree_with_the_twin() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    for (count, size) in [(1, [1, 1]), (3, [17, 5]), (100, [33, 47]), (1_000, [70, 50])] {
        StageInputs::random(count, size, 3, [0.02, 1.0], options.with_depth(count != 3)).check();
    }
}

#[test]
fn any_number_of_channels_and_other_thresholds() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    StageInputs::random(200, [40, 35], 1, [0.05, 0.9], options).check();
    StageInputs::random(200, [40, 35], 17, [0.05, 0.9], options.with_depth(true)).check();
    let faint = RenderOptions { alpha_min: 1e-6, transmittance_min: 0.0, alpha_max: 1.0, ..options };
    StageInputs::random(150, [40, 35], 3, [0.02, 1.0], faint.with_depth(true)).check();
}

/// Renders many times more layers than a tile loads together.
#[test]
fn hundreds_of_layers() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    StageInputs::random(600, [20, 17], 3, [0.9, 1.0], options.with_depth(true)).check();
    // Faint, so that no pixel ends early.
    let mut scene = StageInputs::random(300, [20, 17], 3, [0.006, 0.02], options.with_depth(true));
    let (packed, rows) = scene.inputs.split_at_mut(1);
    for (i, row) in packed[0].chunks_exact_mut(COLUMNS).enumerate().filter(|(_, row)| row[5] > 0.0) {
        row[2] = row[2].max(3.0);
        row[4] = row[4].max(3.0);
        let ray = &mut rows[0][i * RAY_SPACE..][..RAY_SPACE];
        (ray[6], ray[8]) = (row[2], row[4]);
    }
    scene.check();
}

#[test]
fn ordered_sums_are_the_same_in_every_run() {
    let Some(gpu) = gpu() else { return };
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let options = options.with_depth(true).with_accumulation(Accumulation::Ordered);
    let scene = StageInputs::random(400, [70, 50], 3, [0.02, 1.0], options);
    let grad = Random::new(4).fill(5 * 70 * 50, -1.0, 1.0);
    let bits = || {
        let (planes, g) = scene.on(&gpu, &grad, ALL);
        let grads = [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs];
        (planes, grads.map(|buffer| buffer.expect("asked for").read(&gpu)))
    };
    let first = bits();
    assert!(first.1.iter().all(|g| g.iter().any(|value| *value != 0.0)));
    assert!(bits() == first && bits() == first);
}

#[test]
fn buffers_in_several_parts_change_nothing() {
    let Some(gpu) = gpu() else { return };
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let scene =
        StageInputs::random(3_000, [160, 130], 1, [0.02, 1.0], options.with_accumulation(Accumulation::Ordered));
    let grad = Random::new(4).fill(2 * 160 * 130, -1.0, 1.0);
    let lists = scene.device(&gpu).1;
    // Room for the planes, and for the trace of the tile with the longest list.
    let limited = Gpu { buffer_limit: 8 * 160 * 130 + 1024, ..gpu.clone() };
    let columns = columns_of(KernelShape::of(1, &scene.spec.options), &scene.spec, true);
    let parts = Rows::of_intersections(&limited, &lists, columns).len();
    assert!(parts > 1, "{} intersections in one part", lists.intersections);
    let [one, several] = [&gpu, &limited].map(|gpu| {
        let g = scene.on(gpu, &grad, ALL).1;
        [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs].map(|b| b.expect("asked for").read(gpu))
    });
    assert!(one == several, "{parts} parts");
}

#[test]
fn only_what_is_needed_and_nothing_to_draw() {
    let Some(gpu) = gpu() else { return };
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let options = options.with_accumulation(Accumulation::Ordered);
    let scene = StageInputs::random(100, [40, 33], 3, [0.02, 1.0], options);
    let grad = Random::new(4).fill(4 * 40 * 33, -1.0, 1.0);
    let read = |scene: &StageInputs, needs: Layers<bool>| {
        let g = scene.on(&gpu, &grad, needs).1;
        [g.projected, g.ray_space, g.features, g.background, g.mean2d_abs].map(|b| b.map(|b| b.read(&gpu)))
    };
    let all = read(&scene, ALL);
    for alone in 0..5 {
        let [projected, ray_space, features, background, mean2d_abs] = std::array::from_fn(|i| i == alone);
        let needs = Layers { projected, ray_space, features, background, mean2d_abs };
        for (i, found) in read(&scene, needs).iter().enumerate() {
            let expected = all[i].as_ref().filter(|_| i == alone);
            if i == 0 && alone == 0 {
                // Compilers round the sums of a kernel otherwise where it has those of absolute values too.
                let (found, expected) = (found.as_ref().expect("asked for"), expected.expect("asked for"));
                let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-5 * b.abs() + 1e-6;
                assert!(found.len() == expected.len() && found.iter().zip(expected).all(close), "gradient 0 alone");
            } else {
                assert_eq!(found.as_ref(), expected, "gradient {i} of {alone} alone");
            }
        }
    }
    for count in [0, 40] {
        let mut empty = scene.clone();
        empty.inputs[0] = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0].repeat(count);
        empty.inputs[1].truncate(count * RAY_SPACE);
        empty.inputs[2].truncate(count * 3);
        let planes = empty.on(&gpu, &grad, ALL).0;
        let expected = to_f32(&empty.inputs[3]);
        assert!(planes[..3 * 1320].chunks(1320).zip(expected).all(|(plane, b)| plane.iter().all(|&v| v == b)));
        assert!(planes[3 * 1320..].iter().all(|&v| v == 0.0));
        let [projected, ray_space, features, _, absolute] = read(&empty, ALL);
        let zeros = [projected, ray_space, features, absolute].into_iter().flatten().flatten();
        assert!(zeros.into_iter().all(|v| v == 0.0));
    }
}

/// Gaussians that are listed and then have values that are not finite are as invisible as those of opacity zero.
#[test]
fn what_is_not_finite_shows_in_no_pixel() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let options = options.with_accumulation(Accumulation::Ordered);
    let scene = StageInputs::random(60, [40, 33], 3, [0.3, 1.0], options.with_depth(true));
    let grad = Random::new(4).fill(5 * 40 * 33, -1.0, 1.0);
    for (form, gpu) in gpus() {
        let (inputs, lists) = scene.device(&gpu);
        let grad = Buffer::from_slice(&gpu, &to_f32(&grad));
        let with = |column: usize, value: f32| {
            let mut rows = inputs.projected.read(&gpu);
            rows.chunks_exact_mut(COLUMNS).step_by(3).for_each(|row| row[column] = value);
            let inputs = Layers { projected: Buffer::from_slice(&gpu, &rows), ..inputs.clone() };
            let (planes, trace) = launch_rasterize(&gpu, &inputs, &lists, &scene.spec, true);
            let trace = trace.expect("asked for");
            let found = launch_rasterize_backward(&gpu, &inputs, &grad, &lists, &trace, &scene.spec, ALL);
            (planes.read(&gpu), found.features.expect("asked for").read(&gpu))
        };
        let expected = with(6, 0.0);
        let cases = [(6, f32::NAN), (6, f32::INFINITY), (5, f32::NAN), (3, f32::NAN), (0, f32::NAN)];
        for (column, value) in cases {
            assert!(with(column, value) == expected, "{form}: {value} in column {column}");
        }
    }
}
