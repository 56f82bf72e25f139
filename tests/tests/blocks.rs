//! Scenes whose coefficients do not fit one tensor. The largest buffer is lowered, so that a small scene is one of them; this
//! holds for the whole process, so there is one test.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use splat_model::accuracy::Setting;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::rows::{Gradients, GroupGradients};
use splat_model::density::{AdaptiveConfig, DensityConfig, McmcConfig};
use splat_model::effects::background::Background;
use splat_model::evaluate::evaluate;
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::trainer::{Fault, Guard, TrainConfig, Trainer};
use splat_op::{
    Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, colours, project, render_view, test_hooks,
    visible_colours,
};
use splat_tests::gpu;
use splat_tests::scene::host;

/// Size of the largest buffer, bytes. It holds what the loss of a view needs, and the coefficients of degree 3 of 170 Gaussians.
const LIMIT: u64 = 192 * 170;

/// Number of Gaussians of the first step.
const POINTS: usize = 280;

fn photos() -> Vec<Photo> {
    let (width, height) = (30, 24);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |view: usize| Photo {
        name: format!("{view}"),
        intrinsics: Intrinsics::centred(width, height, 34.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.2 * view as f64, 0.0, 3.0)),
        rgb: (0..width * height).flat_map(|i| [byte(2 * i), byte(90 * view + i / 9), byte(i / 7)]).collect(),
        alpha: None,
        mask: None,
    };
    (0..3).map(photo).collect()
}

fn points() -> PointCloud {
    let position = |i: usize| [(i % 20) as f32 / 10.0 - 0.95, (i / 20) as f32 / 10.0 - 0.7, (i % 3) as f32 / 8.0];
    PointCloud { positions: (0..POINTS).map(position).collect(), colours: vec![[90, 140, 60]; POINTS] }
}

/// Sums in the same order in every run.
fn ordered() -> Setting {
    Setting::new([("accumulation", "ordered")]).expect("a dial and a value of it")
}

/// Everything that a run gives.
#[derive(PartialEq)]
struct Outcome {
    rows: GaussianRows,
    losses: Vec<f64>,
    /// Of the run that was resumed from a file halfway.
    resumed: GaussianRows,
    psnr: f64,
    /// Number of blocks after each step.
    blocks: Vec<usize>,
}

fn train(density: DensityConfig, batch: usize, device: &Device) -> Outcome {
    let config = TrainConfig { steps: 14, batch, sh_every: 3, density, dials: ordered(), ..TrainConfig::default() };
    let run = || Trainer::new(photos(), &points(), config.clone(), device).expect("photographs and steps");
    let (mut first, mut second) = (run(), run());
    let (mut losses, mut blocks) = (Vec::new(), Vec::new());
    while !first.is_done() {
        if first.steps_done() == 10 {
            let state = first.save().expect("a sound run");
            second.resume(state).expect("the state of an equal run");
        }
        losses.push(host(first.step().expect("a sound run").loss)[0]);
        blocks.push(first.gaussians().sh_blocks().len());
    }
    while !second.is_done() {
        second.step().expect("a sound run");
    }
    let splats = first.gaussians().untracked().splats();
    let options = first.render_options();
    let scores = evaluate(&splats, &photos(), &Background::Colour([0.0; 3]), &options, |_, _| ());
    Outcome {
        rows: first.gaussians().to_rows(),
        losses,
        resumed: second.gaussians().to_rows(),
        psnr: scores.expect("a sound scene").psnr,
        blocks,
    }
}

#[test]
fn a_scene_in_blocks_is_as_in_one_tensor() {
    let adaptive = AdaptiveConfig {
        every: 4,
        from: 4,
        until_share: 1.0,
        grad_threshold: 1e-5,
        max_splats: 420,
        ..AdaptiveConfig::default()
    };
    let mcmc =
        McmcConfig { every: 4, from: 4, growth: 1.2, dead_opacity: 0.3, max_splats: 420, ..McmcConfig::default() };
    for device in [Some(Device::flex()), gpu()].into_iter().flatten() {
        for (density, batch) in [(adaptive.into(), 1), (mcmc.into(), 2)] {
            test_hooks::lower_limit(u64::MAX);
            let whole = train(density, batch, &device);
            test_hooks::lower_limit(LIMIT);
            let parts = train(density, batch, &device);
            let name = format!("{device:?}, {density:?}");
            assert!(whole.blocks.iter().all(|count| *count == 1), "{name}: {:?}", whole.blocks);
            assert!(parts.blocks[0] == 1 && parts.blocks[13] > 2, "{name}: {:?}", parts.blocks);
            assert!(whole.rows.len() > POINTS, "{name}: nothing was added");
            assert!(whole.rows == whole.resumed, "{name}: resuming changes the run");
            assert!(parts.rows == parts.resumed, "{name}: resuming changes the run in blocks");
            assert_eq!(parts.losses, whole.losses, "{name}");
            assert!(parts.rows == whole.rows, "{name}: blocks change the scene");
            assert_eq!(parts.psnr, whole.psnr, "{name}");
        }
        layer(&device);
        guarded(&device);
        test_hooks::lower_limit(u64::MAX);
        let whole = poisoned(&device);
        test_hooks::lower_limit(LIMIT);
        assert_eq!(poisoned(&device), whole, "{device:?}");
    }
    test_hooks::lower_limit(u64::MAX);
}

