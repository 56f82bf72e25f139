//! Tests that every stage on a GPU executes kernels and no CPU twin, with Burn's fusion where it is built in. The test is a
//! process of its own, because the counters are global.

use burn::backend::{Backend, Dispatch};
use burn::tensor::{DType, Tensor};
use splat_op::{Extras, Intrinsics, Projection, RenderOptions, evaluate_sh, intersect, project, rasterize, test_hooks};
use splat_tests::gpu;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host};

#[test]
fn every_stage_executes_kernels_and_no_twin() {
    let Some(device) = gpu() else { return };
    let name = Dispatch::name(device.as_dispatch());
    assert_eq!(name.contains("fusion"), cfg!(feature = "fusion"), "{name}");
    assert!(name.contains("wgpu") || name.contains("cuda") || name.contains("hip"), "{name}");

    let device = device.autodiff();
    let scene = Scene::random(&mut Random::new(1), 50, 2, Intrinsics::centred(40, 30, 35.0));
    // Each stage has its own leaves, because Burn differentiates a graph only once.
    let leaves = || scene.tensors(&device, DType::F32);
    let SceneTensors { splats, camera, .. } = leaves();
    let options = RenderOptions::standard();
    let mut before = test_hooks::dispatches();
    let mut launched = |stage: &str| {
        let after = test_hooks::dispatches();
        assert!(after > before, "{stage} launched nothing");
        assert_eq!(test_hooks::twin_calls(), 0, "{stage} ran on the CPU");
        before = after;
    };

    let projected = project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
    let ellipses = projected.ellipses();
    launched_after(host(ellipses.depth), || launched("project"));
    let loss = (ellipses.mean2d.sum() + ellipses.sigma_u.sum()).backward();
    launched_after(host(splats.means.grad(&loss).expect("tracked")), || launched("the backward pass of project"));

    let SceneTensors { splats, sh, camera, .. } = leaves();
    let colours = evaluate_sh(&sh, &splats.means, &camera).expect("a valid scene");
    launched_after(host(colours.clone()), || launched("sh"));
    let loss = colours.clone().sum().backward();
    launched_after(host(sh.grad(&loss).expect("tracked")), || launched("the backward pass of evaluate_sh"));

    let SceneTensors { splats, camera, background, .. } = leaves();
    let projected = project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
    launched_after(host(projected.ellipses().depth), || launched("project"));
    let intersections = intersect(&projected, &options).expect("a valid scene");
    let pairs: i64 = intersections.counts.clone().into_data().iter::<i64>().sum();
    assert!(pairs > 0);
    launched("intersect");

    let colours = Tensor::from_data(colours.into_data(), &device).require_grad();
    let extras = Extras::default().with_background(background);
    let picture = rasterize(&projected, &colours, &intersections, &extras, &options).expect("a valid scene");
    launched_after(host(picture.colour.clone()), || launched("rasterize"));
    let loss = picture.colour.sum().backward();
    launched_after(host(colours.grad(&loss).expect("tracked")), || launched("the backward pass of rasterize"));

    let along_rays = options.with_projection(Projection::RayMax);
    let SceneTensors { splats, camera, background, .. } = leaves();
    let projected = project(&splats, &camera, &Extras::default(), &along_rays).expect("a valid scene");
    let intersections = intersect(&projected, &along_rays).expect("a valid scene");
    let pairs: i64 = intersections.counts.clone().into_data().iter::<i64>().sum();
    assert!(pairs > 0);
    launched("depth slope and its bounds");
    let extras = Extras::default().with_background(background);
    let colours = Tensor::from_data(colours.into_data(), &device);
    let picture = rasterize(&projected, &colours, &intersections, &extras, &along_rays).expect("a valid scene");
    launched_after(host(picture.colour.clone()), || launched("rasterize_rays"));
    let loss = picture.colour.sum().backward();
    launched_after(host(splats.means.grad(&loss).expect("tracked")), || {
        launched("the backward passes of rasterize_rays and depth slope")
    });
    // The counter of twin calls works.
    let SceneTensors { splats, camera, .. } = scene.tensors(&burn::tensor::Device::flex(), DType::F32);
    project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
    assert_eq!(test_hooks::twin_calls(), 1);
}

/// Runs `check` after results were read, because fused operations run only then.
fn launched_after(read: Vec<f64>, check: impl FnOnce()) {
    assert!(read.iter().any(|value| *value != 0.0), "all zero, which proves nothing");
    check();
}
