use super::*;

#[test]
fn gradients_are_compared_parameter_by_parameter() {
    let exact: GradientSums = [vec![3.0, 4.0], vec![1e-9, 0.0], vec![1.0, 0.0], vec![2.0], vec![5.0]];
    assert_eq!(compare_gradients(&exact, &exact), (0.0, "means", 1.0));
    let mut found = exact.clone();
    // A parameter with negligible gradients may have any error.
    found[1] = vec![-1e-9, 0.0];
    assert_eq!(compare_gradients(&found, &exact).0, 0.0);
    found[2] = vec![0.0, 1.0];
    let (error, worst, cosine) = compare_gradients(&found, &exact);
    assert!((error - 2.0_f64.sqrt()).abs() < 1e-12 && worst == "log_scales" && cosine == 0.0);
    found[2] = vec![0.0, 0.0];
    assert_eq!(compare_gradients(&found, &exact), (1.0, "log_scales", 0.0));
}
