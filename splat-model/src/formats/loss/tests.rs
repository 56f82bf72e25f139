use super::*;

#[test]
fn each_difference_is_told_in_its_unit() {
    let half = 0.5_f32.to_radians();
    let written = GaussianRows {
        means: vec![[0.0; 3], [1.0; 3]],
        rotations: vec![[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 3.0, 0.0]],
        log_scales: vec![[0.0; 3]; 2],
        logit_opacities: vec![0.0; 2],
        sh_dc: vec![[0.0; 3]; 2],
        sh_rest: vec![],
        sh_degree: 0,
        groups: Vec::new(),
    };
    assert_eq!(QuantisationError::between(&written, &written), QuantisationError::default());
    let mut read = written.clone();
    read.means[0] = [3.0, 0.0, 4.0];
    // Twice as long, negated, and turned by one degree.
    read.rotations[0] = [-2.0 * half.cos(), 0.0, 2.0 * half.sin(), 0.0];
    read.log_scales[1][2] = 1.1_f32.ln();
    read.logit_opacities[1] = 3.0_f32.ln();
    read.sh_dc[0][1] = -1.0;
    let loss = QuantisationError::between(&written, &read);
    let near = |found: Deviation, largest: f64, rms: f64| {
        assert!((found.largest - largest).abs() < 1e-5 && (found.rms - rms).abs() < 1e-5, "{found:?} {largest} {rms}");
    };
    near(loss.position, 5.0, 5.0 / 2.0_f64.sqrt());
    near(loss.rotation, 1.0, 0.5_f64.sqrt());
    near(loss.scale, 0.1, 0.1 / 6.0_f64.sqrt());
    near(loss.opacity, 0.25, 0.25 / 2.0_f64.sqrt());
    near(loss.colour, 0.28209479, 0.28209479 / 6.0_f64.sqrt());
    assert_eq!(loss.harmonics, Deviation::default());
}
