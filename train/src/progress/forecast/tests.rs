use serde::Deserialize;
use splat_model::density::{AdaptiveConfig, McmcConfig};
use splat_model::trainer::Resolution;

use super::*;

/// Largest accepted error of the time left.
const ACCEPTED: f64 = 0.25;

/// A recorded run with the default options and another number of steps.
#[derive(Deserialize)]
struct Run {
    name: String,
    steps: usize,
    sh_degree: usize,
    /// Mean number of pixels of the photographs.
    pixels: f64,
    /// Number of Gaussians at the start.
    splats: usize,
    /// Steps of refinements, each with the number of Gaussians after it.
    refinements: Vec<(usize, usize)>,
    /// Outlooks of the strategy, with the step after which it had each.
    outlooks: Vec<(usize, Vec<(usize, usize)>)>,
    /// Steps and seconds; empty where the times are synthesised.
    seconds: Vec<(usize, f64)>,
}

impl Run {
    fn config(&self) -> TrainConfig {
        TrainConfig { steps: self.steps, sh_degree: self.sh_degree, ..TrainConfig::default() }
    }

    fn forecast(&self) -> Forecast {
        let refinements = self.refinements.iter().map(|(step, _)| *step).collect();
        Forecast::new(self.config(), refinements, (self.splats, self.pixels))
    }

    /// Number of Gaussians after a step.
    fn splats_after(&self, step: usize) -> usize {
        self.refinements.iter().take_while(|(at, _)| *at <= step).last().map_or(self.splats, |(_, splats)| *splats)
    }

    /// Times in which a Gaussian costs as much as `splat_in_pixels` pixels, views differ, the first step takes long, and
    /// checkpoints are written.
    fn synthesised(&self, splat_in_pixels: f64) -> Vec<(usize, f64)> {
        let mut total = 0.0;
        let step_s = |step: usize| {
            let degree = ((step - 1) / 1000).min(self.sh_degree) as f64;
            let splats = self.splats_after(step - 1) as f64 * (1.0 + 0.02 * ((degree + 1.0).powi(2) - 1.0));
            let view = 1.0 + 0.2 * (2.4 * step as f64).sin();
            let rare = match step {
                1 => 30.0,
                _ if step.is_multiple_of(500) && step < self.steps => 6.0,
                _ => 1.0,
            };
            2e-7 * (self.pixels + splat_in_pixels * splats) * view * rare
        };
        (1..=self.steps)
            .map(|step| {
                total += step_s(step);
                (step, total)
            })
            .collect()
    }

    /// Replays the run with these times. Returns the step with the largest error of the time left from a tenth of the run on,
    /// and the error. The last fiftieth of the time is left out, in which single steps count.
    fn worst(&self, times: &[(usize, f64)]) -> (usize, f64) {
        let mut forecast = self.forecast();
        let mut outlooks = self.outlooks.iter().peekable();
        let whole = times.last().unwrap().1;
        let mut worst = (0, 0.0_f64);
        for &(step, seconds) in times {
            forecast.observe(Observed { step, splats: self.splats_after(step), seconds });
            while let Some((_, outlook)) = outlooks.next_if(|(at, _)| *at <= step) {
                forecast.expect(Some(outlook.clone()));
            }
            let left = whole - seconds;
            if step >= self.steps / 10 && left > whole / 50.0 {
                let error = forecast.left_s() / left - 1.0;
                if error.abs().total_cmp(&worst.1.abs()).is_gt() {
                    worst = (step, error);
                }
            }
        }
        worst
    }
}

fn runs() -> Vec<Run> {
    serde_json::from_str(include_str!("runs.json")).unwrap()
}

#[test]
fn the_time_left_is_known_from_a_tenth_of_the_run_on() {
    let runs = runs();
    assert!(runs.len() >= 5);
    for run in &runs {
        for splat_in_pixels in [2.0, 3.0, 4.0] {
            let (step, error) = run.worst(&run.synthesised(splat_in_pixels));
            assert!(error.abs() <= ACCEPTED, "{}, {splat_in_pixels}: {error:+.2} at step {step}", run.name);
        }
    }
}

#[test]
fn the_time_left_is_known_with_measured_times() {
    let measured = runs().into_iter().filter(|run| !run.seconds.is_empty());
    let mut count = 0;
    for run in measured {
        let (step, error) = run.worst(&run.seconds);
        assert!(error.abs() <= ACCEPTED, "{}: {error:+.2} at step {step}", run.name);
        count += 1;
    }
    assert!(count > 0);
}

