//! Poison: values that are not finite, or barely finite, in each slot of a Gaussian's unconstrained parameters.
//!
//! A poisoned Gaussian must behave as if its opacity were 0: no bit of the pictures and of the other gradients may differ, its
//! own gradients are exactly zero, and it is counted. Finite and usable values must give finite results.

use burn::tensor::{Device, Tensor};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_op::{Accumulation, Camera, Extras, Intrinsics, RenderOptions, render};

use crate::case::{CaseOutcome, HardCase, TestDevice};
use crate::random::Random;
use crate::tensors::host;

const WHY: &str = "a loader, an optimiser or another program may store any value there; one NaN that passes is in every \
                   parameter a step later, and 0 · NaN in a backward pass is enough";

/// A kind of parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    Mean,
    Rotation,
    LogScale,
    LogitOpacity,
    ShDc,
    ShRest,
}

/// All slots, with their names and their numbers of values per Gaussian at degree 1.
pub const SLOTS: [(ParameterKind, &str, usize); 6] = [
    (ParameterKind::Mean, "mean", 3),
    (ParameterKind::Rotation, "quaternion", 4),
    (ParameterKind::LogScale, "log_scale", 3),
    (ParameterKind::LogitOpacity, "logit_opacity", 1),
    (ParameterKind::ShDc, "sh_dc", 3),
    (ParameterKind::ShRest, "sh_rest", 9),
];

/// Values that are put into the slots.
pub const VALUES: [f32; 14] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e18,
    -1e18,
    88.0,
    1e-45,
    -1e-45,
    f32::MIN_POSITIVE,
    1e-39,
    -0.0,
    0.0,
];

/// Number of Gaussians per scene. A poisoned Gaussian needs only one other Gaussian to do harm.
const COUNT: usize = 24;

/// Values of `sh_rest` per Gaussian at degree 1.
const REST: usize = 9;

pub fn cases() -> Vec<HardCase> {
    let of_slot = |(slot, name, columns): (ParameterKind, &str, usize)| {
        HardCase::check(format!("poison in {name}"), WHY, move |place| {
            let scene = Poisoned::new(7);
            let cells = VALUES.iter().enumerate().map(|(i, value)| (5 * i % COUNT, i % columns, *value));
            cells
                .map(|(row, column, value)| scene.judge(place, slot, row, column, value))
                .reduce(CaseOutcome::and)
                .unwrap_or_default()
        })
        .hardness("NaN, ±∞, ±f32::MAX, ±1e18, subnormal, ±0")
    };
    let zero =
        HardCase::check("poison: zero quaternion", "it has no direction, and its normalisation is 0 / 0", |place| {
            Poisoned::new(8).judge_row(place, 3, |rows| rows.rotations[3] = [0.0, -0.0, 0.0, 0.0])
        });
    SLOTS.into_iter().map(of_slot).chain([zero]).collect()
}

/// A valid scene whose Gaussians can be poisoned.
pub struct Poisoned {
    rows: GaussianRows,
    seed: u64,
    options: RenderOptions,
}

