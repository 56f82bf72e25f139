use super::*;
use crate::simd::dispatch;

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
