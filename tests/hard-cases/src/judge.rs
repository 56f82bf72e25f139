//! Judges cases: computes the reference of a scene, its change with one ulp in the inputs, and the error of each path.

use burn::tensor::{DType, Device};
use glam::{DMat3, DVec3};
use splat_op::{CameraModel, Projection, RenderOptions};

use crate::case::{CaseKind, CaseOutcome, HardCase, Processor, TestDevice};
use crate::compare::relative_error;
use crate::evaluate::{OF_NO_SPLAT, Outputs, culled, evaluate};
use crate::exact::{ExactGaussian, ExactPose, render_exact};
use crate::number::Wide;
use crate::panorama::asymmetries;
use crate::random::Random;
use crate::scene::{HardScene, OutputWeights, Paint, STANDARD, TruthSource};
use crate::tensors::Named;
use crate::textbook::{self, Backward};

mod score;

use score::{columns, judge_rows, keep, score_parts};

/// Result of a case.
pub struct CaseResult {
    /// Outcome of each path, in the given order.
    pub places: Vec<(TestDevice, CaseOutcome)>,
    /// Outcome of the textbook's formulas in f32, where they differ from those of the operation.
    pub textbook: Option<CaseOutcome>,
    /// Largest condition number of a 2D covariance; 1 for a case without scenes.
    pub condition: f64,
    /// Errors of the reference itself.
    pub remarks: Vec<String>,
    /// Whether the case was allowed a bound above the ceiling on any path.
    pub loose: bool,
}

/// Verdict on a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaseVerdict {
    Passed,
    /// The case is within a bound above the ceiling.
    Loose,
    Failed,
}

impl CaseResult {
    /// Verdict over all paths.
    pub fn verdict(&self) -> CaseVerdict {
        let holds = self.remarks.is_empty() && self.places.iter().all(|(_, outcome)| outcome.passed());
        match (holds, self.loose) {
            (false, _) => CaseVerdict::Failed,
            (true, true) => CaseVerdict::Loose,
            (true, false) => CaseVerdict::Passed,
        }
    }

    /// Worst outcome of a kind of path; `None` if no such path ran.
    pub fn of(&self, processor: Processor) -> Option<CaseOutcome> {
        let places = self.places.iter().filter(|(place, _)| place.processor == processor);
        places.map(|(_, outcome)| outcome.clone()).reduce(CaseOutcome::and)
    }

    /// All failures, with the path of each.
    pub fn failures(&self) -> Vec<String> {
        let of_place = |(place, outcome): &(TestDevice, CaseOutcome)| {
            outcome.failures.iter().map(|failure| format!("{}: {failure}", place.name)).collect::<Vec<_>>()
        };
        self.remarks.iter().cloned().chain(self.places.iter().flat_map(of_place)).collect()
    }
}

/// Runs a case on every path.
pub fn judge(case: &HardCase, places: &[TestDevice]) -> CaseResult {
    let places: Vec<&TestDevice> =
        places.iter().filter(|place| !(place.software && case.beyond_software.is_some())).collect();
    let loose = places.iter().any(|place| case.limit(place.processor) > 1.0);
    let mut row = CaseResult { places: Vec::new(), textbook: None, condition: 1.0, remarks: Vec::new(), loose };
    match &case.kind {
        CaseKind::Check(check) => {
            row.places = places.iter().map(|&place| (place.clone(), check(place))).collect();
        }
        CaseKind::Scenes(scenes) => {
            row.places = places.iter().map(|&place| (place.clone(), CaseOutcome::default())).collect();
            for scene in scenes {
                let reference = CaseReference::new(scene);
                row.condition = row.condition.max(reference.condition);
                row.remarks.extend(reference.remarks.iter().map(|remark| format!("{}: {remark}", scene.label)));
                for (place, outcome) in &mut row.places {
                    *outcome = std::mem::take(outcome).and(reference.judge(place, case.limit(place.processor)));
                }
                if let Some(outcome) = reference.textbook() {
                    row.textbook = Some(row.textbook.take().unwrap_or_default().and(outcome));
                }
            }
        }
    }
    row
}

/// Relative change of a threshold by f32 rounding, for finding pixels that jump there.
const CUT_SHIFT: f64 = 1e-4;

/// Share of the f32 ceiling that an f64 result may use.
const F64_SHARE: f64 = 1e-6;

