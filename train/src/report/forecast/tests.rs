use splat_model::trainer::Resolution;

use super::*;

/// Largest accepted error of the time left.
const ACCEPTED: f64 = 0.25;

/// The steps of a run of 1,000 whose photographs have `pixels` pixels and which begins with 10,000 Gaussians and adds `added` of them
/// every 50 steps, from step 100 to 450. Forecasts are compared from step `from` on.
fn assert_foreseen(resolution: Resolution, added: usize, from: usize) {
    let config = TrainConfig { steps: 1000, resolution, ..TrainConfig::default() };
    let refinements: Vec<usize> = (100..500).step_by(50).collect();
    let mut forecast = Forecast::new(config.clone(), refinements.clone(), 10_000, 30_000.0);
    let (mut splats, mut seconds) = (10_000, vec![0.0]);
    let mut forecasts = Vec::new();
    for step in 1..=1000 {
        let divisor = config.resolution.divisor_at(step, 1000) as f64;
        // The first step and a checkpoint take long, and views differ.
        let rare = if step == 1 || step % 400 == 0 { 30.0 } else { 1.0 + 0.2 * (2.4 * step as f64).sin() };
        let took = 1e-6 * rare * (30_000.0 / (divisor * divisor) + 3.5 * splats as f64);
        seconds.push(seconds[step - 1] + took);
        splats += if refinements.contains(&step) { added } else { 0 };
        forecast.observe(RunProgress { step, splats, seconds: seconds[step] });
        forecasts.push((step, forecast.left_s()));
    }
    for (step, found) in forecasts.into_iter().filter(|(step, _)| (from..900).contains(step)) {
        let left = seconds[1000] - seconds[step];
        assert!((found / left - 1.0).abs() < ACCEPTED, "step {step}: {found} s instead of {left}");
    }
}

#[test]
fn a_run_that_does_not_grow_ends_when_it_is_expected_to() {
    assert_foreseen(Resolution::FULL, 0, 350);
}

#[test]
fn growth_goes_on_as_it_began() {
    assert_foreseen(Resolution::FULL, 2_500, 20);
    assert_foreseen(Resolution::FULL, 6_000, 300);
}

#[test]
fn photographs_that_are_small_at_first_are_expected_to_grow() {
    assert_foreseen(Resolution { coarsest_divisor: 4, ..Resolution::FULL }, 2_500, 20);
}

#[test]
fn nothing_is_left_after_the_last_step_and_nothing_is_known_before_the_second() {
    let config = TrainConfig { steps: 3, ..TrainConfig::default() };
    let mut forecast = Forecast::new(config, vec![], 10, 100.0);
    forecast.observe(RunProgress { step: 1, splats: 10, seconds: 9.0 });
    assert_eq!((forecast.left_s(), forecast.step_s()), (0.0, 0.0));
    forecast.observe(RunProgress { step: 2, splats: 10, seconds: 9.5 });
    assert!((forecast.left_s() - 0.5).abs() < 1e-9 && (forecast.step_s() - 0.5).abs() < 1e-9);
    forecast.observe(RunProgress { step: 3, splats: 10, seconds: 10.0 });
    assert_eq!(forecast.left_s(), 0.0);
}
