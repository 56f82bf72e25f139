//! Central finite differences.

/// Compares every `stride`th element of a gradient with finite differences of `loss` around `at`.
///
/// The five-point formula has an error of fourth order. With a step of 1e-4 its remainder and the rounding of the quotient both
/// stay near 1e-11 for a loss of order one.
pub fn check_gradient(name: &str, at: &[f64], gradient: &[f64], stride: usize, loss: impl Fn(&[f64]) -> f64) {
    const STEP: f64 = 1e-4;
    const TOLERANCE: f64 = 2e-8;
    assert_eq!(at.len(), gradient.len(), "{name}: one derivative per element");
    let largest = gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
    let mut moved = at.to_vec();
    for i in (0..at.len()).step_by(stride) {
        let step = STEP * at[i].abs().max(0.1);
        let mut value = |steps: f64| {
            moved[i] = at[i] + steps * step;
            loss(&moved)
        };
        let near = value(1.0) - value(-1.0);
        let far = value(2.0) - value(-2.0);
        moved[i] = at[i];
        let difference = (8.0 * near - far) / (12.0 * step);
        let (error, tolerance) = ((gradient[i] - difference).abs(), TOLERANCE * (largest + 1.0));
        assert!(error <= tolerance, "{name}[{i}]: gradient {}, difference {difference}, error {error}", gradient[i]);
    }
}

/// `Σ a b`: the loss whose gradient with respect to `a` is `b`.
pub fn inner_product(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