/// A run of 3,000 steps of 1 ms each at the start, half of it for 1,000 Gaussians, which adds 500 every hundred steps from
/// step 500 to 2,400. `expected` is the part of that growth which the strategy expects.
fn steady(config: TrainConfig, expected: Option<f64>) -> Vec<(usize, f64)> {
    let refinements: Vec<usize> = (500..2_500).step_by(100).collect();
    let splats_after = |step: usize| 1_000 + 500 * refinements.iter().filter(|at| **at <= step).count();
    let work = |step: usize| {
        let pixels = 1.0 / (config.resolution.divisor_at(step, 3_000) as f64).powi(2);
        0.5e-3 * (pixels + splats_after(step - 1) as f64 / 1_000.0)
    };
    let config = TrainConfig { steps: 3_000, sh_degree: 0, ..config.clone() };
    let mut forecast = Forecast::new(config, refinements.clone(), (1_000, 1_000.0 * SPLAT_IN_PIXELS));
    let (mut total, mut errors) = (0.0, Vec::new());
    let whole: f64 = (1..=3_000).map(work).sum();
    for step in 1..3_000 {
        total += work(step);
        let splats = splats_after(step);
        forecast.observe(Observed { step, splats, seconds: total });
        let outlook = |share: f64| {
            let number = |at| splats + (share * (splats_after(at) - splats) as f64) as usize;
            refinements.iter().filter(|at| **at > step).map(|&at| (at, number(at))).collect()
        };
        forecast.expect(expected.map(outlook));
        errors.push((step, forecast.left_s() / (whole - total) - 1.0));
    }
    errors
}

fn largest(errors: &[(usize, f64)], from: usize) -> f64 {
    errors.iter().filter(|(step, _)| *step >= from).fold(0.0, |most, (_, error)| error.abs().max(most))
}

#[test]
fn an_outlook_that_is_right_is_right_from_the_first_step() {
    assert!(largest(&steady(TrainConfig::default(), Some(1.0)), 2) < 1e-6);
    let resolution = Resolution { coarsest_divisor: 4, full_from: 0.5 };
    let smaller = steady(TrainConfig { resolution, ..TrainConfig::default() }, Some(1.0));
    assert!(largest(&smaller, 2) < 0.01, "{}", largest(&smaller, 2));
}

#[test]
fn an_outlook_that_is_wrong_is_corrected_by_what_comes() {
    for share in [0.4, 2.5] {
        let errors = steady(TrainConfig::default(), Some(share));
        assert!(largest(&errors, 300) > ACCEPTED, "{share}");
        assert!(largest(&errors, 800) < 0.1, "{share}: {}", largest(&errors, 800));
    }
}

#[test]
fn without_an_outlook_the_growth_so_far_goes_on() {
    let errors = steady(TrainConfig::default(), None);
    assert!(largest(&errors, 300) > 0.5);
    // The prediction lets growth fade, which this run does not.
    assert!(largest(&errors, 600) < 0.15, "{}", largest(&errors, 600));
}

#[test]
fn the_cap_holds_for_the_prediction_too() {
    for density in
        [AdaptiveConfig { max_splats: 1_500, ..AdaptiveConfig::default() }.into(), McmcConfig::default().into()]
    {
        let config = TrainConfig { steps: 1_000, sh_degree: 0, density, ..TrainConfig::default() };
        let most = density.max_splats();
        let mut forecast = Forecast::new(config, vec![900], (1_000, 3_000.0));
        forecast.observe(Observed { step: 800, splats: 1_000, seconds: 8.0 });
        forecast.expect(Some(vec![(900, 5_000_000)]));
        assert_eq!(forecast.numbers(), [(900, most as f64)]);
    }
}

#[test]
fn times_and_numbers_of_any_kind_give_a_finite_time() {
    let config = TrainConfig { steps: 100, ..TrainConfig::default() };
    let mut forecast = Forecast::new(config, vec![50, 60], (0, 0.0));
    assert_eq!(forecast.left_s(), 0.0);
    for (step, splats, seconds) in [(1, 0, 0.0), (1, 0, 0.0), (50, 0, 1.0), (60, 10, 0.5), (99, 0, 1e9)] {
        forecast.observe(Observed { step, splats, seconds });
        forecast.expect(Some(vec![]));
        let left = forecast.left_s();
        assert!(left.is_finite() && left >= 0.0, "{left} after step {step}");
    }
    forecast.observe(Observed { step: 100, splats: 0, seconds: 1e9 });
    assert_eq!(forecast.left_s(), 0.0);
}