/// An accumulated depth below the smallest f32.
const UNSEEN: f64 = 1e-46;

/// Most pairs of a pixel and a Gaussian for which the textbook runs.
const TEXTBOOK_PAIRS: usize = 20_000_000;

/// Expected result of an f32 render, and its change when every input moves by one ulp.
pub struct CaseReference {
    scene: HardScene,
    weights: OutputWeights,
    expected: Outputs,
    spread: Outputs,
    /// Whether each pixel is compared. Pixels with a decision within rounding error are not.
    kept: Vec<bool>,
    condition: f64,
    remarks: Vec<String>,
}

impl CaseReference {
    pub fn new(scene: &HardScene) -> Self {
        let (device, scene) = (Device::flex(), scene.rounded());
        let mut weights = scene.weights();
        let kept = kept(&scene);
        weights.mask(&kept);
        let plain = within_f32(evaluate(&scene, &weights, &device, DType::F64));
        let wide = scene.truth == TruthSource::Wide;
        let expected = match wide {
            true => within_f32(textbook::evaluate::<Wide>(&scene, &weights, Backward::Kept)),
            false => plain.clone(),
        };
        let mut spread = plain.clone();
        spread.tensors_mut().for_each(|tensor| tensor.values.fill(0.0));
        for draw in 0..scene.draws {
            let mut random = Random::new(draw);
            let (moved, weights) = (scene.moved(&mut random), weights.moved(&mut random));
            let moved = within_f32(evaluate(&moved, &weights, &device, DType::F64));
            for ((spread, moved), plain) in spread.tensors_mut().zip(moved.tensors()).zip(plain.tensors()) {
                for ((spread, moved), plain) in spread.values.iter_mut().zip(&moved.values).zip(&plain.values) {
                    *spread = spread.max((moved - plain).abs());
                }
            }
        }
        let known = scene.paint == Paint::Features(scene.channels());
        let condition = if known && is_pinhole(&scene) { textbook::condition(&scene) } else { 1.0 };
        let mut reference = Self { scene, weights, expected, spread, kept, condition, remarks: Vec::new() };
        reference.check_itself(&plain);
        reference
    }

    /// Compares the reference with the CPU twin in f64, which shares no formula with it, and with the exact renderer where that
    /// has digits left.
    fn check_itself(&mut self, plain: &Outputs) {
        let finite = |outputs: &Outputs| outputs.tensors().all(|tensor| tensor.values.iter().all(|v| v.is_finite()));
        if !finite(&self.expected) || !finite(&self.spread) {
            self.remarks.push("the reference is not finite".into());
        }
        if self.scene.panorama {
            self.remarks.extend(asymmetries(&self.scene, &self.weights, plain));
        }
        let outcome = self.compare(plain, F64_SHARE);
        self.remarks.extend(outcome.failures.into_iter().map(|failure| format!("f64 against reference: {failure}")));
        let options = &self.scene.options;
        let cuts = options.alpha_min > 0.0 || options.transmittance_min > 0.0;
        let limited = self.scene.opacities.iter().any(|opacity| *opacity > options.alpha_max);
        // With per-ray rasterization the exact renderer inverts 3D covariances.
        let (condition, most, rounding) = match along_rays(options) {
            true => (self.condition.max(solid_condition(&self.scene)), 1e6, 1e-13),
            false => (self.condition, 1e9, 1e-14),
        };
        let parallel = self.scene.intrinsics.model == CameraModel::Orthographic;
        let known = self.scene.truth == TruthSource::Wide || along_rays(options) || parallel;
        let features = self.scene.paint == Paint::Features(self.scene.channels());
        if known && features && !self.scene.stored && !cuts && !limited && condition < most {
            let found = exact(&self.scene);
            for (found, expected) in found.iter().zip(&self.expected.pictures) {
                let error = relative_error(found, &expected.values);
                let tolerance = 1e-12 + rounding * condition;
                if !(error <= tolerance) {
                    let name = expected.name;
                    self.remarks.push(format!("{name}: the exact renderer is off by {error:.1e} of {tolerance:.1e}"));
                }
            }
        }
    }

