//! Tests of what numerical dials change on GPUs and what they must not change. Run them with `--ignored`: each dial is
//! a kernel of its own, and a software driver takes half a minute to compile one.

use super::RasterizeSpec;
use super::kernel_tests::{ALL, StageInputs};
use super::launch::{launch_rasterize, launch_rasterize_backward};
use super::layer::BUCKET;
use crate::dials::{Culling, Exponential};
use crate::gpu::{Buffer, Gpu};
use crate::intersect::Cut;
use crate::intersect::launch::launch_intersect;
use crate::options::{Accumulation, RenderOptions};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// Returns the planes and the gradients of ellipses, features, background and absolute values, with ordered
/// accumulation.
fn outcome(scene: &StageInputs, gpu: &Gpu, options: RenderOptions) -> [Vec<f32>; 5] {
    let spec = RasterizeSpec { options: options.with_accumulation(Accumulation::Ordered), ..scene.spec };
    let (camera, inputs) = (&spec.intrinsics, scene.device(gpu));
    let values = spec.planes(scene.background.len()) * camera.width * camera.height;
    let grad: Vec<f32> = Random::new(4).fill(values, -1.0, 1.0).iter().map(|v| *v as f32).collect();
    let lists = launch_intersect(gpu, &inputs.projected, camera, Cut::of(&options));
    let (planes, trace) = launch_rasterize(gpu, &inputs, &lists, &spec, true);
    let trace = trace.expect("asked for");
    let grads = launch_rasterize_backward(gpu, &inputs, &Buffer::from_slice(gpu, &grad), &lists, &trace, &spec, ALL);
    let read = |buffer: Option<Buffer<f32>>| buffer.expect("asked for").read(gpu);
    [planes.read(gpu), read(grads.projected), read(grads.features), read(grads.background), read(grads.mean2d_abs)]
}

/// [`gpus`] without the form that differs only in how it adds: here all forms add in order.
fn forms() -> impl Iterator<Item = (&'static str, Gpu)> {
    gpus().into_iter().filter(|(form, _)| !form.ends_with("float atomics"))
}

fn same_bits(a: &[Vec<f32>; 5], b: &[Vec<f32>; 5]) -> bool {
    a.iter().zip(b).all(|(a, b)| bytemuck::cast_slice::<f32, u32>(a) == bytemuck::cast_slice::<f32, u32>(b))
}

/// Returns the largest difference of each pair, relative to its largest value.
fn differences(a: &[Vec<f32>; 5], b: &[Vec<f32>; 5]) -> [f32; 5] {
    std::array::from_fn(|i| {
        let largest = b[i].iter().fold(0.0_f32, |most, v| most.max(v.abs()));
        a[i].iter().zip(&b[i]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / largest
    })
}

fn longest(scene: &StageInputs, gpu: &Gpu, culling: Culling) -> i32 {
    let cut = Cut { culling, ..Cut::of(&scene.spec.options) };
    let lists = launch_intersect(gpu, &scene.device(gpu).projected, &scene.spec.intrinsics, cut);
    lists.counts.read(gpu).into_iter().max().expect("there are tiles")
}

const BOXES: [Culling; 2] = [Culling::OpacityBox, Culling::BoundingBox];

/// Numbers of channels, and whether depth is rendered: one of each kind of kernel, with an odd number of features. All
/// tests share them, since a software driver takes half a minute to compile each further kernel.
const SHAPES: [(usize, bool); 2] = [(3, false), (5, true)];

#[test]
#[ignore = "long: minutes of compiling on a software driver; `tests/tests/dials.rs` holds what users see"]
fn culling_changes_no_bit_where_a_bucket_holds_each_list() {
    for (channels, depth) in SHAPES {
        let options = RenderOptions::standard().with_depth(depth);
        for (form, gpu) in forms() {
            let scene = StageInputs::random(26, [100, 70], channels, [0.02, 1.0], options);
            let expected = outcome(&scene, &gpu, options);
            assert!(expected.iter().all(|values| values.iter().any(|v| *v != 0.0)), "a scene that proves nothing");
            let least = longest(&scene, &gpu, Culling::Ellipse);
            for culling in BOXES {
                let most = longest(&scene, &gpu, culling);
                assert!(most <= BUCKET as i32 && most > least, "{culling:?} lists {most}, ellipses {least}");
                let found = outcome(&scene, &gpu, options.with_culling(culling));
                assert!(same_bits(&found, &expected), "{form}, {channels} channels, {culling:?}");
            }
        }
    }
}

#[test]
#[ignore = "long: minutes of compiling on a software driver; `tests/tests/dials.rs` holds what users see"]
fn culling_of_long_lists_changes_rounding_alone() {
    for (channels, depth) in SHAPES {
        // No threshold of the transmittance: near one a pixel may finish one layer sooner.
        let options = RenderOptions { transmittance_min: 0.0, ..RenderOptions::standard().with_depth(depth) };
        let scene = StageInputs::random(3_000, [100, 70], channels, [0.02, 0.6], options);
        for (form, gpu) in forms() {
            let expected = outcome(&scene, &gpu, options);
            for culling in BOXES {
                let most = longest(&scene, &gpu, culling);
                let found = outcome(&scene, &gpu, options.with_culling(culling));
                let differences = differences(&found, &expected);
                println!("{form}, {channels} channels, {culling:?}, up to {most} intersections: {differences:?}");
                assert!(differences.iter().all(|d| *d <= 3e-6), "{form}, {channels}, {culling:?}: {differences:?}");
            }
        }
    }
}

#[test]
#[ignore = "long: minutes of compiling on a software driver; `tests/tests/dials.rs` holds what users see"]
fn a_polynomial_differs_from_the_device_by_rounding() {
    for (channels, depth) in SHAPES {
        // Nearly without cuts: near a cut a pair may or may not show.
        let options = RenderOptions::exact().with_depth(depth);
        let scene = StageInputs::random(300, [50, 35], channels, [0.05, 0.9], options);
        for (form, gpu) in forms() {
            let by = |exponential| outcome(&scene, &gpu, options.with_exponential(exponential));
            let library = by(Exponential::Library);
            assert!(same_bits(&by(Exponential::Standard), &library), "{form}: the standard of GPUs");
            let polynomial = by(Exponential::Polynomial);
            assert!(!same_bits(&polynomial, &library), "{form}, {channels} channels: the dial changes nothing");
            let differences = differences(&polynomial, &library);
            println!("{form}, {channels} channels: {differences:?}");
            assert!(differences.iter().all(|d| *d <= 3e-6), "{form}, {channels} channels: {differences:?}");
        }
    }
}
