use super::*;

#[test]
fn limits_are_finite_and_have_the_effect_of_the_limit() {
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    assert_eq!([f32::INFINITY, f32::NEG_INFINITY].map(|limit| logit(limit).is_finite()), [true; 2]);
    assert_eq!(opacity(logit(f32::INFINITY)), 1.0);
    assert!(opacity(logit(f32::NEG_INFINITY)) <= 2.0 * f32::MIN_POSITIVE);
    let thickness = log_scale(f32::NEG_INFINITY).exp();
    assert!(thickness > 0.0 && thickness <= 2.0 * f32::MIN_POSITIVE, "{thickness}");
    assert_eq!([logit(-3.5), log_scale(-3.5), log_scale(f32::INFINITY)], [-3.5, -3.5, f32::INFINITY]);
    assert!(logit(f32::NAN).is_nan() && log_scale(f32::NAN).is_nan());
}