    /// Judges a path by every requirement.
    fn judge(&self, place: &TestDevice, limit: f64) -> CaseOutcome {
        let (scene, label) = (&self.scene, &self.scene.label);
        let device = &place.device;
        let found = evaluate(scene, &self.weights, device, DType::F32);
        let mut outcome = self.compare(&found, limit);
        let culled = culled(scene, device, DType::F32);
        outcome.require(culled == scene.culled, || format!("culled {culled:?}, expected {:?}", scene.culled));
        let standard = HardScene { options: with_cuts(&scene.options), ..scene.clone() };
        let cut = evaluate(&standard, &self.weights, device, DType::F32);
        for tensor in cut.tensors() {
            let finite = tensor.values.iter().all(|v| v.is_finite());
            outcome.require(finite, || format!("{} is not finite with the standard cuts", tensor.name));
        }
        if scene.neighbours > 0 {
            outcome = outcome.and(self.judge_neighbours(&found, place));
        }
        outcome.failures.iter_mut().for_each(|failure| *failure = format!("{label}: {failure}"));
        outcome
    }

    /// Checks that the neighbours have the same bits as without the hard Gaussians: their gradients, and the pixels that no hard
    /// Gaussian reaches.
    fn judge_neighbours(&self, found: &Outputs, place: &TestDevice) -> CaseOutcome {
        let mut outcome = CaseOutcome::default();
        let hard = self.scene.count() - self.scene.neighbours;
        let (hard_ones, neighbours) = (self.scene.rows(0..hard), self.scene.rows(hard..self.scene.count()));
        // The accumulated depth, because alpha is a difference from one and cannot represent 1e-17.
        let reach = evaluate(&hard_ones, &self.weights, &Device::flex(), DType::F64).pictures.swap_remove(2).values;
        let alone = evaluate(&neighbours, &self.weights, &place.device, DType::F32);
        let seen = |pixel: usize| reach[pixel] <= UNSEEN;
        let shows = alone.pictures[1].values.iter().enumerate().any(|(pixel, alpha)| seen(pixel) && *alpha > 0.1);
        outcome.require(shows, || "the neighbour is covered by the hard Gaussians".into());
        for (found, alone) in found.pictures.iter().zip(&alone.pictures) {
            let rows = found.values.chunks(found.columns).zip(alone.values.chunks(alone.columns)).enumerate();
            let changed = rows.filter(|(pixel, (found, alone))| seen(*pixel) && found != alone).count();
            outcome.require(changed == 0, || format!("{}: {changed} pixels of a neighbour change", found.name));
        }
        for (found, alone) in found.gradients[..OF_NO_SPLAT].iter().zip(&alone.gradients) {
            let same = found.values[hard * found.columns..] == alone.values;
            outcome.require(same, || format!("{}: the gradient of a neighbour changes", found.name));
        }
        outcome
    }

    /// Judges the textbook's formulas in f32; `None` where they equal those of the operation or would take too long.
    fn textbook(&self) -> Option<CaseOutcome> {
        let scene = &self.scene;
        let pairs = scene.count() * self.kept.len();
        let knows =
            scene.paint == Paint::Features(scene.channels()) && !along_rays(&scene.options) && is_pinhole(scene);
        (knows && pairs <= TEXTBOOK_PAIRS).then(|| {
            let found = textbook::evaluate::<f32>(scene, &self.weights, Backward::Dividing);
            self.compare(&found, 1.0)
        })
    }

    /// Compares pictures and gradients with `limit` times the ceiling.
    fn compare(&self, found: &Outputs, limit: f64) -> CaseOutcome {
        let mut outcome = CaseOutcome::default();
        for (i, found) in found.pictures.iter().enumerate() {
            let (expected, spread) = (&self.expected.pictures[i], &self.spread.pictures[i]);
            let parts = [found, expected, spread].map(|tensor| columns(&keep(tensor, &self.kept)));
            let score = score_parts(&parts, &mut outcome, limit);
            outcome.forward = Some(outcome.forward.map_or(score, |sum| sum.worst(score)));
        }
        let hard = self.scene.count() - self.scene.neighbours;
        for (i, found) in found.gradients.iter().enumerate() {
            let (expected, spread) = (&self.expected.gradients[i], &self.spread.gradients[i]);
            // Large values of the hard Gaussians must not excuse errors of the neighbours, nor vice versa.
            let classes = |tensor: &Named| -> Vec<Named> {
                if i >= OF_NO_SPLAT {
                    return vec![tensor.clone()];
                }
                let (hard, neighbours) = tensor.values.split_at(hard * tensor.columns);
                [hard, neighbours].map(|values| Named { values: values.to_vec(), ..tensor.clone() }).to_vec()
            };
            let parts = [found, expected, spread].map(classes);
            let score = score_parts(&parts, &mut outcome, limit);
            outcome.gradient = Some(outcome.gradient.map_or(score, |sum| sum.worst(score)));
            let [found, expected, spread] = &parts;
            for ((found, expected), spread) in found.iter().zip(expected).zip(spread) {
                judge_rows(found, expected, spread, limit, &mut outcome);
            }
        }
        outcome
    }
}

