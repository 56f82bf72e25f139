use std::sync::Arc;

use glam::DAffine3;
use splat_model::capture::Photo;
use splat_model::optim::MomentBits;
use splat_op::Intrinsics;

use super::*;

fn photo() -> Photo {
    let intrinsics = Intrinsics::centred(100, 50, 80.0);
    let (rgb, cam_from_world) = (vec![0; 3 * 5_000], DAffine3::IDENTITY);
    Photo { name: "a".into(), intrinsics, cam_from_world, rgb, alpha: None, mask: None }
}

#[test]
fn a_budget_is_the_sum_of_what_is_there() {
    let kept = Photograph::from(photo());
    let let_go = Photograph::read_later((&photo()).into(), &Arc::default(), || Ok(photo()));
    let config = TrainConfig { sh_degree: 0, cache_mib: 0, ..TrainConfig::default() };
    let budget = MemoryEstimate::of(&[kept.clone(), let_go], &[kept], &config, 10);
    assert_eq!(budget.photographs, 2 * 15_000);
    assert_eq!(budget.prepared, 0);
    assert_eq!(budget.scene, 10 * ((COPIES + 2) * 14 * 4 + RENDERED));
    let packed = TrainConfig { moment_bits: MomentBits::Eight, ..config.clone() };
    // Two bytes a number, in whole words.
    assert_eq!(MemoryEstimate::of(&[], &[], &packed, 10).scene, 10 * (COPIES * 14 * 4 + 36 + RENDERED));
    let several = TrainConfig { batch: 2, ..config.clone() };
    assert_eq!(MemoryEstimate::of(&[], &[], &several, 10).scene - budget.scene, 10 * 14 * 4);
    let config = TrainConfig { sh_degree: 1, ..config };
    let more = MemoryEstimate::of(&[], &[], &config, 10).scene - budget.scene;
    assert_eq!(more, 10 * (COPIES + 2) * 9 * 4);
    assert_eq!(MemoryEstimate::of(&[], &[], &config, 0).total(), PROGRAM);
    // Eight bits: two bytes a number, in whole words.
    let with_groups = |config: &TrainConfig| budget.with_groups([16, 1].into_iter(), config, 10).scene - budget.scene;
    assert_eq!(with_groups(&config), 10 * (COPIES + 2) * 17 * 4);
    assert_eq!(with_groups(&packed), 10 * (COPIES * 17 * 4 + 36));
    assert_eq!(with_groups(&several), 10 * (COPIES + 3) * 17 * 4);
}

#[test]
fn a_run_that_would_not_fit_says_so() {
    let budget = |photographs, scene| MemoryEstimate { photographs, prepared: 0, scene, other: 0 };
    let large = budget(1_000_000_000, 3_000_000_000);
    assert!(!large.said(7, None).contains("--") && !large.said(7, Some(5_000_000_000)).contains("--"));
    let said = large.said(7, Some(2_000_000_000));
    assert!(
        said.contains("about 1.0 GB, and 3.0 GB more") && said.contains("2.0 GB") && said.contains("`--max-splats`"),
        "{said}"
    );
    let said = budget(3_000_000_000, 1_000_000_000).said(7, Some(2_000_000_000));
    assert!(said.contains("`--cache-mb`"), "{said}");
}

#[test]
fn half_of_what_is_left_is_for_photographs() {
    assert_eq!(cache(None, Some(10)), 5);
    assert_eq!(cache(Some(3), Some(10)), 3_000_000);
    assert!(cache(None, None) > 0 && available().is_none_or(|bytes| bytes > 1 << 20));
}
