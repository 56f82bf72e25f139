//! Runs each pass of a training step once for a tool that counts: `benches/tests/counts.rs` starts it under callgrind, which
//! counts only within [`splat_counted`] and writes a file each time that function returns. For each pass the program prints a
//! tab-separated line: the name, the bytes allocated, and the peak of the bytes held.
//!
//! Every run is the same: the scene, one thread, and the vector instructions, which must be AVX2, the widest that valgrind
//! supports.
//!
//! `counted project rasterize` selects passes by their first words. The default is all passes and a step of a trainer.

use std::alloc::System;
use std::error::Error;

use burn::tensor::Device;
use fearless_simd::Level;
use splat_benches::allocations::{Allocated, CountingAllocator, allocated};
use splat_benches::job::{Job, JobSize};
use splat_benches::limit::PassKind;
use splat_benches::measure::{Pass, PassResult, TimedPart, stateful};
use splat_benches::passes::passes;
use splat_model::trainer::Trainer;

// The system allocator, because others return memory depending on time.
#[global_allocator]
static ALLOCATOR: CountingAllocator<System> = CountingAllocator(System);

/// Number of runs before the counted run: the first fills caches, and a trainer's first step has no moments.
const WARM_UP: usize = 2;

fn main() -> Result<(), Box<dyn Error>> {
    // This thread is the whole pool: no other thread works, waits or wakes.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    let level = Level::new();
    if !matches!(level, Level::Avx2(_)) {
        return Err(format!("the counts are recorded for AVX2, and this is {level:?}").into());
    }
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let wants = |kind: PassKind| wanted.is_empty() || wanted.iter().any(|word| kind.name().starts_with(word.as_str()));
    let job = Job::new(JobSize::Tiny)?;
    let mut passes = passes(&job, &Device::flex())?;
    passes.retain(|pass| pass.kind != PassKind::Step);
    let view = job.size.view().expect("the scene is a synthetic one");
    passes.push(Pass { kind: PassKind::Step, prepare: stateful(view.trainer(1), Trainer::step) });
    for Pass { kind, prepare } in passes.iter_mut().filter(|pass| wants(pass.kind)) {
        for _ in 0..WARM_UP {
            prepare()?()?;
        }
        let timed = prepare()?;
        let (kept, Allocated { total, peak }) = allocated(|| splat_counted(timed));
        drop(kept?);
        println!("{}\t{total}\t{peak}", kind.name());
    }
    Ok(())
}

/// Runs the counted part. Callgrind finds the function by its name.
#[unsafe(no_mangle)]
#[inline(never)]
fn splat_counted(timed: TimedPart) -> Result<PassResult, Box<dyn Error>> {
    timed()
}
