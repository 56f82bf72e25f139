//! Compares the operation with reference vectors computed by gsplat's PyTorch functions (`tests/reference/`), on every device, in
//! f64 where the device supports it, and in f32.

use burn::tensor::{DType, Device};
use splat_op::test_hooks::force_f32_in_f64;
use splat_tests::band::boundary_band;
use splat_tests::compare::{Finding, assert_all, keep_rows, relative_error, row_errors, row_sizes, worst};
use splat_tests::data::announce;
use splat_tests::perturb::{ceiling_used, rounded, ulp_spread};
use splat_tests::reference::{ReferenceVector, read_vectors};
use splat_tests::scene::{LossWeights, Named, RenderOutputs, evaluate};
use splat_tests::{cpu_devices, devices};

/// Tolerances in f64, relative to the largest element of the tensor, and for each row relative to its own length.
const F64_TOLERANCE: f64 = 1e-9;

/// Tolerance in f32 for the relative error of a gradient's row, and the share of rows that may exceed it.
const F32_ROW_TOLERANCE: f64 = 1e-3;
const F32_ROW_EXCEPTIONS: f64 = 1e-3;
/// Share of rows that may be too ill-conditioned for this tolerance.
const F32_ROW_CANCELLING: f64 = 0.01;
/// Share of pixels that may lie in the boundary band.
const BAND_SHARE: f64 = 0.01;

#[test]
fn reference_vectors_in_f64() {
    for vector in read_vectors() {
        for (device_name, device) in cpu_devices() {
            let found = evaluate(&vector.scene, &vector.weights, &vector.options, &device, DType::F64);
            let findings = compare_f64(&vector, &found);
            report(&vector.name, device_name, "f64", &findings);
            assert_all(&findings);
        }
    }
}

#[test]
fn reference_vectors_in_f32() {
    for vector in read_vectors() {
        let reference = RoundedReference::new(&vector, &Device::flex());
        let all = devices().into_iter().map(|(name, device)| (name, device, false));
        for (device_name, device, lacks_avx2) in all.chain([("flex without AVX2", Device::flex(), true)]) {
            let ReferenceVector { scene, options, .. } = &vector;
            force_f32_in_f64(lacks_avx2);
            let found = evaluate(scene, &reference.weights, options, &device, DType::F32);
            force_f32_in_f64(false);
            let findings = reference.compare(&vector, &found);
            report(&vector.name, device_name, "f32", &findings);
            assert_all(&findings);
        }
    }
}

/// Whether the output of each Gaussian is specified.
fn in_front(vector: &ReferenceVector) -> Vec<bool> {
    vector.scene.camera_z().iter().map(|z| *z > vector.options.near).collect()
}

fn compare_f64(vector: &ReferenceVector, found: &RenderOutputs) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut compare = |found: &Named, expected: &Named| {
        assert_eq!(found.name, expected.name);
        let what = format!("{} {} f64", vector.name, expected.name);
        let error = relative_error(&found.values, &expected.values);
        findings.push(Finding { what: what.clone(), error, tolerance: F64_TOLERANCE });
        let error = worst(row_errors(found, expected));
        findings.push(Finding { what: what + " rows", error, tolerance: F64_TOLERANCE });
    };
    let in_front = in_front(vector);
    for (found, expected) in found.stages.iter().zip(&vector.expected.stages) {
        compare(&keep_rows(found, &in_front), &keep_rows(expected, &in_front));
    }
    for (found, expected) in found.pictures.iter().zip(&vector.expected.pictures) {
        compare(found, expected);
    }
    for (found, expected) in found.gradients.iter().zip(&vector.expected.gradients) {
        compare(found, expected);
    }
    findings
}

/// Expected result of an f32 render: the f64 render of the rounded inputs, itself compared with the vectors, and its
/// change by one ulp in every input. Pixels of the boundary band are excluded from the pictures and from the loss, so
/// that the gradients of all other pixels are compared in full.
struct RoundedReference {
    weights: LossWeights,
    expected: RenderOutputs,
    spread: RenderOutputs,
    /// Whether each pixel is compared.
    kept: Vec<bool>,
}

