use super::*;

#[test]
fn a_line_says_all() {
    let line = ProgressLine { step: 240, steps: 2000, loss: 0.04123, splats: 12_345, rate: 8.0, left_s: 220.0 };
    assert_eq!(line.to_string(), "step 240/2000  loss 0.0412  12345 splats  8.0 steps/s  3:40 left");
    let first = ProgressLine { step: 1, steps: 2, splats: 1, rate: f64::INFINITY, left_s: 0.0, ..line };
    assert_eq!(first.to_string(), "step 1/2  loss 0.0412  1 splats  - steps/s  0:00 left");
}
