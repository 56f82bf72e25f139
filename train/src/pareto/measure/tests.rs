use burn::tensor::Device;

use super::super::dials::candidates;
use super::super::reference::tests::{photos, rows};
use super::*;

fn bench(photos: &[Photo]) -> Bench<'_> {
    Bench::new(&rows(60), photos, [0.2; 3], RenderOptions::standard(), &Device::flex()).unwrap()
}

fn no_score(_: &RenderOptions) -> Result<(f64, f64)> {
    Ok((20.0, 0.5))
}

#[test]
fn settings_are_as_accurate_as_their_dials_say() {
    let photos = photos();
    let mut bench = bench(&photos);
    // Which is no dial.
    bench.base.alpha_max = 1.0;
    let outcome = bench.run(candidates(&bench.base, false), Duration::ZERO, no_score).unwrap();
    assert_eq!(outcome.rounds, ROUNDS_MIN);
    let db = |name: &str| outcome.rows.iter().find(|row| row.candidate.name == name).unwrap().error_db().unwrap();
    assert!(db("exact") > 100.0, "only rounding is left: {}", db("exact"));
    assert!(db("alpha_min 1/1024") > db("alpha_min 8/255") + 6.0);
    let all = outcome.rows.iter().find(|row| row.candidate.name == "exact").unwrap();
    let accuracy = all.accuracy.as_ref().unwrap();
    assert!(accuracy.gradient_error < 1e-3 && accuracy.gradient_cosine > 0.999_999, "{accuracy:?}");
    assert!(accuracy.max < 1e-4 && accuracy.max >= accuracy.rms);
}

#[test]
fn a_broken_setting_is_not_timed() {
    let photos = photos();
    let bench = bench(&photos);
    let mut broken = candidates(&bench.base, false).remove(1);
    // The dials have the candidate's values; the function is another.
    broken.options = broken.options.with_blur(300.0);
    let mut truths = Vec::new();
    bench.truth(&mut truths, &bench.base).unwrap();
    // As if the picture were promised to equal that of the base.
    truths[0].0 = Dial::all_exact(broken.options);
    let error = bench.check(&broken, &mut truths, &no_score).unwrap_err().to_string();
    assert!(error.contains("it is broken"), "{error}");
}
