//! Further groups of parameters in files.

use std::path::Path;

use glam::DVec3;

use super::row::further_groups;
use super::{read, write, write_parts};
use crate::gaussians::testing::random_rows;
use crate::gaussians::{GaussianRows, GroupOptions, GroupRows};

/// A group of rows as it is read from a file.
pub(super) fn group(name: &str, width: usize, values: &[f32]) -> GroupRows {
    GroupRows { name: name.into(), width, values: values.to_vec(), options: GroupOptions::default() }
}

#[test]
fn groups_are_written_and_read() {
    let path = tempfile::tempdir().unwrap();
    let path = path.path().join("scene.ply");
    let mut rows = random_rows(2, 1, 5);
    rows.groups = vec![
        group("label_2", 1, &[7.0, f32::NAN]),
        group("features", 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        group("odd_0", 1, &[-1.0, -2.0]),
    ];
    write(&path, &rows, DVec3::ZERO).unwrap();
    let (read, _) = read(&path).unwrap();
    // NaN is no number that equals itself.
    assert_eq!(format!("{:?}", read.groups), format!("{:?}", rows.groups));
    let parts = [rows.part(0..1), rows.part(1..2)];
    let before = std::fs::read(&path).unwrap();
    write_parts(&path, 2, 1, &parts, DVec3::ZERO).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), before);
    let unlike = [rows.part(0..1), GaussianRows { groups: Vec::new(), ..rows.part(1..2) }];
    let error = write_parts(&path, 2, 1, &unlike, DVec3::ZERO).unwrap_err();
    assert!(format!("{error:?}").contains("different groups"), "{error:?}");
}

#[test]
fn groups_that_a_file_cannot_hold_are_refused() {
    let path = Path::new("never written.ply");
    let with = |groups: Vec<GroupRows>| GaussianRows { groups, ..random_rows(1, 0, 5) };
    for (groups, expected) in [
        (vec![group("x", 1, &[1.0])], "a group named \"x\""),
        (vec![group("scale_3", 1, &[1.0])], "a group named \"scale_3\""),
        (vec![group("a", 2, &[1.0, 2.0]), group("a_1", 1, &[1.0])], "two properties `a_1`"),
        (vec![group("a b", 1, &[1.0])], "a group named \"a b\""),
        (vec![group("a", 1, &[1.0, 2.0])], "`a` holds 2 numbers, expected 1 for 1 Gaussians"),
        (vec![group("sh", 1, &[1.0])], "two groups are named `sh`"),
        (vec![group("none", 0, &[])], "rows of 0 numbers"),
    ] {
        let error = write(path, &with(groups), DVec3::ZERO).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// The names in a header may be many and odd: nothing takes long, and nothing is read twice.
#[test]
fn further_properties_become_groups() {
    let found = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
        let groups = further_groups(names.iter());
        groups.into_iter().map(|group| (group.name, group.width)).collect::<Vec<_>>()
    };
    let expected =
        |groups: &[(&str, usize)]| groups.iter().map(|(name, width)| (name.to_string(), *width)).collect::<Vec<_>>();
    assert_eq!(found(&["x", "nx", "f_rest_44", "opacity"]), expected(&[]));
    assert_eq!(found(&["a_1", "x", "a_0", "a_2"]), expected(&[("a", 3)]));
    assert_eq!(found(&["a_0", "a_2", "a_01"]), expected(&[("a_0", 1), ("a_2", 1), ("a_01", 1)]));
    assert_eq!(found(&["a_0", "a_1", "a_3"]), expected(&[("a", 2), ("a_3", 1)]));
    assert_eq!(found(&["a", "a_0", "a_1"]), expected(&[("a", 1), ("a_0", 1), ("a_1", 1)]));
    assert_eq!(found(&["sh_0", "sh_1", "_0", "means"]), expected(&[("sh_0", 1), ("sh_1", 1), ("_0", 1)]));
    let many: Vec<String> = (0..50_000).map(|i| format!("a_{i}")).collect();
    assert_eq!(further_groups(many.iter()).len(), 1);
}
