use super::*;
use crate::simd::dispatch;
use crate::testing::random::Random;

#[test]
fn exp2_stays_within_two_ulp() {
    let mut worst = 0.0_f64;
    for i in 0..=400_000 {
        let q = i as f32 * (126.0 / 400_000.0);
        let got = dispatch!(f32, simd => f32::exp2_lanes(f32x8::splat(simd, q), &f32::EXP2.map(|c| f32x8::splat(simd, c)))[3]);
        let want = (-f64::from(q)).exp2();
        worst = worst.max((f64::from(got) - want).abs() / (want * f64::from(f32::EPSILON)));
    }
    assert!(worst <= 2.0, "{worst} ulp");
    for (q, power) in [(0.0, 1.0), (1.0, 0.5), (126.0, f32::MIN_POSITIVE)] {
        assert_eq!(
            dispatch!(f32, simd => f32::exp2_lanes(f32x8::splat(simd, q), &f32::EXP2.map(|c| f32x8::splat(simd, c)))[0]),
            power
        );
    }
}

#[test]
fn exp_stays_within_one_ulp() {
    let exp = |x: f32| dispatch!(f32, simd => f32::exp_lanes(f32x8::splat(simd, x))[5]);
    let mut worst = 0.0_f64;
    for i in 0..=400_000 {
        let x = -87.0 + i as f32 * (175.0 / 400_000.0);
        let (got, want) = (f64::from(exp(x)), f64::from(x).exp());
        // One ulp of this value, not of 1.
        let ulp = f64::from(f32::EPSILON) * want.log2().floor().exp2();
        worst = worst.max((got - want).abs() / ulp);
    }
    assert!(worst <= 1.0, "{worst} ulp");
    assert_eq!([0.0, -0.0, -200.0, f32::NEG_INFINITY, 200.0, f32::INFINITY].map(exp), {
        [1.0, 1.0, 0.0, 0.0, f32::INFINITY, f32::INFINITY]
    });
    // Subnormal values lose digits, but not their magnitude.
    assert!((exp(-95.0) / (-95.0_f32).exp() - 1.0).abs() < 1e-3);
}

#[test]
fn sums_of_several_vectors_are_those_of_each() {
    fn sums<S: Simd, F: Real>(simd: S, count: usize) -> [Vec<F>; 2] {
        let mut random = Random::new(7);
        let mut vector = || F::Block::<S>::from_fn(simd, |_| F::of(random.between(-1.0, 1.0)));
        let vectors: Vec<_> = (0..count).map(|_| vector()).collect();
        let mut found = vec![F::ZERO; count];
        F::reduce_sums(&vectors, &mut found);
        [found, vectors.iter().map(|vector| vector.reduce_sum()).collect()]
    }
    for count in [0, 1, 4, 9, 11] {
        let [found, expected] = dispatch!(f32, simd => sums::<_, f32>(simd, count));
        assert_eq!(found, expected, "{count}");
        let [found, expected] = dispatch!(f64, simd => sums::<_, f64>(simd, count));
        assert_eq!(found, expected, "{count}");
    }
}
