use super::*;
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;

/// Both results on each device, for each opacity and count.
fn shared(all: &[(f64, usize)]) -> Vec<Vec<(f64, f64)>> {
    let on = |device| {
        let tensor = |of: &dyn Fn(&(f64, usize)) -> f32| {
            Tensor::<1>::from_floats(all.iter().map(of).collect::<Vec<_>>().as_slice(), &device)
        };
        let (each, factor) = share(tensor(&|of| of.0 as f32), tensor(&|of| of.1 as f32));
        values_of(each).into_iter().zip(values_of(factor)).map(|(a, b)| (a.into(), b.into())).collect()
    };
    devices().map(on).to_vec()
}

/// The opacity of `count` Gaussians at one position, integrated along a line through it by the trapezoidal rule, which
/// converges faster than any power here.
fn stopped(opacity: f64, sigma: f64, count: usize) -> f64 {
    let step = sigma / 50.0;
    let at = |i: i32| 1.0 - (1.0 - opacity * (-0.5 * (f64::from(i) * step / sigma).powi(2)).exp()).powi(count as i32);
    (-500..=500).map(at).sum::<f64>() * step
}

#[test]
fn several_stop_what_one_did() {
    let counts = [1, 2, 3, 7, 51, 400];
    let cases: Vec<(f64, usize)> =
        [1e-4, 0.005, 0.1, 0.5, 0.9, 0.99, 0.999].iter().flat_map(|o| counts.map(|n| (*o, n))).collect();
    for found in shared(&cases) {
        for (&(opacity, count), (each, factor)) in cases.iter().zip(found) {
            let together = 1.0 - (1.0 - each).powi(count as i32);
            assert!((together / opacity - 1.0).abs() < 1e-4, "{opacity}, {count}: {together}");
            let (before, after) = (stopped(opacity, 1.0, 1), stopped(each, factor, count));
            assert!((after / before - 1.0).abs() < 1e-4, "{opacity}, {count}: {after} instead of {before}");
        }
    }
}

/// The double sum of the paper's equation 9.
#[test]
fn it_is_the_papers_double_sum() {
    let binomial = |n: usize, k: usize| (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product::<f64>();
    let cases = [(0.3, 2), (0.8, 5), (0.95, 9)];
    for found in shared(&cases) {
        for ((opacity, count), (each, factor)) in cases.into_iter().zip(found) {
            let inner = |i: usize| {
                (0..i).map(move |k| {
                    let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                    binomial(i - 1, k) * sign * each.powi(k as i32 + 1) / ((k + 1) as f64).sqrt()
                })
            };
            let sum: f64 = (1..=count).flat_map(inner).sum();
            let of_covariance = opacity * opacity / (sum * sum);
            assert!((factor * factor / of_covariance - 1.0).abs() < 1e-4, "{opacity}, {count}");
        }
    }
}

#[test]
fn what_cannot_be_shared_stays_finite() {
    let cases: Vec<(f64, usize)> =
        [0.0, 1.0, f64::from(f32::MIN_POSITIVE)].iter().flat_map(|o| [2, 100_000].map(|n| (*o, n))).collect();
    for found in shared(&cases) {
        for ((opacity, count), (each, factor)) in cases.iter().zip(found) {
            assert!((0.0..1.0).contains(&each), "{opacity}, {count}: {each}");
            assert!(*opacity < 1e-30 || (0.05..2.0).contains(&factor), "{opacity}, {count}: {factor}");
        }
    }
}
