//! Scene files with a few bytes per Gaussian.

use std::error::Error;

use burn::tensor::Device;
use glam::DAffine3;
use splat_model::formats::{self, Format, SceneFile};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_op::{Camera, Extras, Intrinsics, RenderOptions, render_view};

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, TestDevice};
use crate::compare::relative_error;
use crate::random::Random;
use crate::scratch::TemporaryFolder;
use crate::tensors::host;

/// Largest error of a picture from a compressed file, relative to its largest element. The formats store colours and opacities in
/// eight bits.
const FILE_BOUND: f64 = 0.05;

pub fn cases() -> Vec<HardCase> {
    let file = |name: &str, why, format: Format, spoil: Spoil| {
        let case = HardCase::check(format!("{format}: {name}"), why, move |place| {
            outcome_of(judge_file(place, format, spoil))
        });
        case.hardness(format!("the bound is {FILE_BOUND} of the largest element"))
    };
    let poison = "a format that cannot represent NaN would draw the Gaussian, and ranges of NaN spoil all others";
    let extremes = "one Gaussian a million units away widens the grid on which all others are placed";
    let mut cases = Vec::new();
    for format in [Format::Spz, Format::Sog] {
        cases.push(file("poisoned Gaussians", poison, format, poisoned));
        cases.push(file("extreme Gaussians", extremes, format, extreme));
    }
    cases
}

/// Adds hard Gaussians to a scene, all behind the camera or unusable, so that a picture shows the others alone.
type Spoil = fn(&mut GaussianRows);

fn push(rows: &mut GaussianRows, mean: [f32; 3], log_scale: f32, logit: f32, length: f32, coefficient: f32) {
    rows.means.push(mean);
    rows.rotations.push([0.5 * length; 4]);
    rows.log_scales.push([log_scale, 0.5 * log_scale, log_scale]);
    rows.logit_opacities.push(logit);
    rows.sh_dc.push([coefficient; 3]);
    rows.sh_rest.extend([-coefficient; 9]);
}

fn poisoned(rows: &mut GaussianRows) {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        push(rows, [bad, 0.0, 0.0], -3.0, 0.0, 1.0, 0.1);
        push(rows, [0.0, 0.0, 2.0], bad, 0.0, 1.0, 0.1);
        push(rows, [0.0, 0.0, 2.0], -3.0, bad, 1.0, 0.1);
        push(rows, [0.0, 0.0, 2.0], -3.0, 0.0, bad, 0.1);
        push(rows, [0.0, 0.0, 2.0], -3.0, 0.0, 1.0, bad);
    }
    push(rows, [0.0, 0.0, 2.0], -3.0, 0.0, 0.0, 0.1);
}

fn extreme(rows: &mut GaussianRows) {
    push(rows, [0.0, 0.0, -1e6], -3.0, 0.0, 1.0, 0.1);
    push(rows, [2e5, -3e5, -1e6], 40.0, 90.0, 1e-20, 1e4);
    push(rows, [0.1, 0.2, -3.0], -50.0, -90.0, 1e18, -1e4);
}

/// 300 Gaussians of degree 1 in view.
fn ordinary() -> GaussianRows {
    let mut random = Random::new(4);
    let mut rows = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
    for _ in 0..300 {
        let mut of = |low: f64, high: f64| random.between(low, high) as f32;
        rows.means.push([of(-0.9, 0.9), of(-0.7, 0.7), of(2.0, 4.0)]);
        rows.rotations.push([of(0.5, 1.0), of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0)]);
        rows.log_scales.push([of(-3.5, -2.0), of(-3.5, -2.0), of(-3.5, -2.0)]);
        rows.logit_opacities.push(of(-2.0, 3.0));
        rows.sh_dc.push([of(-1.5, 1.5), of(-1.5, 1.5), of(-1.5, 1.5)]);
        rows.sh_rest.extend((0..9).map(|_| of(-0.3, 0.3)));
    }
    rows
}

fn outcome_of(judged: Result<CaseOutcome, Box<dyn Error>>) -> CaseOutcome {
    judged.unwrap_or_else(|error| CaseOutcome { failures: vec![error.to_string()], ..CaseOutcome::default() })
}

/// Writes ordinary Gaussians with hard ones, reads them, and compares the picture with that of the ordinary ones.
fn judge_file(place: &TestDevice, format: Format, spoil: Spoil) -> Result<CaseOutcome, Box<dyn Error>> {
    let scratch = TemporaryFolder::new()?;
    let path = scratch.path().join(format!("scene{}", format.extension()));
    let mut rows = ordinary();
    let expected = picture(&rows, &place.device)?;
    spoil(&mut rows);
    let scene = SceneFile { rows, ..SceneFile::default() };
    let written = formats::write(&path, &scene, format)?;
    let (read, _) = formats::read(&path)?;
    let mut outcome = CaseOutcome::default();
    let rows = &read.rows;
    outcome.require(rows.len() == written.rows.len(), || format!("{} rows of {}", rows.len(), written.rows.len()));
    let unusable = (0..rows.len()).filter(|row| !rows.is_usable(*row)).count();
    outcome.require(unusable == 0, || format!("{unusable} Gaussians of the file cannot be rendered"));
    let error = relative_error(&picture(rows, &place.device)?, &expected);
    let used = error / FILE_BOUND;
    outcome.forward = Some(MeasuredDeviation { error, used });
    outcome.require(used <= 1.0, || format!("the picture is off by {error:.2e}"));
    Ok(outcome)
}

fn picture(rows: &GaussianRows, device: &Device) -> Result<Vec<f64>, Box<dyn Error>> {
    let camera = Camera::new(Intrinsics::centred(60, 44, 60.0), &DAffine3::IDENTITY, device);
    let splats = Gaussians::from_rows(rows, device)?.splats();
    Ok(host(render_view(&splats, &camera, &Extras::default(), &RenderOptions::standard())?.colour))
}