impl RoundedReference {
    fn new(vector: &ReferenceVector, device: &Device) -> Self {
        let (scene, mut weights, options) = rounded(&vector.scene, &vector.weights, &vector.options);
        let kept: Vec<bool> = boundary_band(&scene, &options, device).iter().map(|band| !band).collect();
        for (pixel, _) in kept.iter().enumerate().filter(|(_, kept)| !**kept) {
            weights.image[3 * pixel..3 * pixel + 3].fill(0.0);
            (weights.alpha[pixel], weights.depth[pixel]) = (0.0, 0.0);
        }
        let expected = evaluate(&scene, &weights, &options, device, DType::F64);
        let spread = ulp_spread(&scene, &weights, &options, device, &expected);
        Self { weights, expected, spread, kept }
    }

    fn compare(&self, vector: &ReferenceVector, found: &RenderOutputs) -> Vec<Finding> {
        let mut findings = Vec::new();
        let band = self.kept.iter().filter(|kept| !**kept).count();
        let (error, what) = (band as f64 / self.kept.len() as f64, format!("{} share of band", vector.name));
        findings.push(Finding { what, error, tolerance: BAND_SHARE });

        let in_front = in_front(vector);
        let kept_rows = |tensors: &[Named], kept: &[bool]| -> Vec<Named> {
            tensors.iter().map(|tensor| keep_rows(tensor, kept)).collect()
        };
        let parts = |e: &RenderOutputs| [kept_rows(&e.stages, &in_front), kept_rows(&e.pictures, &self.kept)].concat();
        let outputs = [parts(found), parts(&self.expected), parts(&self.spread)];
        let gradients = [&found.gradients, &self.expected.gradients, &self.spread.gradients];
        for ([found, expected, spread], rows) in tuples(outputs.each_ref())
            .zip(std::iter::repeat(false))
            .chain(tuples(gradients).zip(std::iter::repeat(true)))
        {
            let what = format!("{} {} f32", vector.name, expected.name);
            let error = ceiling_used(&found.values, &expected.values, &spread.values);
            findings.push(Finding { what: what.clone(), error, tolerance: 1.0 });
            if rows {
                findings.extend(judge_rows(&what, found, expected, spread));
            }
        }
        findings
    }
}

/// Counts the rows of a gradient that are off by more than [`F32_ROW_TOLERANCE`], and the rows that it cannot judge.
///
/// The gradient of an opacity is one number, a sum over pixels of terms of both signs. Where the terms cancel, one ulp in the
/// inputs moves the f64 result itself by more than the tolerance, so no f32 computation can meet it. The ceiling per element
/// alone judges such rows, and their number is bounded.
fn judge_rows(what: &str, found: &Named, expected: &Named, spread: &Named) -> [Finding; 2] {
    let conditions = row_sizes(spread, expected);
    let errors = row_errors(found, expected);
    assert_eq!(conditions.len(), errors.len());
    let judged = || errors.iter().zip(&conditions).filter(|(_, condition)| **condition <= F32_ROW_TOLERANCE);
    // The comparison is written so that NaN counts as off.
    let exceptions = judged().filter(|(error, _)| !(**error <= F32_ROW_TOLERANCE)).count();
    let ill = errors.len() - judged().count();
    let (off, cancelling) = (format!("{what} rows off"), format!("{what} rows that cancel"));
    let share = |share: f64| share * errors.len() as f64;
    [
        Finding { what: off, error: exceptions as f64, tolerance: share(F32_ROW_EXCEPTIONS).floor() },
        // A small tensor may have one such row.
        Finding { what: cancelling, error: ill as f64, tolerance: share(F32_ROW_CANCELLING).ceil() },
    ]
}

/// Iterates over the same tensor of three evaluations.
fn tuples(three: [&Vec<Named>; 3]) -> impl Iterator<Item = [&Named; 3]> {
    let [a, b, c] = three;
    a.iter().zip(b).zip(c).map(|((a, b), c)| [a, b, c])
}

/// Prints one line per file with the finding closest to its tolerance, and every finding if requested.
fn report(vector: &str, device: &str, float: &str, findings: &[Finding]) {
    let share = |f: &Finding| f.error / f.tolerance.max(f64::MIN_POSITIVE);
    if std::env::var_os("SPLAT_REFERENCE_VERBOSE").is_some() {
        findings.iter().for_each(|f| announce(&format!("  {}: {:.3e} of {:.3e}", f.what, f.error, f.tolerance)));
    }
    let closest = findings.iter().max_by(|a, b| share(a).total_cmp(&share(b))).expect("findings");
    announce(&format!(
        "{vector} on {device} in {float}: closest to its tolerance is {}, {:.2e} of {:.0e}",
        closest.what, closest.error, closest.tolerance
    ));
}
