use super::*;

/// The opacity of `count` Gaussians at one position, integrated along a line through it by the trapezoidal rule, which
/// converges faster than any power here.
fn stopped(opacity: f64, sigma: f64, count: usize) -> f64 {
    let step = sigma / 50.0;
    let at = |i: i32| 1.0 - (1.0 - opacity * (-0.5 * (f64::from(i) * step / sigma).powi(2)).exp()).powi(count as i32);
    (-500..=500).map(at).sum::<f64>() * step
}

#[test]
fn several_stop_what_one_did() {
    for opacity in [1e-4, 0.005, 0.1, 0.5, 0.9, 0.99, 0.999_99] {
        for count in [1, 2, 3, 7, 51, 400] {
            let (each, factor) = share(opacity, count);
            let together = 1.0 - (1.0 - each).powi(count as i32);
            assert!((together / opacity - 1.0).abs() < 1e-9, "{opacity}, {count}: {together}");
            let (before, after) = (stopped(opacity, 1.0, 1), stopped(each, factor, count));
            assert!((after / before - 1.0).abs() < 1e-6, "{opacity}, {count}: {after} instead of {before}");
        }
    }
}

/// The double sum of the paper's equation 9.
#[test]
fn it_is_the_papers_double_sum() {
    let binomial = |n: usize, k: usize| (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product::<f64>();
    for (opacity, count) in [(0.3, 2), (0.8, 5), (0.95, 9)] {
        let (each, factor) = share(opacity, count);
        let inner = |i: usize| {
            (0..i).map(move |k| {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                binomial(i - 1, k) * sign * each.powi(k as i32 + 1) / ((k + 1) as f64).sqrt()
            })
        };
        let sum: f64 = (1..=count).flat_map(inner).sum();
        let of_covariance = opacity * opacity / (sum * sum);
        assert!((factor * factor / of_covariance - 1.0).abs() < 1e-12, "{opacity}, {count}");
    }
}

#[test]
fn what_cannot_be_shared_stays_finite() {
    for opacity in [0.0, 1.0, f64::MIN_POSITIVE] {
        for count in [2, 100_000] {
            let (each, factor) = share(opacity, count);
            assert!((0.0..1.0).contains(&each), "{opacity}, {count}: {each}");
            assert!(opacity == 0.0 || (0.1..2.0).contains(&factor), "{opacity}, {count}: {factor}");
        }
    }
}
