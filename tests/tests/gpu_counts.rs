//! What a training step launches and allocates on a GPU: counts, which do not depend on how busy the machine is. A process
//! of its own: what is counted must be this test's alone.

use std::collections::BTreeMap;

use burn::tensor::Device;
use splat_op::witness;
use splat_tests::places;
use splat_tests::slope::slope_trainer;

/// Kernels per step on a driver in software. On a card those of Burn may be others.
const LAUNCHES: f64 = 67.0;

/// Bytes per step of the buffers that the operations ask for.
const BYTES: f64 = 1_467_172.0;

/// What a regression is.
const GROWTH: f64 = 1.05;

/// Steps before those that count: all degrees of the harmonics are there by then, and the photograph is prepared.
const BEFORE: usize = 6;
const STEPS: usize = 8;

#[test]
fn a_training_step_launches_and_allocates_no_more_than_it_did() {
    let Some(place) = places().into_iter().find(|place| place.device != Device::flex() && place.name == "gpu") else {
        return;
    };
    if !place.software {
        return;
    }
    let mut run = slope_trainer(&place.device);
    let mut step = || run.step().expect("a sound run").loss.into_scalar::<f32>();
    let first = step();
    for _ in 1..BEFORE {
        step();
    }
    let mut last = 0.0;
    let bytes_before = witness::allocated_bytes();
    let counts = witness::launches(|| (0..STEPS).for_each(|_| last = step()));
    let bytes = (witness::allocated_bytes() - bytes_before) as f64 / STEPS as f64;
    assert!(last < first, "the loss went from {first} to {last}: this is not training");
    let per_step: BTreeMap<&str, f64> =
        counts.iter().map(|(name, count)| (*name, *count as f64 / STEPS as f64)).collect();
    let launches: f64 = per_step.values().sum();
    println!("{launches} launches and {bytes} bytes a step: {per_step:#?}");
    for (what, found, committed) in [("launches", launches, LAUNCHES), ("bytes", bytes, BYTES)] {
        assert!(found <= GROWTH * committed, "{found} {what} a step instead of {committed}: {per_step:#?}");
        assert!(found >= committed / GROWTH, "{found} {what} a step instead of {committed}: commit the new figure");
    }
}
