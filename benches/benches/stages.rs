//! Each stage on the CPU, forwards, and the whole render backwards. Every bench first compares f32 with the f64 path,
//! which the tests prove against the exact renderer and the reference vectors; a wrong result is not timed.
//!
//! `cargo bench -p splat-benches --bench stages`

use burn::tensor::{DType, Device, Tensor};
use divan::{Bencher, black_box};
use splat_benches::{MEDIUM, SMALL, SyntheticView, share_apart, values};
use splat_op::{Colour, Extras, RenderOptions, blend, project, render, shade, tile};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const VIEWS: [SyntheticView; 2] = [SMALL, MEDIUM];
const OPTIONS: RenderOptions = RenderOptions::standard();

fn main() {
    for view in VIEWS {
        report(view);
    }
    divan::main();
}

/// Prints what the synthetic scene puts the stages to.
fn report(view: SyntheticView) {
    let (device, dtype) = (Device::flex(), DType::F32);
    let projected = project(&view.scene(&device, dtype), &view.camera(&device, dtype), None, &OPTIONS).expect("fits");
    let opacity = values(projected.ellipses().opacity);
    let tiles = tile(&projected, &OPTIONS).expect("options are in range");
    let hits: f64 = tiles.counts.float().sum().into_scalar::<f32>().into();
    let seen = opacity.iter().filter(|&&o| o > 0.0).count();
    println!(
        "{view:?}: {seen} in front of the camera, {hits} hits, {:.1} per Gaussian",
        hits / (0.8 * view.splats as f64)
    );
}

#[divan::bench(args = VIEWS)]
fn project_forward(bencher: Bencher, view: SyntheticView) {
    let run = |dtype| {
        let device = Device::flex();
        project(&view.scene(&device, dtype), &view.camera(&device, dtype), None, &OPTIONS).expect("shapes fit")
    };
    let (found, expected) = (run(DType::F32).ellipses(), run(DType::F64).ellipses());
    assert!(share_apart(&values(found.sigma_u), &values(expected.sigma_u), 1e-4) == 0.0);
    assert!(share_apart(&values(found.sigma_v), &values(expected.sigma_v), 1e-4) == 0.0);
    assert!(share_apart(&values(found.mean2d), &values(expected.mean2d), 1e-3) == 0.0);
    let device = Device::flex();
    let (scene, camera) = (view.scene(&device, DType::F32), view.camera(&device, DType::F32));
    bencher.bench_local(|| black_box(project(&scene, &camera, None, &OPTIONS)));
}

#[divan::bench(args = VIEWS)]
fn shade_forward(bencher: Bencher, view: SyntheticView) {
    let inputs = |dtype| {
        let (scene, camera) = (view.scene(&Device::flex(), dtype), view.camera(&Device::flex(), dtype));
        let Colour::SphericalHarmonics(sh) = scene.colour else { unreachable!("the scene has harmonics") };
        (sh, scene.means, camera)
    };
    let run = |dtype| {
        let (sh, means, camera) = inputs(dtype);
        values(shade(&sh, &means, &camera).expect("shapes fit"))
    };
    assert!(share_apart(&run(DType::F32), &run(DType::F64), 1e-5) == 0.0);
    let (sh, means, camera) = inputs(DType::F32);
    bencher.bench_local(|| black_box(shade(&sh, &means, &camera)));
}

#[divan::bench(args = VIEWS)]
fn tile_lists(bencher: Bencher, view: SyntheticView) {
    let run = |dtype| {
        let device = Device::flex();
        project(&view.scene(&device, dtype), &view.camera(&device, dtype), None, &OPTIONS).expect("shapes fit")
    };
    let counts = |dtype| values(tile(&run(dtype), &OPTIONS).expect("options are in range").counts.float());
    // Lists are conservative: rounding may list a Gaussian that just misses a tile, never the reverse by much.
    assert!(share_apart(&counts(DType::F32), &counts(DType::F64), 1.0) < 1e-2);
    let projected = run(DType::F32);
    bencher.bench_local(|| black_box(tile(&projected, &OPTIONS)));
}

#[divan::bench(args = VIEWS)]
fn blend_forward(bencher: Bencher, view: SyntheticView) {
    verify_picture(view);
    let device = Device::flex();
    let (scene, camera) = (view.scene(&device, DType::F32), view.camera(&device, DType::F32));
    let projected = project(&scene, &camera, None, &OPTIONS).expect("shapes fit");
    let tiles = tile(&projected, &OPTIONS).expect("options are in range");
    let Colour::SphericalHarmonics(sh) = &scene.colour else { unreachable!("the scene has harmonics") };
    let colours = shade(sh, &scene.means, &camera).expect("shapes fit");
    bencher.bench_local(|| black_box(blend(&projected, &colours, &tiles, &Extras::default(), &OPTIONS)));
}

#[divan::bench(args = VIEWS, sample_count = 30)]
fn render_forward_and_backward(bencher: Bencher, view: SyntheticView) {
    verify_picture(view);
    let device = Device::flex().autodiff();
    let mut scene = view.scene(&device, DType::F32);
    scene.means = scene.means.require_grad();
    scene.rotations = scene.rotations.require_grad();
    scene.scales = scene.scales.require_grad();
    scene.opacities = scene.opacities.require_grad();
    if let Colour::SphericalHarmonics(sh) = scene.colour {
        scene.colour = Colour::SphericalHarmonics(sh.require_grad());
    }
    let camera = view.camera(&Device::flex(), DType::F32);
    let weights: Tensor<4> = view.picture(&Device::flex(), DType::F32);
    let weights = Tensor::from_inner(weights);
    bencher.bench_local(|| {
        let rendered = render(&scene, std::slice::from_ref(&camera), &Extras::default(), &OPTIONS).expect("fits");
        black_box((rendered.colour * weights.clone()).sum().backward())
    });
}

/// Pixels at a threshold may differ between the float types; all others agree.
fn verify_picture(view: SyntheticView) {
    let picture = |dtype| values(view.picture(&Device::flex(), dtype));
    let (found, expected) = (picture(DType::F32), picture(DType::F64));
    assert!(share_apart(&found, &expected, 1e-4) < 2e-3);
    assert!(share_apart(&found, &expected, 2e-2) == 0.0);
}
