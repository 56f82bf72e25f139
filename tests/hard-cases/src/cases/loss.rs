//! The loss and the optimiser where they divide by almost zero, or start or end at zero.

use burn::tensor::{DType, Device};
use splat_model::density::rows::{Gradients, RowEdit, StepRates, Trained};
use splat_model::density::rows_on;
use splat_model::gaussians::{BASE_GROUPS, GaussianRows, Gaussians};
use splat_model::loss::{Truth, d_ssim, photometric, ssim};
use splat_model::metrics::{LARGEST_PSNR_DB, psnr};
use splat_model::optim::{Adam, LearningRates, Moments};

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, TestDevice};
use crate::ceiling::{ceiling_used, moved_value, rounded};
use crate::compare::relative_error;
use crate::random::Random;
use crate::tensors::{host, tensor};

/// Width and height of the pictures, px: larger than the window, so that the border does not affect some pixels.
const SIZE: [usize; 2] = [22, 17];

/// Number of random moves of the inputs by one ulp.
const DRAWS: u64 = 6;

pub fn cases() -> Vec<HardCase> {
    // To first order, one ulp does not change the true variance of a flat picture, so the ceiling is narrow there.
    let of = |name: &str, why, pair: (PictureFn, PictureFn)| {
        HardCase::check(format!("D-SSIM of {name}"), why, move |place| similarity(place, pair.0, pair.1))
            .hardness("σ² = 0")
    };
    let constants = "variance and covariance are zero, and only the constants keep the ratio defined";
    vec![
        of("black against white", constants, (black, white)),
        of("white against white", "the variance is the difference of two equal numbers", (white, white)),
        of("black against black", "everything is zero", (black, black)),
        of("grey against a photograph", "the first picture has no variance", (grey, noise)),
        of("a photograph against grey", "the second picture has no variance", (noise, grey)),
        of("an edge against white", "half of the windows are flat", (edge, white)),
        HardCase::check(
            "PSNR of identical pictures",
            "the logarithm of zero is infinite and would make every mean infinite",
            psnr_ends,
        ),
        HardCase::check("Adam without gradients", "0 / (√0 + ε)", no_gradient).hardness("ε 1e-15"),
        HardCase::check(
            "Adam with gradients of 1e20 and of 1e-30",
            "f32 cannot hold their squares: one overflows, the other underflows to zero",
            wild_gradients,
        )
        .hardness("g² 1e40 and 1e-60"),
        HardCase::check(
            "moments after rows were removed and added",
            "a row that inherits another row's moments jumps at its next step",
            surgery,
        ),
    ]
}

/// Function that returns `[H, W, 3]` values.
type PictureFn = fn() -> Vec<f64>;

fn constant(value: f64) -> Vec<f64> {
    vec![rounded(value); 3 * SIZE[0] * SIZE[1]]
}

fn black() -> Vec<f64> {
    constant(0.0)
}

fn white() -> Vec<f64> {
    constant(1.0)
}

fn grey() -> Vec<f64> {
    constant(0.3)
}

fn noise() -> Vec<f64> {
    Random::new(5).fill(3 * SIZE[0] * SIZE[1], 0.0, 1.0).into_iter().map(rounded).collect()
}

fn edge() -> Vec<f64> {
    (0..3 * SIZE[0] * SIZE[1])
        .map(|i| if i / 3 % SIZE[0] < SIZE[0] / 2 { 0.1_f32.into() } else { 0.9_f32.into() })
        .collect()
}

const SHAPE: [usize; 3] = [SIZE[1], SIZE[0], 3];

/// Computes `1 − SSIM` and its gradient by Burn's autodiff of the plain formulation, in f64.
fn plainly(image: &[f64], truth: &[f64]) -> (f64, Vec<f64>) {
    let device = Device::flex().autodiff();
    let image = tensor::<3>(image, SHAPE, &device, DType::F64).require_grad();
    let loss = ssim(image.clone(), tensor(truth, SHAPE, &device, DType::F64)).neg() + 1.0;
    let grads = loss.backward();
    (loss.into_scalar::<f64>(), host(image.grad(&grads).expect("tracked")))
}

