use std::path::PathBuf;

use glam::DAffine3;
use splat_op::Intrinsics;

use super::*;

fn views(names: &[&str]) -> Vec<View> {
    let view = |name: &&str| View {
        name: name.to_string(),
        image_path: PathBuf::from(name),
        intrinsics: Intrinsics::centred(4, 3, 5.0),
        cam_from_world: DAffine3::IDENTITY,
        cut: Default::default(),
    };
    names.iter().map(view).collect()
}

#[test]
fn every_third_by_name_is_held_out() {
    let split = Split::every(&views(&["e", "d", "c", "b", "a"]), 3);
    assert_eq!(split.test, [4, 1], "ranks 0 and 3 by name");
    assert_eq!(split.train, [3, 2, 0]);
}

#[test]
fn zero_holds_out_none_and_says_what_to_do() {
    let split = Split::every(&views(&["a", "b"]), 0);
    assert_eq!(split.require_train().unwrap(), [0, 1]);
    let message = split.require_test().unwrap_err().to_string();
    assert!(message.contains("--test-every") && message.contains("2 views"), "{message}");
}

#[test]
fn one_leaves_nothing_to_train_on_and_says_what_to_do() {
    let split = Split::every(&views(&["a", "b"]), 1);
    assert_eq!(split.require_test().unwrap(), [0, 1]);
    let message = split.require_train().unwrap_err().to_string();
    assert!(message.contains("--test-every") && message.contains("2 views"), "{message}");
}

#[test]
fn one_photograph_is_told_what_helps() {
    let split = Split::every(&views(&["a"]), 8);
    let message = split.require_train().unwrap_err().to_string();
    assert!(message.contains("the 1 view is held out") && message.contains("`--test-every 0`"), "{message}");
    assert!(!message.contains("8"), "{message}");
}

#[test]
fn no_views_at_all_is_an_error_both_ways() {
    let split = Split::every(&[], 8);
    assert!(split.require_train().is_err() && split.require_test().is_err());
}
