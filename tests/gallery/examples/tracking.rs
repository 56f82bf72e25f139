//! Camera tracking (after Yen-Chen et al. 2021, "iNeRF", and Keetha et al. 2024, "SplaTAM"): the pose of an unseen photograph, found
//! by gradient descent through the render of a fixed scene.
//! Run: `cargo run --release -p splat-gallery --example tracking -- tracking.png`.
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use burn_optim::{AdamConfig, GradientsParams};
use glam::{DAffine3, DQuat, DVec3};
use splat_gallery::{SMALL, demo, picture, save, shown, trained};
use splat_model::loss::l1;
use splat_model::trainer::TrainConfig;
use splat_op::{Camera, pose};

const STEPS: usize = 300;

/// The correction of a pose.
#[derive(Module, Debug)]
struct Correction {
    /// `[2, 3]`: rotation, rad, and movement, scene units.
    numbers: Param<Tensor<2>>,
}

/// Angle, degrees, and distance of the centres, scene units, between the pose `[3, 4]` and the true one.
fn error(pose: Tensor<2>, truth: &DAffine3) -> (f64, f64) {
    let numbers: Vec<f64> = pose.into_data().iter::<f64>().collect();
    let column = |j: usize| DVec3::new(numbers[j], numbers[4 + j], numbers[8 + j]);
    let matrix3 = glam::DMat3::from_cols(column(0), column(1), column(2));
    let found = DAffine3 { matrix3, translation: column(3) };
    let between = found * truth.inverse();
    let moved = found.inverse().translation.distance(truth.inverse().translation);
    (DQuat::from_mat3(&between.matrix3).angle_between(DQuat::IDENTITY).to_degrees(), moved)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    let (shots, points) = demo(SMALL, &device)?;
    let (unseen, known) = shots.split_first().ok_or("the demo has photographs")?;
    let scene = trained(known, &points, TrainConfig::for_steps(400))?;

    // Two degrees and a tenth of a scene unit away, at about 4.5 scene units from the scene.
    let truth = unseen.photo.cam_from_world;
    let turned = DQuat::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 2_f64.to_radians());
    let start = DAffine3::from_rotation_translation(turned, DVec3::new(0.06, -0.05, 0.06)) * truth;
    let start = Camera::new(unseen.photo.intrinsics, &start, &device);
    let before = shown(&scene, &start)?.colour;

    let mut correction = Correction { numbers: Param::from_tensor(Tensor::zeros([2, 3], &device)) };
    let pose = |of: &Correction| pose::corrected(&of.numbers.val(), &start.cam_from_world, 1.0);
    let mut optimiser = AdamConfig::new().init();
    for step in 0..STEPS {
        let camera = Camera { cam_from_world: pose(&correction)?, ..start.clone() };
        let loss = l1(shown(&scene, &camera)?.colour, Tensor::from_inner(unseen.image()));
        if step % 60 == 0 {
            let (degrees, units) = error(camera.cam_from_world.inner(), &truth);
            let loss = loss.clone().into_scalar::<f32>();
            println!("step {step:3}  loss {loss:.4}  {degrees:.3}°  {units:.4} scene units");
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &correction);
        let rate = 0.006 * 0.05_f64.powf(step as f64 / STEPS as f64);
        correction = optimiser.step(rate, correction, gradients);
    }
    let found = Camera { cam_from_world: pose(&correction)?, ..start.clone() };
    let (degrees, units) = error(found.cam_from_world.clone().inner(), &truth);
    println!("found {degrees:.3}°  {units:.4} scene units away");
    assert!(degrees < 0.3 && units < 0.03, "the pose was not found");
    save(&picture()?, vec![before, shown(&scene, &found)?.colour, unseen.image()])
}
