//! `splat`: the command-line program over [`splat_train`].

use std::process::ExitCode;

use splat_train::memory::{CountingAllocator, Fast};
use splat_train::registry::{Registry, main_with};

// The wrapper counts bytes while `splat pareto` measures the memory of a pass.
splat_train::allocator!(CountingAllocator<Fast>, CountingAllocator(Fast));

fn main() -> ExitCode {
    main_with(Registry::new())
}
