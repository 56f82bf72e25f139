use super::*;
use crate::gaussians::values_of;

#[test]
fn deviates_are_normal_and_all_their_own() {
    let rows = CHUNK + 1000;
    let values = values_of(normal(3, rows, &Device::flex()));
    let count = values.len() as f32;
    let mean = values.iter().sum::<f32>() / count;
    let variance = values.iter().map(|value| value * value).sum::<f32>() / count;
    // Tolerance: five standard errors.
    assert!(mean.abs() < 5.0 / count.sqrt() && (variance - 1.0).abs() < 5.0 * (2.0 / count).sqrt());
    assert_ne!(values[..9], values[3 * CHUNK..3 * CHUNK + 9], "two streams are one");
    assert_ne!(values, values_of(normal(4, rows, &Device::flex())));
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
