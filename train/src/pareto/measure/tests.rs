use burn::tensor::Device;

use super::super::dials::candidates;
use super::super::reference::tests::{rows, shots};
use super::super::time::ROUNDS_MIN;
use super::*;

fn bench() -> Bench<'static> {
    let base = RenderOptions::standard();
    let (rows, shots) = (rows(60), shots());
    let place = DeviceScene::new(&rows, &shots, [0.2; 3], &Device::flex()).unwrap();
    Bench { place, exact: DeviceScene::in_f64(&rows, &shots, [0.2; 3]).unwrap(), shots, base }
}

#[test]
fn settings_are_as_accurate_as_their_dials_say() {
    let bench = bench();
    let none = |_: &RenderOptions| Ok(None);
    let outcome = bench.run(candidates(&bench.base, false), Duration::ZERO, none).unwrap();
    assert_eq!(outcome.rounds, ROUNDS_MIN);
    let db = |name: &str| outcome.rows.iter().find(|row| row.candidate.name == name).unwrap().error_db().unwrap();
    assert!(db("all accurate") > 100.0, "only rounding is left: {}", db("all accurate"));
    assert!(db("alpha_min 1/1024") > db("alpha_min 8/255") + 6.0);
    let all = outcome.rows.iter().find(|row| row.candidate.name == "all accurate").unwrap();
    let accuracy = all.accuracy.as_ref().unwrap();
    assert!(accuracy.gradient_error < 1e-3 && accuracy.gradient_cosine > 0.999_999, "{accuracy:?}");
    assert!(accuracy.max < 1e-4 && accuracy.max >= accuracy.rms);
    let alone = |dial: &str, value: &str| {
        let found = outcome.alone.iter().find(|alone| alone.dial == dial && alone.value == value);
        decibels(found.unwrap().accuracy.rms)
    };
    assert!(alone("alpha_min", "2^-26") > 100.0 && alone("transmittance_min", "0") == alone("alpha_min", "2^-26"));
    // The standard's own error hides what another dial adds to it.
    assert!(alone("transmittance_min", "1e-4") > db("standard") + 6.0);
    assert!(alone("alpha_max", "0.99") < 90.0 && alone("alpha_max", "1") > 100.0);
}

#[test]
fn a_broken_setting_is_not_timed() {
    let bench = bench();
    let mut broken = candidates(&bench.base, false).remove(1);
    // The dials have the candidate's values; the function is another.
    broken.options = RenderOptions { blur: 300.0, ..broken.options };
    let mut truths = Vec::new();
    bench.truth(&mut truths, &bench.base).unwrap();
    // As if the picture were promised to equal that of the base.
    truths[0].0 = Dial::all_exact(broken.options);
    let error = bench.check(&broken, &mut truths, &|_| Ok(None)).unwrap_err().to_string();
    assert!(error.contains("it is broken"), "{error}");
}

#[test]
fn a_promise_of_the_same_picture_is_kept() {
    let bench = bench();
    let ordered = bench.base.with_accumulation(splat_op::Accumulation::Ordered);
    assert_eq!(bench.same_picture(&ordered), bench.base);
    bench.check_same_picture(&ordered, &bench.base).unwrap();
    let other = RenderOptions { alpha_min: 1.0 / 1024.0, ..bench.base };
    let error = bench.check_same_picture(&other, &bench.base).unwrap_err().to_string();
    assert!(error.contains("changes view 0"), "{error}");
}