/// Clamps values to the range of f32.
fn within_f32(mut outputs: Outputs) -> Outputs {
    let largest = f64::from(f32::MAX);
    let values = outputs.tensors_mut().flat_map(|tensor| &mut tensor.values);
    values.for_each(|value| *value = value.clamp(-largest, largest));
    outputs
}

/// Whether each pixel is unchanged when cuts move within rounding error.
fn kept(scene: &HardScene) -> Vec<bool> {
    let options = &scene.options;
    let pixels = scene.intrinsics.width * scene.intrinsics.height;
    let cuts = options.alpha_min > 0.0 || options.transmittance_min > 0.0;
    if !cuts || scene.truth == TruthSource::Twin {
        return vec![true; pixels];
    }
    let picture = |options: RenderOptions| textbook::pictures::<Wide>(scene, &options);
    let plain = picture(*options);
    let mut variants = Vec::new();
    for factor in [1.0 - CUT_SHIFT, 1.0 + CUT_SHIFT] {
        variants.push(picture(options.with_alpha_min(options.alpha_min * factor)));
        variants.push(picture(options.with_transmittance_min(options.transmittance_min * factor)));
    }
    (0..pixels).map(|pixel| variants.iter().all(|variant| variant[pixel] == plain[pixel])).collect()
}

/// Whether the textbook knows the camera.
fn is_pinhole(scene: &HardScene) -> bool {
    scene.intrinsics.model == CameraModel::Pinhole && !scene.panorama
}

/// Whether the options ask for per-ray rasterization, which the textbook does not cover.
fn along_rays(options: &RenderOptions) -> bool {
    options.projection != Projection::Affine
}

/// Largest condition number of a 3D covariance, where a centre's depth counts as an axis if it is the shortest length. Cameras
/// stand at the origin.
fn solid_condition(scene: &HardScene) -> f64 {
    let ratio = |(scale, mean): (&[f64], &[f64])| {
        let longest = scale.iter().fold(0.0_f64, |most, s| most.max(*s));
        longest / scale.iter().fold(mean[2].abs(), |least, s| least.min(*s))
    };
    scene.scales.chunks(3).zip(scene.means.chunks(3)).map(ratio).fold(1.0, f64::max).powi(2)
}

/// The standard cuts, with the scene's other options.
fn with_cuts(options: &RenderOptions) -> RenderOptions {
    options.with_alpha_min(STANDARD.alpha_min).with_transmittance_min(STANDARD.transmittance_min)
}

/// Renders `image alpha depth` with the exact renderer.
fn exact(scene: &HardScene) -> [Vec<f64>; 3] {
    let gaussian = |i: usize| ExactGaussian {
        mean: DVec3::from_slice(&scene.means[3 * i..]),
        rotation: std::array::from_fn(|k| scene.quats[4 * i + k]),
        scale: DVec3::from_slice(&scene.scales[3 * i..]),
        opacity: scene.opacities[i],
        features: scene.colours[scene.channels() * i..scene.channels() * (i + 1)].to_vec(),
    };
    let gaussians: Vec<ExactGaussian> = (0..scene.count()).map(gaussian).collect();
    let p = &scene.pose;
    let rows = [[p[0], p[1], p[2]], [p[4], p[5], p[6]], [p[8], p[9], p[10]]];
    let pose = ExactPose {
        rotation: DMat3::from_cols_array_2d(&rows).transpose(),
        translation: DVec3::new(p[3], p[7], p[11]),
    };
    let pixels = render_exact(&gaussians, &pose, &scene.intrinsics, &scene.background, &scene.options);
    [
        pixels.iter().flat_map(|pixel| pixel.features.clone()).collect(),
        pixels.iter().map(|pixel| pixel.alpha).collect(),
        pixels.iter().map(|pixel| pixel.depth).collect(),
    ]
}

#[cfg(test)]
mod tests;
