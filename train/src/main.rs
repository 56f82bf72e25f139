//! `splat`: the command line over [`splat_train`].

use std::process::ExitCode;

use clap::Parser;
use splat_train::options::Cli;

/// A step makes and drops tensors of megabytes. The system's allocator hands such blocks back to the kernel each time
/// and has them cleared on the next use; this one keeps them.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// 0 on success, 1 on an error, 2 (by clap) for a command line that cannot be understood.
fn main() -> ExitCode {
    match splat_train::run(&Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            splat_train::progress::note(&splat_train::describe(&error));
            ExitCode::FAILURE
        }
    }
}
