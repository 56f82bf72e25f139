use splat_op::{Extras, RenderOptions, SplatError};

use super::super::effect::mean_of;
use super::*;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{Gaussians, values_of};

fn camera(model: CameraModel) -> (Camera, Device) {
    let device = Device::flex();
    let intrinsics = Intrinsics::centred(32, 24, 40.0).with_lens(model, [0.0; 8]);
    let pose = glam::DAffine3::from_translation(glam::DVec3::new(0.0, 0.0, 4.0));
    (Camera::new(intrinsics, &pose, &device), device)
}

fn optics(config: OpticsConfig, model: CameraModel) -> Result<Optics, CameraModel> {
    let (camera, device) = camera(model);
    Optics::new(config, &[camera.intrinsics; 2], 1.0, &device)
}

fn shown(optics: &mut Optics, model: CameraModel) -> Vec<f32> {
    shown_with(optics, model, 0.0)
}

/// A render with logits that are lower by `faint`.
fn shown_with(optics: &mut Optics, model: CameraModel, faint: f32) -> Vec<f32> {
    let (camera, device) = camera(model);
    let mut rows = random_rows(30, 1, 11);
    rows.logit_opacities.iter_mut().for_each(|logit| *logit -= faint);
    let device = device.autodiff();
    let splats = Gaussians::from_rows(&rows, &device).unwrap().splats();
    let camera = Camera { cam_from_world: Tensor::from_inner(camera.cam_from_world), ..camera };
    let options = RenderOptions::exact();
    let input = RenderInput { splats, camera, extras: Extras::default(), options, edits: Vec::new() };
    let samples = optics.samples(input, EffectContext { view: 1, step: 1, steps: 1, verdict: None });
    let pictures: Result<Vec<_>, SplatError> = samples.iter().map(RenderInput::render).collect();
    values_of(mean_of(pictures.unwrap()).colour.inner())
}

fn difference(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
}

#[test]
fn without_motion_nothing_is_different() {
    let plain = shown(&mut optics(OpticsConfig::default(), CameraModel::Pinhole).unwrap(), CameraModel::Pinhole);
    let both = OpticsConfig { motion: true, rolling: true };
    let mut still = optics(both, CameraModel::Pinhole).unwrap();
    still.exposures[1].set(Tensor::zeros([2, 3], &Device::flex()));
    assert!(difference(&shown(&mut still, CameraModel::Pinhole), &plain) < 1e-6);
    let turned = Tensor::from_floats([[0.0, 0.05, 0.0], [0.0; 3]], &Device::flex());
    still.readouts[1].set(turned);
    assert!(difference(&shown(&mut still, CameraModel::Pinhole), &plain) > 1e-3, "rows that move");
}

/// A lens averages sub-exposures, a pinhole widens ellipses. For a small motion of translucent Gaussians both agree.
#[test]
fn a_lens_and_a_pinhole_show_the_same_motion() {
    let motion = OpticsConfig { motion: true, ..OpticsConfig::default() };
    // An OpenCv camera without distortion is a pinhole under another model.
    let of = |model: CameraModel, turn: f32| {
        let mut optics = optics(motion, model).unwrap();
        optics.exposures[1].set(Tensor::from_floats([[0.0, turn, 0.0], [0.0; 3]], &Device::flex()));
        shown_with(&mut optics, model, 4.0)
    };
    let still = of(CameraModel::Pinhole, 0.0);
    let [averaged, widened] = [CameraModel::OpenCv, CameraModel::Pinhole].map(|model| of(model, 0.04));
    let (apart, moved) = (difference(&averaged, &widened), difference(&still, &widened));
    assert!(apart < 0.35 * moved && moved > 1e-5, "{apart} apart, {moved} moved");
}

#[test]
fn what_a_lens_cannot_show_is_refused() {
    let rolling = OpticsConfig { rolling: true, ..OpticsConfig::default() };
    assert!(matches!(optics(rolling, CameraModel::Fisheye), Err(CameraModel::Fisheye)));
    assert!(optics(OpticsConfig { motion: true, ..OpticsConfig::default() }, CameraModel::Fisheye).is_ok());
}
