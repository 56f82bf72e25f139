use super::*;

#[test]
fn a_line_says_all() {
    let line = said([240, 2000], 0.04123, 12_345, 8.0, 220.0);
    assert_eq!(line, "step 240/2000  loss 0.0412  12345 splats  8.0 steps/s  3:40 left");
    let first = said([1, 2], 0.04123, 1, f64::INFINITY, 0.0);
    assert_eq!(first, "step 1/2  loss 0.0412  1 splats  - steps/s  0:00 left");
}
