//! `splat`: the command-line program over [`splat_train`].

use std::process::ExitCode;

use splat_train::registry::{Registry, main_with};

splat_train::allocator!();

fn main() -> ExitCode {
    main_with(Registry::new())
}