/// The layer alone: one tensor is refused, blocks are rendered, and their rows are counted.
fn layer(device: &Device) {
    test_hooks::lower_limit(LIMIT);
    let rows = GaussianRows { sh_degree: 3, ..some_rows() };
    let scene = Gaussians::from_rows(&rows, device).expect("rows of one length");
    let splats = scene.splats();
    let Colour::SphericalHarmonicsBlocks(blocks) = splats.colour.clone() else { panic!("one tensor") };
    let camera = Camera::new(photos()[0].intrinsics, &photos()[0].cam_from_world, device);
    let picture = |colour: Colour, options: RenderOptions| {
        let splats = Splats { colour, ..splats.clone() };
        render_view(&splats, &camera, &Extras::default(), &options).map(|out| host(out.colour))
    };
    let standard = RenderOptions::standard();
    let found = picture(splats.colour.clone(), standard).expect("blocks that fit");
    test_hooks::lower_limit(u64::MAX);
    let one = Colour::SphericalHarmonics(Tensor::cat(blocks.clone(), 0));
    assert!(found.iter().any(|value| *value > 0.1));
    for options in [standard, standard.with_sh_degree(Some(1))] {
        let [expected, found] = [one.clone(), splats.colour.clone()].map(|c| picture(c, options).expect("it fits"));
        assert!(found == expected, "{device:?}");
    }
    assert!(found == picture(one.clone(), standard).expect("it fits"));
    test_hooks::lower_limit(LIMIT);
    let error = picture(one, standard);
    assert!(
        !splat_op::is_gpu(device) || matches!(error, Err(SplatError::TooLarge { what: "sh", .. })),
        "one tensor is not refused"
    );
    let error = picture(Colour::SphericalHarmonicsBlocks(blocks[1..].to_vec()), standard).expect_err("too few rows");
    assert!(matches!(error, SplatError::Shape { name: "sh", .. }), "{error}");
    let empty = Tensor::zeros([0, 16, 3], device);
    let with_an_empty_one = blocks.iter().flat_map(|block| [block.clone(), empty.clone()]).collect();
    assert!(picture(Colour::SphericalHarmonicsBlocks(with_an_empty_one), standard).expect("no row more") == found);
    let none = Gaussians::from_rows(&GaussianRows { sh_degree: 3, ..GaussianRows::default() }, device);
    let none = none.expect("rows of one length").splats();
    let none = Splats { colour: Colour::SphericalHarmonicsBlocks(vec![empty; 2]), ..none };
    assert_eq!(colours(&none, &camera).expect("no rows").dims(), [0, 3]);
    let of_none = project(&none, &camera, &Extras::default(), &standard).expect("no rows");
    let error = visible_colours(&splats, &camera, &of_none, &standard).expect_err("too few ellipses");
    assert!(matches!(error, SplatError::Shape { name: "projected", .. }), "{error}");
    let error = picture(Colour::SphericalHarmonicsBlocks(Vec::new()), standard).expect_err("no rows");
    assert!(matches!(error, SplatError::Shape { name: "sh", .. }), "{error}");
}

/// Returns the losses of a run in which one Gaussian must stay masked, although the first block is sound.
fn poisoned(device: &Device) -> Vec<f64> {
    let config = TrainConfig { steps: 8, sh_every: 1, dials: ordered(), ..TrainConfig::default() };
    let run = || Trainer::new(photos(), &points(), config.clone(), device).expect("photographs and steps");
    let mut before = run();
    (0..4).for_each(|_| drop(before.step().expect("a sound run")));
    let mut state = before.save().expect("a sound run");
    let (mut scene, host_device) = (state.take_part("scene"), Device::flex());
    let mut sh = scene.take_part("sh");
    let values: Tensor<2> = sh.take("values", &host_device).expect("the coefficients");
    let row = Tensor::full([1, 48], f32::NAN, &host_device);
    let (first, last) = (values.clone().narrow(0, 0, POINTS - 40), values.narrow(0, POINTS - 39, 39));
    sh.put("values", Tensor::cat(vec![first, row, last], 0));
    scene.put_part("sh", sh);
    state.put_part("scene", scene);
    let mut after = run();
    after.resume(state).expect("the state of an equal run");
    let losses: Vec<f64> = (0..4).map(|_| host(after.step().expect("a sound run").loss)[0]).collect();
    assert!(losses.iter().all(|loss| loss.is_finite()), "{losses:?}");
    losses
}

/// The guard looks at all blocks.
fn guarded(device: &Device) {
    let mut guard = Guard::new(device);
    let ones = || Tensor::<2>::ones([4, 3], device);
    let gradients = |last: f32| {
        let blocks = vec![Some(ones()), Some(ones()), Some(ones() * last)];
        Gradients(vec![GroupGradients { name: "sh".into(), blocks }])
    };
    let loss = Tensor::ones([1], device);
    let mut fault = |step, last| {
        let found = guard.look(step, 7, &loss, &gradients(last));
        found.and_then(|_| guard.read(true)).err()
    };
    assert_eq!(fault(1, 1.0), None);
    assert_eq!(fault(2, f32::NAN), Some(Fault { step: 2, view: 7, what: "the gradient of `sh`".into() }));
}

fn some_rows() -> GaussianRows {
    let points = points();
    let wave = |i: usize| ((i * 37 % 101) as f32 / 101.0 - 0.5) * 0.6;
    GaussianRows {
        rotations: vec![[1.0, 0.2, -0.1, 0.3]; POINTS],
        log_scales: vec![[-2.5, -3.0, -2.0]; POINTS],
        logit_opacities: (0..POINTS).map(|i| 4.0 * wave(i)).collect(),
        sh_dc: (0..POINTS).map(|i| [wave(i), wave(i + 7), wave(i + 29)]).collect(),
        sh_rest: (0..45 * POINTS).map(wave).collect(),
        means: points.positions,
        sh_degree: 3,
        groups: Vec::new(),
    }
}
