//! The battery of hard cases, on every path. One test per group, so that failures name it.

use splat_hard_cases::judge::judge;
use splat_hard_cases::{GROUPS, Group};
use splat_tests::places;

#[track_caller]
fn prove(name: &str) {
    let Group { cases, .. } = GROUPS.iter().find(|group| group.name == name).expect("a group of that name");
    let places = places();
    let mut failures = Vec::new();
    for case in cases() {
        let row = judge(&case, &places);
        failures.extend(row.failures().into_iter().map(|failure| format!("{}: {failure}", case.name)));
    }
    assert!(failures.is_empty(), "{} failures:\n{}", failures.len(), failures.join("\n"));
}

macro_rules! groups {
    ($($name:ident),* $(,)?) => {
        $(#[test]
        fn $name() {
            prove(stringify!($name));
        })*

        #[test]
        fn every_group_has_a_test() {
            let tested = [$(stringify!($name)),*];
            assert_eq!(tested.to_vec(), GROUPS.iter().map(|group| group.name).collect::<Vec<_>>());
        }
    };
}

groups!(needles, sizes, near, opacity, depth, rotations, cameras, colour, far, poison, counts, loss, training);
