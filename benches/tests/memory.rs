//! Bytes that training holds for each Gaussian. All allocations are counted, whatever the allocator keeps beyond them.

use std::alloc::System;

use splat_benches::SyntheticView;
use splat_benches::allocations::{CountingAllocator, allocated, held};
use splat_benches::step::Step;
use splat_model::optim::MomentBits;

#[global_allocator]
static ALLOCATOR: CountingAllocator<System> = CountingAllocator(System);

/// Bytes of the parameters of a Gaussian of degree 3 and of their moments in 8 bits.
const STATE: f64 = 236.0 + 124.0;

/// A small picture, in which the Gaussians are most of what is held.
const SMALL: SyntheticView = SyntheticView { splats: 0, width: 96, height: 54, sigma_px: 0.3, opacity: [0.02, 0.7] };

/// The most bytes held in the second of two steps, in a checkpoint after them, and in a refinement.
fn peaks(splats: usize) -> [f64; 3] {
    let empty = held();
    let mut step = Step::of(&SyntheticView { splats, ..SMALL }, MomentBits::Eight);
    step.run().unwrap();
    let before = held() - empty;
    let of_step = allocated(|| step.run().unwrap()).1.peak;
    let trained = held() - empty;
    let of_checkpoint = allocated(|| drop(step.save())).1.peak;
    let (count, of_refinement) = allocated(|| step.refine().unwrap());
    assert!((1.19..1.21).contains(&(count as f64 / splats as f64)), "{count} Gaussians after {splats}");
    [before + of_step, trained + of_checkpoint, trained + of_refinement.peak].map(|bytes| bytes as f64)
}

/// 10,000,000 Gaussians train in 8 GB as long as this holds.
#[test]
fn a_gaussian_takes_as_much_memory_as_documented() {
    let (few, many) = (200_000, 400_000);
    let (of_few, of_many) = (peaks(few), peaks(many));
    let [step, checkpoint, refinement] = [0, 1, 2].map(|i| (of_many[i] - of_few[i]) / (many - few) as f64);
    // After the refinement there are a fifth more.
    let refinement = refinement / 1.2;
    println!(
        "{step:.0} bytes for each Gaussian in a step, {checkpoint:.0} in a checkpoint, {refinement:.0} in a refinement"
    );
    assert!(step > STATE && step <= 700.0, "{step} bytes for each Gaussian in a step");
    // The state twice and no part of it three times.
    assert!(checkpoint > STATE && checkpoint <= 740.0, "{checkpoint} bytes for each Gaussian in a checkpoint");
    assert!(refinement > STATE && refinement <= 700.0, "{refinement} bytes for each Gaussian in a refinement");
}
