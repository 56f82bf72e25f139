use splat_op::{Extras, RenderOptions, SplatError};

use super::super::effect::mean_of;
use super::super::testing::{self, average, distance, pose, render, tensor};
use super::*;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{Gaussians, values_of};

fn camera(model: CameraModel) -> (Camera, Device) {
    let device = Device::flex();
    let intrinsics = Intrinsics { model, ..Intrinsics::centred(32, 24, 40.0) };
    let pose = glam::DAffine3::from_translation(glam::DVec3::new(0.0, 0.0, 4.0));
    (Camera::new(intrinsics, &pose, &device), device)
}

fn optics(config: OpticsConfig, model: CameraModel) -> Result<Optics, LensError> {
    let (camera, device) = camera(model);
    Optics::new(config, &[camera.intrinsics; 2], (1.0, 4.0), &device)
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
fn the_parts_of_the_aperture_have_the_moments_of_a_disc() {
    let parts: Vec<AperturePart> = (0..PLACES).map(part).collect();
    for axis in 0..2 {
        let mean = parts.iter().map(|part| part.place[axis]).sum::<f64>() / PLACES as f64;
        let square =
            parts.iter().map(|part| part.place[axis].powi(2) + part.deviation.powi(2)).sum::<f64>() / PLACES as f64;
        assert!(mean.abs() < 1e-12 && (square - 0.25).abs() < 1e-12, "{mean} {square}");
    }
}

#[test]
fn without_motion_and_aperture_nothing_is_different() {
    let plain = shown(&mut optics(OpticsConfig::default(), CameraModel::Pinhole).unwrap(), CameraModel::Pinhole);
    let all = OpticsConfig { motion: true, rolling: true, defocus: true };
    let mut still = optics(all, CameraModel::Pinhole).unwrap();
    let device = Device::flex();
    still.exposures[1].set(Tensor::zeros([2, 3], &device));
    let mut lens = |log_aperture: f32, focus: f32| {
        still.aperture.as_mut().unwrap().set(Tensor::from_floats([[log_aperture]], &device));
        still.foci[1].set(Tensor::from_floats([[focus]], &device));
        difference(&shown(&mut still, CameraModel::Pinhole), &plain)
    };
    assert!(lens(-60.0, 0.25) < 1e-6);
    assert!(lens(-2.0, 1.0) > 1e-3, "an open aperture");
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
    assert!(matches!(optics(rolling, CameraModel::Fisheye), Err(LensError(CameraModel::Fisheye))));
    assert!(optics(OpticsConfig { motion: true, ..OpticsConfig::default() }, CameraModel::Fisheye).is_ok());
}

#[test]
fn through_the_whole_aperture_an_ellipse_is_the_average_over_it() {
    const APERTURE: f64 = 0.12;
    const FOCUS: f64 = 3.6;
    let camera = testing::camera();
    // Points of equal area on a disc, and their opposites.
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let points = (0..32).flat_map(|i| {
        let (radius, angle) = (APERTURE * ((f64::from(i) + 0.5) / 32.0).sqrt(), golden * f64::from(i));
        let (x, y) = (radius * angle.cos(), radius * angle.sin());
        [[x, y], [-x, -y]]
    });
    // The camera moves over the aperture, and the picture moves so that points in focus stay.
    let pictures: Vec<_> = points
        .map(|[x, y]| {
            let mut moved = camera;
            moved.cx += camera.fx * x / FOCUS;
            moved.cy += camera.fy * y / FOCUS;
            let shift = tensor(&[0.0, 0.0, 0.0, -x, 0.0, 0.0, 0.0, -y, 0.0, 0.0, 0.0, 0.0], [3, 4]);
            render(moved, pose() + shift, |projected| projected)
        })
        .collect();
    let truth = average(&pictures);
    let sharp = render(camera, pose(), |projected| projected);
    let lens = tensor(&[APERTURE.ln(), 1.0 / FOCUS], [2]);
    let found = render(camera, pose(), |projected| defocused(&projected, &lens, AperturePart::WHOLE).unwrap());
    let (without, with) = (distance(&sharp, &truth), distance(&found, &truth));
    assert!(without > 4e-4 && with < 0.1 * without, "{with:e}, and {without:e} without an aperture");
}
