use super::*;

#[test]
fn a_line_says_all() {
    let line = ProgressLine { step: 240, steps: 2000, loss: 0.04123, splats: 12_345, rate: 8.0, left_s: 220.0 };
    assert_eq!(line.to_string(), "step 240/2000  loss 0.0412  12345 splats  8.0 steps/s  3:40 left");
    let first = ProgressLine { step: 1, steps: 2, splats: 1, rate: f64::INFINITY, left_s: 0.0, ..line };
    assert_eq!(first.to_string(), "step 1/2  loss 0.0412  1 splats  - steps/s  0:00 left");
}

/// With 20 s a photograph.
#[test]
fn the_time_that_is_left_is_said_after_the_first_five() {
    let said = |done: usize| left(done, 40, 20.0 * done as f64, "whatever");
    assert_eq!([4, 40, 41].map(said), [""; 3]);
    assert_eq!(said(5), ", 11:40 left (whatever)");
    assert_eq!(said(39), ", 0:20 left (whatever)");
}

#[test]
fn clocks() {
    assert_eq!(clock(0.4), "0:00");
    assert_eq!(clock(59.6), "1:00");
    assert_eq!(clock(3_725.0), "1:02:05");
    assert_eq!(clock(f64::NAN), "0:00");
}
