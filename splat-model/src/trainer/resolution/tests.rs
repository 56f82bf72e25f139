use super::*;

#[test]
fn sizes_have_equal_parts_of_the_coarse_share() {
    let schedule = Resolution { coarsest_divisor: 4, full_from: 0.4 };
    let divisors: Vec<usize> = (1..=10).map(|step| schedule.divisor_at(step, 10)).collect();
    assert_eq!(divisors, [4, 4, 2, 2, 1, 1, 1, 1, 1, 1]);
    let schedule = Resolution { coarsest_divisor: 2, full_from: 0.25 };
    let last = (1..=1000).filter(|&step| schedule.divisor_at(step, 1000) == 2).max();
    assert_eq!(last, Some(250));
}

#[test]
fn a_run_within_a_time_begins_with_a_thousand_small_steps() {
    let of = |steps| {
        let Resolution { coarsest_divisor, full_from } = Resolution::within_time(steps);
        (coarsest_divisor, full_from)
    };
    assert_eq!([0, 500, 2_000, 10_000].map(of), [(8, 0.7), (8, 0.7), (4, 0.5), (4, 0.1)]);
    assert!((0..5_000).step_by(7).all(|steps| Resolution::within_time(steps).is_valid()));
}

#[test]
fn a_divisor_alone_takes_effect() {
    let schedule = Resolution { coarsest_divisor: 4, ..Resolution::FULL };
    assert_eq!([1, 26, 51].map(|step| schedule.divisor_at(step, 100)), [4, 2, 1]);
}

#[test]
fn full_size_throughout() {
    for schedule in [Resolution::FULL, Resolution { coarsest_divisor: 1, full_from: 1.0 }] {
        assert!((1..=50).all(|step| schedule.divisor_at(step, 50) == 1));
    }
    assert!((1..=50).all(|step| Resolution { coarsest_divisor: 8, full_from: 0.0 }.divisor_at(step, 50) == 1));
}

#[test]
fn what_cannot_be_followed() {
    let valid = |coarsest_divisor, full_from| Resolution { coarsest_divisor, full_from }.is_valid();
    assert!(valid(1, 0.0) && valid(16, 1.0));
    assert!(
        !valid(0, 0.5) && !valid(3, 0.5) && !valid(32, 0.5) && !valid(2, -0.1) && !valid(2, 1.1) && !valid(2, f64::NAN)
    );
}
