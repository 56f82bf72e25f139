//! Counts the launches and allocations of a training step on a GPU. Counts do not depend on the machine's load. The test is a
//! process of its own, because the counters are global.

use std::collections::BTreeMap;

use burn::tensor::Device;
use splat_op::test_hooks;
use splat_tests::data::announce;
use splat_tests::places;
use splat_tests::slope::slope_trainer;

/// Kernel launches per step on a driver in software. Burn may launch other kernels on a card.
const LAUNCHES: f64 = 35.0;

/// Bytes of the buffers that the operations request per step.
const BYTES: f64 = 1_430_648.0;

/// Growth above which a count is a regression.
const GROWTH: f64 = 1.05;

/// Steps before the counted steps. After them, all degrees of the harmonics are in use and the photograph is prepared.
const BEFORE: usize = 6;
const STEPS: usize = 8;

#[test]
fn a_training_step_launches_and_allocates_no_more_than_it_did() {
    let Some(place) = places().into_iter().find(|place| place.device != Device::flex() && place.name == "gpu") else {
        return;
    };
    if !place.software {
        announce("SKIPPED: the counts of a training step: they were recorded on a driver in software");
        return;
    }
    let mut run = slope_trainer(&place.device);
    let mut step = || run.step().expect("a sound run").loss.into_scalar::<f32>();
    let first = step();
    for _ in 1..BEFORE {
        step();
    }
    let mut last = 0.0;
    let bytes_before = test_hooks::allocated_bytes();
    let bound_before = test_hooks::bound_bytes();
    let counts = test_hooks::launches(|| (0..STEPS).for_each(|_| last = step()));
    let bytes = (test_hooks::allocated_bytes() - bytes_before) as f64 / STEPS as f64;
    let bound = (test_hooks::bound_bytes() - bound_before) as f64 / STEPS as f64;
    assert!(last < first, "the loss went from {first} to {last}: this is not training");
    let per_step: BTreeMap<&str, f64> =
        counts.iter().map(|(name, count)| (*name, *count as f64 / STEPS as f64)).collect();
    let launches: f64 = per_step.values().sum();
    println!("{launches} launches and {bytes} bytes a step: {per_step:#?}");
    println!("{bound} bytes of buffers bound to the operations' kernels a step");
    for (what, found, committed) in [("launches", launches, LAUNCHES), ("bytes", bytes, BYTES)] {
        assert!(found <= GROWTH * committed, "{found} {what} a step instead of {committed}: {per_step:#?}");
        assert!(found >= committed / GROWTH, "{found} {what} a step instead of {committed}: commit the new figure");
    }
}
