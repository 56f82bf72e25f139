//! Runs the battery of hard cases on every path. Each group has a test, so that failures name the group.

use splat_hard_cases::judge::judge;
use splat_hard_cases::{CaseGroup, GROUPS, battery};
use splat_tests::places;

#[track_caller]
fn prove(name: &str) {
    let CaseGroup { cases, .. } = GROUPS.iter().find(|group| group.name == name).expect("a group of that name");
    let places = places();
    let mut failures = Vec::new();
    for case in cases() {
        let row = judge(&case, &places);
        failures.extend(row.failures().into_iter().map(|failure| format!("{}: {failure}", case.name)));
    }
    assert!(failures.is_empty(), "{} failures:\n{}", failures.len(), failures.join("\n"));
}

/// `splat hard-cases --out docs` writes the table in `docs/`. Its figures depend on the machine, its rows do not.
#[test]
fn the_table_in_docs_lists_every_case() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/hard_cases.tsv");
    let table = std::fs::read_to_string(path).expect("the table is committed");
    let cells = |column| table.lines().filter_map(move |line| line.split('\t').nth(column));
    let listed: Vec<&str> = cells(1).collect();
    for case in battery().into_iter().flat_map(|(_, cases)| cases) {
        let name = case.name.as_str();
        assert!(listed.contains(&name), "{name} is missing: run `splat hard-cases --out docs`");
    }
    assert!(cells(8).any(|passes| passes == "yes") && cells(8).all(|passes| passes != "no"));
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

groups!(
    needles, sizes, near, opacity, depth, rotations, cameras, colour, rays, far, poison, counts, storage, loss,
    training
);
