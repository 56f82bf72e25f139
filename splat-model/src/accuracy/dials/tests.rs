use std::collections::BTreeSet;

use super::*;

#[test]
fn names_are_names_and_values_differ() {
    let dials: BTreeSet<&str> = DIALS.iter().map(|dial| dial.name).collect();
    assert_eq!(dials.len(), DIALS.len());
    for dial in DIALS {
        let base = RenderOptions::standard();
        let names: BTreeSet<&str> = dial.values.iter().map(|value| value.name).collect();
        assert!(names.len() == dial.values.len() && names.len() > 1, "{}", dial.name);
        for value in dial.values {
            let set = (value.set)(base);
            assert_eq!(dial.value_in(&set).map(|found| found.name), Some(value.name), "{}", dial.name);
            assert!(value.rms_bound == 0.0 || dial.judge == Judge::Exact, "{}", dial.name);
        }
    }
}

#[test]
fn a_dial_moves_nothing_but_itself() {
    let base = RenderOptions::standard();
    for dial in DIALS {
        for moved in dial.values.iter().map(|value| (value.set)(base)).chain([(dial.exact)(base)]) {
            for other in DIALS.iter().filter(|other| other.name != dial.name) {
                let (before, after) = (other.value_in(&base), other.value_in(&moved));
                assert_eq!(before.map(|v| v.name), after.map(|v| v.name), "{} moves {}", dial.name, other.name);
            }
        }
    }
}

#[test]
fn every_dial_of_the_standard_has_a_name_for_it() {
    for dial in DIALS {
        assert!(dial.value_in(&RenderOptions::standard()).is_some(), "{}", dial.name);
    }
}

#[test]
fn the_exact_render_approximates_nothing() {
    let exact = Dial::all_exact(RenderOptions::fast());
    assert_eq!((exact.alpha_min, exact.transmittance_min, exact.alpha_max), (1e-12, 0.0, 1.0));
    assert_eq!((exact.blur, exact.near), (RenderOptions::fast().blur, RenderOptions::fast().near));
}

#[test]
fn bounds_add_up() {
    let found = Dial::rms_bound(&RenderOptions::standard());
    assert!((found - (ROUNDING_RMS + ALPHA_MAX_RMS + 0.04 + 0.01)).abs() < 1e-12, "{found}");
}
