use super::*;

/// With 20 s a photograph.
#[test]
fn the_time_that_is_left_is_said_after_the_first_five() {
    let said = |done: usize| left(done, 40, 20.0 * done as f64);
    assert_eq!([4, 40, 41].map(said), [""; 3]);
    assert_eq!(said(5), ", 11:40 left");
    assert_eq!(said(39), ", 0:20 left");
}

#[test]
fn clocks() {
    assert_eq!(clock(0.4), "0:00");
    assert_eq!(clock(59.6), "1:00");
    assert_eq!(clock(3_725.0), "1:02:05");
    assert_eq!(clock(f64::NAN), "0:00");
}
