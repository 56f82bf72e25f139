//! Camera tracking (after Keetha et al. 2024, "SplaTAM", and Yen-Chen et al. 2021, "iNeRF"): the pose of a photograph that was not
//! trained on, by gradient descent through the render of a fixed scene.
//! Run with a capture: `cargo run --release -p splat-model --example camera_tracking -- CAPTURE`.
use std::path::Path;

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use burn_optim::{AdamConfig, GradientsParams};
use splat_model::capture::{Capture, load_all};
use splat_model::loss::{Truth, photometric};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Colour, Extras, Splats, pose, render_view};

/// Steps of the descent.
const STEPS: usize = 150;

#[derive(Module, Debug)]
struct Pose {
    /// `[2, 3]`: rotation, rad, and movement, in units of the scene's extent.
    correction: Param<Tensor<2>>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("pass the folder of a capture")?;
    let capture = Capture::load(Path::new(&folder))?;
    let mut photos = load_all(&capture.views, Some(96), |_| {})?;
    let unseen = photos.swap_remove(0);
    let device = Device::flex();
    let mut trainer = Trainer::new(photos, &capture.points, TrainConfig::for_steps(250), &device)?;
    while !trainer.is_done() {
        trainer.step()?;
    }

    // The scene as constants, and the camera a twentieth of a radian and of the extent away from the truth.
    let tracked = device.clone().autodiff();
    let plain = trainer.gaussians().untracked().splats();
    let Colour::SphericalHarmonics(sh) = plain.colour else { return Err("a scene of one block".into()) };
    let splats = Splats {
        means: Tensor::from_inner(plain.means),
        rotations: Tensor::from_inner(plain.rotations),
        scales: Tensor::from_inner(plain.scales),
        opacities: Tensor::from_inner(plain.opacities),
        colour: Colour::SphericalHarmonics(Tensor::from_inner(sh)),
    };
    let size = [unseen.intrinsics.height, unseen.intrinsics.width, 3];
    let numbers: Vec<f32> = unseen.rgb.iter().map(|value| f32::from(*value) / 255.0).collect();
    let truth = Truth::new(Tensor::from_data(TensorData::new(numbers, size), &device));
    let given = Camera::new(unseen.intrinsics, &unseen.cam_from_world, &tracked);
    let extent = trainer.extent();
    let start = Tensor::<2>::from_floats([[0.06, -0.05, 0.04], [0.03, 0.02, -0.03]], &tracked);
    let mut model = Pose { correction: Param::from_tensor(start) };
    let mut optimiser = AdamConfig::new().init();
    let away = |model: &Pose| {
        let numbers: Vec<f32> = model.correction.val().inner().into_data().iter().collect();
        let length = |part: &[f32]| part.iter().map(|x| x * x).sum::<f32>().sqrt();
        (length(&numbers[..3]).to_degrees(), length(&numbers[3..]))
    };
    let before = away(&model);
    for step in 0..=STEPS {
        if step % 50 == 0 {
            let (degrees, share) = away(&model);
            println!("step {step:3}  {degrees:.3}° and {share:.4} of the extent from the truth");
        }
        let moved = pose::corrected(&model.correction.val(), &given.cam_from_world, extent)?;
        let camera = Camera { cam_from_world: moved, ..given.clone() };
        let picture = render_view(&splats, &camera, &Extras::default(), &trainer.render_options())?.colour;
        let gradients = GradientsParams::from_grads(photometric(picture, &truth, 0.2).backward(), &model);
        model = optimiser.step(0.004 * 0.02_f64.powf(step as f64 / STEPS as f64), model, gradients);
    }
    let after = away(&model);
    assert!(after.0 < 0.25 * before.0 && after.1 < 0.25 * before.1, "the pose was not found");
    Ok(())
}
