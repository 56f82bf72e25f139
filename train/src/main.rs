//! `splat`: the command line over [`splat_train`].

use std::process::ExitCode;

use clap::Parser;
use splat_train::memory::Counted;
use splat_train::options::Cli;
use splat_train::train::Interrupted;

/// A step makes and drops tensors of megabytes. The system's allocator hands such blocks back to the kernel each time
/// and has them cleared on the next use; this one keeps them. It is counted where `splat pareto` asks how much memory a pass takes.
#[global_allocator]
static ALLOCATOR: Counted<mimalloc::MiMalloc> = Counted(mimalloc::MiMalloc);

/// Drivers of GPUs look for a Wayland display, whose library prints an error where nobody is logged in to a desktop and
/// this variable is not set or empty.
fn quieten_wayland() {
    const FOLDER: &str = "XDG_RUNTIME_DIR";
    if cfg!(target_os = "linux") && std::env::var_os(FOLDER).is_none_or(|folder| folder.is_empty()) {
        // SAFETY: the program has one thread as yet, so nobody reads the environment meanwhile.
        unsafe { std::env::set_var(FOLDER, "/nonexistent") };
    }
}

/// 0 on success, 1 on an error, 2 (by clap) for a command line that cannot be understood, 130 and 143 for a run that was
/// stopped by Ctrl-C and SIGTERM.
fn main() -> ExitCode {
    quieten_wayland();
    match splat_train::run(&Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if let Some(interrupted) = error.downcast_ref::<Interrupted>() {
                splat_train::progress::error(&interrupted.to_string());
                return interrupted.exit_code().into();
            }
            splat_train::progress::error(&splat_train::describe(&error));
            ExitCode::FAILURE
        }
    }
}