/// Results of a render and its backward pass, for comparison bit by bit.
struct RenderBits {
    /// `colour alpha depth` and the gradients that belong to no Gaussian.
    shared: Vec<(&'static str, Vec<f64>)>,
    /// Gradients with rows per Gaussian.
    rows: Vec<(&'static str, Vec<f64>)>,
}

impl Poisoned {
    /// Creates the scene of a seed, anti-aliased if the seed is odd.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut rows = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
        for _ in 0..COUNT {
            let mut draw = |low, high| random.between(low, high) as f32;
            rows.means.push([draw(-1.0, 1.0), draw(-0.7, 0.7), draw(2.0, 4.0)]);
            rows.rotations.push([(); 4].map(|()| draw(-1.0, 1.0)));
            rows.log_scales.push([(); 3].map(|()| draw(-2.5, -0.7)));
            rows.logit_opacities.push(draw(-1.0, 3.0));
            rows.sh_dc.push([(); 3].map(|()| draw(-1.0, 1.5)));
            rows.sh_rest.extend([(); REST].map(|()| draw(-0.3, 0.3)));
        }
        let options = RenderOptions::standard().with_depth(true).with_accumulation(Accumulation::Ordered);
        Self { rows, seed, options: options.with_antialias(seed % 2 == 1) }
    }

    /// Puts `value` into a cell and judges the result.
    pub fn judge(&self, place: &TestDevice, slot: ParameterKind, row: usize, column: usize, value: f32) -> CaseOutcome {
        let outcome = self.judge_row(place, row, |rows| *cell(rows, slot, row, column) = value);
        CaseOutcome {
            failures: outcome
                .failures
                .into_iter()
                .map(|why| format!("{slot:?}[{column}] = {value:e}: {why}"))
                .collect(),
            ..outcome
        }
    }

    /// Changes one Gaussian and judges the result.
    pub fn judge_row(&self, place: &TestDevice, row: usize, poison: impl FnOnce(&mut GaussianRows)) -> CaseOutcome {
        let mut rows = self.rows.clone();
        poison(&mut rows);
        let found = self.evaluate(&rows, &place.device);
        let mut outcome = CaseOutcome::default();
        let tensors = || found.shared.iter().chain(&found.rows);
        for (name, values) in tensors() {
            outcome.require(values.iter().all(|value| value.is_finite()), || format!("{name} is not finite"));
        }
        if rows.is_usable(row) {
            outcome.require(rows.unusable() == 0, || "it is counted, although it is of use".into());
            return outcome;
        }
        outcome.require(rows.unusable() == 1, || format!("{} are counted", rows.unusable()));
        let mut faded = self.rows.clone();
        // The sigmoid of this is 1e-87: no f32 but 0.
        faded.logit_opacities[row] = -200.0;
        let without = self.evaluate(&faded, &place.device);
        for ((name, found), (_, without)) in found.shared.iter().zip(&without.shared) {
            outcome.require(bits(found).eq(bits(without)), || format!("{name} is not that without the Gaussian"));
        }
        for ((name, found), (_, without)) in found.rows.iter().zip(&without.rows) {
            let columns = found.len() / COUNT;
            let (own, others) = split(found, row * columns, columns);
            let (_, expected) = split(without, row * columns, columns);
            outcome.require(own.iter().all(|value| *value == 0.0), || format!("{name} of the Gaussian is {own:?}"));
            outcome.require(bits(&others).eq(bits(&expected)), || format!("{name} of others is not that without it"));
        }
        outcome
    }

    /// Renders the scene and differentiates with respect to every parameter, the pose, the background and both probes.
    fn evaluate(&self, rows: &GaussianRows, device: &Device) -> RenderBits {
        let device = device.clone().autodiff();
        let gaussians = Gaussians::from_rows(rows, &device).expect("rows of one length");
        let leaf = |values: [[f32; 4]; 3]| Tensor::<2>::from_floats(values, &device).require_grad();
        let pose = leaf([[0.995, 0.0, 0.0998, -0.25], [0.0, 1.0, 0.0, 0.05], [-0.0998, 0.0, 0.995, 0.1]]);
        let camera = Camera { intrinsics: Intrinsics::centred(33, 22, 26.0), cam_from_world: pose.clone() };
        let background = Tensor::<1>::from_floats([0.1, 0.4, 0.7], &device).require_grad();
        let probe = || Tensor::<2>::zeros([COUNT, 2], &device).require_grad();
        let (mean2d, mean2d_abs) = (probe(), probe());
        let extras = Extras::default()
            .with_background(background.clone())
            .with_mean2d_probe(mean2d.clone())
            .with_mean2d_abs_probe(mean2d_abs.clone());
        let splats = gaussians.splats();
        let out = render(&splats, &[camera], &extras, &self.options).expect("a valid scene");
        let depth = out.depth.expect("asked for");
        let mut random = Random::new(100 + self.seed);
        let mut weighted = |picture: &Tensor<4>| {
            let weights: Vec<f32> =
                random.fill(picture.shape().num_elements(), -1.0, 1.0).iter().map(|weight| *weight as f32).collect();
            (picture.clone() * Tensor::<1>::from_floats(weights.as_slice(), &device).reshape(picture.dims())).sum()
        };
        // A regulariser, whose gradient reaches Gaussians that were not drawn.
        let loss = weighted(&out.colour) + weighted(&out.alpha) + weighted(&depth) + splats.opacities.clone().mean();
        let grads = loss.backward();
        const TRACKED: &str = "a tracked leaf of the loss";
        RenderBits {
            shared: vec![
                ("the picture", host(out.colour)),
                ("alpha", host(out.alpha)),
                ("depth", host(depth)),
                ("the gradient of the pose", host(pose.grad(&grads).expect(TRACKED))),
                ("the gradient of the background", host(background.grad(&grads).expect(TRACKED))),
            ],
            rows: vec![
                ("the gradient of means", host(gaussians.gradient("means", &grads).expect(TRACKED))),
                ("the gradient of rotations", host(gaussians.gradient("rotations", &grads).expect(TRACKED))),
                ("the gradient of log_scales", host(gaussians.gradient("log_scales", &grads).expect(TRACKED))),
                (
                    "the gradient of logit_opacities",
                    host(gaussians.gradient("logit_opacities", &grads).expect(TRACKED)),
                ),
                ("the gradient of sh", host(gaussians.gradient("sh", &grads).expect(TRACKED))),
                ("the gradient of mean2d", host(mean2d.grad(&grads).expect(TRACKED))),
                ("the absolute gradient of mean2d", host(mean2d_abs.grad(&grads).expect(TRACKED))),
            ],
        }
    }
}

fn cell(rows: &mut GaussianRows, slot: ParameterKind, row: usize, column: usize) -> &mut f32 {
    match slot {
        ParameterKind::Mean => &mut rows.means[row][column],
        ParameterKind::Rotation => &mut rows.rotations[row][column],
        ParameterKind::LogScale => &mut rows.log_scales[row][column],
        ParameterKind::LogitOpacity => &mut rows.logit_opacities[row],
        ParameterKind::ShDc => &mut rows.sh_dc[row][column],
        ParameterKind::ShRest => &mut rows.sh_rest[REST * row + column],
    }
}

fn bits(values: &[f64]) -> impl Iterator<Item = u64> {
    values.iter().map(|value| value.to_bits())
}

/// Splits `values` into `len` values from `at` on and all others.
fn split(values: &[f64], at: usize, len: usize) -> (Vec<f64>, Vec<f64>) {
    (values[at..at + len].to_vec(), [&values[..at], &values[at + len..]].concat())
}