fn similarity(place: &TestDevice, image: PictureFn, truth: PictureFn) -> CaseOutcome {
    let (image, truth) = (image(), truth());
    let (value, gradient) = plainly(&image, &truth);
    let (mut value_spread, mut spread) = (0.0_f64, vec![0.0_f64; gradient.len()]);
    for draw in 0..DRAWS {
        let mut random = Random::new(draw);
        let mut moved =
            |values: &[f64]| values.iter().map(|value| moved_value(*value, &mut random)).collect::<Vec<_>>();
        let (moved_value, moved) = plainly(&moved(&image), &moved(&truth));
        value_spread = value_spread.max((moved_value - value).abs());
        spread.iter_mut().zip(moved.iter().zip(&gradient)).for_each(|(s, (m, g))| *s = s.max((m - g).abs()));
    }
    let device = place.device.clone().autodiff();
    let prepared = Truth::new(tensor(&truth, SHAPE, &place.device, DType::F32));
    let tracked = tensor::<3>(&image, SHAPE, &device, DType::F32).require_grad();
    let loss = d_ssim(tracked.clone(), &prepared);
    let grads = loss.backward();
    let found = host(tracked.grad(&grads).expect("tracked"));
    let found_value = host(loss);

    let mut outcome = CaseOutcome::default();
    // The similarity of two pictures is at most one, and errors of the loss are relative to one.
    let error = (found_value[0] - value).abs();
    let used = error / (16.0 * value_spread + 1e-6);
    outcome.forward = Some(MeasuredDeviation { error, used });
    let scale = gradient.iter().fold(0.0_f64, |largest, g| largest.max(g.abs()));
    let error = relative_error(&found, &gradient) * if scale > 0.0 { 1.0 } else { f64::MIN_POSITIVE };
    outcome.gradient = Some(MeasuredDeviation { error, used: ceiling_used(&found, &gradient, &spread) });
    for (what, score) in [("the loss", outcome.forward), ("its gradient", outcome.gradient)] {
        let used = score.map_or(f64::NAN, |score| score.used);
        outcome.require(used <= 1.0, || format!("{what} uses {used:.2e} of its ceiling"));
    }
    // The gradient stays finite with L1 added, whose derivative jumps where the pictures are equal.
    let tracked = tensor::<3>(&image, SHAPE, &device, DType::F32).require_grad();
    let grads = photometric(tracked.clone(), &prepared, 0.2).backward();
    let finite = host(tracked.grad(&grads).expect("tracked")).iter().all(|g| g.is_finite());
    outcome.require(finite, || "the gradient of the whole loss is not finite".into());
    outcome
}

fn psnr_ends(place: &TestDevice) -> CaseOutcome {
    let mut outcome = CaseOutcome::default();
    let of = |a: PictureFn, b: PictureFn| {
        let picture = |values: Vec<f64>| tensor::<3>(&values, SHAPE, &place.device, DType::F32);
        psnr(picture(a()), picture(b()))
    };
    for picture in [black, white, grey, noise] {
        let found = of(picture, picture);
        outcome.require(found == LARGEST_PSNR_DB, || format!("identical pictures give {found} dB"));
    }
    let found = of(black, white);
    outcome.require(found.abs() < 1e-5, || format!("black against white gives {found} dB"));
    let one_level: PictureFn = || constant(0.3 + 1.0 / 65_535.0);
    let (found, expected) = (of(grey, one_level), 20.0 * 65_535_f64.log10());
    outcome.require((found - expected).abs() < 0.05, || format!("a 16-bit level off gives {found} dB, not {expected}"));
    outcome
}

/// Runs Adam on one parameter. Returns its values at the start and after each step.
fn adam(
    place: &TestDevice,
    start: &[f64],
    gradients: impl Fn(usize) -> Vec<f64>,
    steps: usize,
    rate: f64,
) -> Vec<Vec<f64>> {
    let make = |values: &[f64]| tensor::<1>(values, [values.len()], &place.device, DType::F32);
    let mut param = make(start);
    let mut moments = Moments::new(&param);
    let mut path = vec![host(param.clone())];
    for step in 1..=steps {
        param = Adam::default().step(param, make(&gradients(step)), rate, &mut moments, step);
        path.push(host(param.clone()));
    }
    path
}

fn no_gradient(place: &TestDevice) -> CaseOutcome {
    let mut outcome = CaseOutcome::default();
    let start: Vec<f64> = [0.0, -0.0, 1.5, -1e-40, 1e30].map(rounded).to_vec();
    let path = adam(place, &start, |_| vec![0.0; 5], 20, 0.1);
    // Some devices have no subnormal numbers.
    let same = |found: &[f64]| found.iter().zip(&start).all(|(found, start)| (found - start).abs() < 1e-38);
    outcome.require(path.iter().all(|found| same(found)), || "a parameter without gradients moved".into());
    outcome
}

/// Compares the steps with Adam in f64, whose gradients are clamped to values that f32 can square, as documented.
fn wild_gradients(place: &TestDevice) -> CaseOutcome {
    const RATE: f64 = 0.01;
    let sizes = [1e20, -1e20, 1e17, 1e-5, 1e-15, 1e-30, f64::from(f32::MAX), f64::INFINITY];
    // Large gradients come once, followed by ordinary gradients.
    let gradients = |step: usize| -> Vec<f64> {
        sizes.iter().map(|size| if step <= 3 { rounded(*size) } else { rounded(1e-3 * (step as f64).sin()) }).collect()
    };
    let path = adam(place, &[0.5; 8], gradients, 30, RATE);
    let mut outcome = CaseOutcome::default();
    let finite = path.iter().flatten().all(|value| value.is_finite());
    outcome.require(finite, || "a parameter is not finite".into());
    let largest_step =
        path.windows(2).flat_map(|pair| pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>());
    let largest_step = largest_step.fold(0.0, f64::max);
    // |m̂| / √v̂ is at most √((1 − β₁)² / ((1 − β₂)(1 − β₁² / β₂))), 7.3, and 1 where gradients are alike.
    outcome.require(largest_step <= 7.3 * RATE, || format!("a step of {largest_step:.3} at a rate of {RATE}"));
    // Adam in f64, by the algorithm of the paper.
    let (mut m, mut v, mut expected) = ([0.0; 8], [0.0; 8], [0.5_f64; 8]);
    let mut worst = 0.0_f64;
    for (step, found) in path.iter().enumerate().skip(1) {
        for i in 0..8 {
            let g = gradients(step)[i].clamp(-1e17, 1e17);
            m[i] = 0.9 * m[i] + 0.1 * g;
            v[i] = 0.999 * v[i] + 0.001 * g * g;
            let (m, v) = (m[i] / (1.0 - 0.9_f64.powi(step as i32)), v[i] / (1.0 - 0.999_f64.powi(step as i32)));
            expected[i] -= RATE * m / (v.sqrt() + 1e-15);
            worst = worst.max((found[i] - expected[i]).abs() / RATE);
        }
    }
    // The error as a share of a full step.
    outcome.forward = Some(MeasuredDeviation { error: worst, used: worst / 1e-3 });
    outcome.require(worst <= 1e-3, || format!("the path is off by {worst:.2e} steps"));
    outcome
}

