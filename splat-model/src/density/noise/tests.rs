use super::*;
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;

#[test]
fn deviates_are_normal_and_independent() {
    for (device, seed) in devices().into_iter().flat_map(|device| [3, 4, 5].map(|seed| (device.clone(), seed))) {
        let rows = 50_001;
        let values: Vec<f64> = values_of(normal(seed, rows, &device)).into_iter().map(f64::from).collect();
        let count = values.len() as f64;
        assert_eq!(values.len(), 3 * rows);
        let mean = |of: &dyn Fn(usize) -> f64| (0..values.len()).map(of).sum::<f64>() / count;
        // Tolerance: five standard errors of the moments of a normal distribution.
        let error = 5.0 / count.sqrt();
        for (power, expected, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0_f64)] {
            let found = mean(&|i| values[i].powi(power));
            assert!((found - expected).abs() < error * variance.sqrt(), "{seed}: moment {power} is {found}");
        }
        for apart in [1, 2, 3, 4, 64, 4_096, 3 * rows / 2] {
            let found = mean(&|i| values[i] * values[(i + apart) % values.len()]);
            assert!(found.abs() < error, "{seed}: correlation {found} of numbers {apart} apart");
            let found = mean(&|i| (values[i].powi(2) - 1.0) * (values[(i + apart) % values.len()].powi(2) - 1.0));
            assert!(found.abs() < 2.0 * error, "{seed}: correlation {found} of squares {apart} apart");
        }
        assert_ne!(
            values[..9],
            values_of(normal(seed + 1, rows, &device)).into_iter().map(f64::from).collect::<Vec<_>>()[..9]
        );
    }
}

#[test]
fn every_step_has_others_and_a_seed_decides_them() {
    let device = Device::flex();
    let drawn = |seed| {
        let (mut noise, mut rng) = (Noise::default(), ChaCha8Rng::seed_from_u64(seed));
        let mut draw = |count| values_of(noise.draw(count, &mut rng, &device));
        [draw(500), draw(500), draw(499)]
    };
    let [first, second, third] = drawn(1);
    assert_eq!((first.len(), third.len()), (1500, 1497));
    assert_ne!(first, second);
    assert_ne!(second[..1497], third);
    assert_eq!(drawn(1), [first.clone(), second, third]);
    assert_ne!(drawn(2)[0], first);
}

#[test]
fn a_stock_is_taken_up_again() {
    let device = Device::flex();
    let (mut noise, mut rng) = (Noise::default(), ChaCha8Rng::seed_from_u64(1));
    noise.draw(50, &mut rng, &device);
    let mut state = State::default();
    noise.save(&mut state).unwrap();
    let (mut again, mut same_rng) = (Noise::default(), rng.clone());
    again.load(&mut state, &device).unwrap();
    state.finish().unwrap();
    let expected = values_of(noise.draw(50, &mut rng, &device));
    assert_eq!(values_of(again.draw(50, &mut same_rng, &device)), expected);
    let mut empty = State::default();
    Noise::default().save(&mut empty).unwrap();
    again.load(&mut empty, &device).unwrap();
    assert!(again.stock.is_none());
}