/// Returns `count` rows that differ in every value.
fn rows(count: usize, seed: u64) -> GaussianRows {
    let mut random = Random::new(seed);
    let mut rows = GaussianRows::default();
    for _ in 0..count {
        let mut draw = || random.between(-1.0, 1.0) as f32;
        rows.means.push([(); 3].map(|()| draw()));
        rows.rotations.push([(); 4].map(|()| draw()));
        rows.log_scales.push([(); 3].map(|()| draw()));
        rows.logit_opacities.push(draw());
        rows.sh_dc.push([(); 3].map(|()| draw()));
    }
    rows
}

/// Takes a step in which row `i` has the gradients of `ids[i]`.
fn step(scene: &mut Trained, ids: &[usize], step: usize, device: &Device) {
    let of = |kind: usize, columns: usize, id: usize| {
        Random::new((1000 * step + 10 * id + kind) as u64).fill(columns, -1.0, 1.0)
    };
    let all = |kind: usize, columns: usize| ids.iter().flat_map(|id| of(kind, columns, *id)).collect::<Vec<f64>>();
    let count = ids.len();
    let gradients = (BASE_GROUPS.into_iter().zip([3, 4, 3, 1, 3]).enumerate()).fold(
        Gradients::default(),
        |gradients, (kind, (name, width))| {
            gradients.with(name, tensor(&all(kind, width), [count, width], device, DType::F32))
        },
    );
    let rates = StepRates { rates: LearningRates::default(), means: 0.01, done: 0.0, views: 1 };
    scene.step(gradients, &Adam::default(), &rates, step, None);
}

/// Checks that kept rows continue unchanged and that new rows start without a history.
fn surgery(place: &TestDevice) -> CaseOutcome {
    let device = &place.device;
    let trained = |rows: &GaussianRows| Trained::new(Gaussians::from_rows(rows, device).expect("rows of one length"));
    let (start, added) = (rows(5, 1), rows(2, 2));
    let mut undisturbed = trained(&start);
    let mut edited = trained(&start);
    let ids = [0, 1, 2, 3, 4];
    for scene in [&mut undisturbed, &mut edited] {
        (1..=10).for_each(|number| step(scene, &ids, number, device));
    }
    // The rows in another order, without rows 0 and 2, and with two new rows.
    let mut outcome = CaseOutcome::default();
    let new = Gaussians::from_rows(&added, device).expect("rows of one length");
    let edit = RowEdit::new(rows_on(device, &[4, 1, 3]), rows_on(device, &[0, 0]))
        .with("means", new.means())
        .with("rotations", new.rotations())
        .with("log_scales", new.log_scales())
        .with("logit_opacities", new.logit_opacities())
        .with("sh", new.sh_blocks().remove(0));
    if let Err(error) = edited.edit(&edit) {
        outcome.failures.push(error.to_string());
        return outcome;
    }
    let mut fresh = trained(&added);
    for number in 11..=13 {
        step(&mut undisturbed, &ids, number, device);
        step(&mut edited, &[4, 1, 3, 7, 8], number, device);
        step(&mut fresh, &[7, 8], number, device);
    }
    let (undisturbed, edited, fresh) =
        (undisturbed.gaussians.to_rows(), edited.gaussians.to_rows(), fresh.gaussians.to_rows());
    let row = |rows: &GaussianRows, i: usize| -> Vec<u32> {
        let short = [rows.means[i], rows.log_scales[i], rows.sh_dc[i]];
        let all = short.as_flattened().iter().chain(&rows.rotations[i]).chain(&rows.logit_opacities[i..=i]);
        all.map(|value| value.to_bits()).collect()
    };
    for (new, old) in [(0, 4), (1, 1), (2, 3)] {
        outcome.require(row(&edited, new) == row(&undisturbed, old), || {
            format!("row {old} goes on otherwise than before")
        });
    }
    for (new, first) in [(3, 0), (4, 1)] {
        outcome.require(row(&edited, new) == row(&fresh, first), || format!("the new row {first} has a history"));
    }
    outcome
}
