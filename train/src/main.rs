//! `splat`: the command-line program over [`splat_train`].

use std::process::ExitCode;

use splat_train::memory::{CountingAllocator, Fast};
use splat_train::options;
use splat_train::ranks;
use splat_train::train::Interrupted;

// The wrapper counts bytes while `splat pareto` measures the memory of a pass.
splat_train::allocator!(CountingAllocator<Fast>, CountingAllocator(Fast));

/// Silences GPU drivers, which look for a Wayland display: its library prints an error where nobody is logged in to a
/// desktop and this variable is unset or empty.
fn quieten_wayland() {
    const FOLDER: &str = "XDG_RUNTIME_DIR";
    if cfg!(target_os = "linux") && std::env::var_os(FOLDER).is_none_or(|folder| folder.is_empty()) {
        // SAFETY: no other thread exists yet that could read the environment.
        unsafe { std::env::set_var(FOLDER, "/nonexistent") };
    }
}

/// Exit codes: 0 on success, 1 on an error, 2 (from clap) for an invalid command line, 130 and 143 for a run stopped by
/// Ctrl-C and SIGTERM.
fn main() -> ExitCode {
    quieten_wayland();
    match options::parse(std::env::args_os()).and_then(|cli| splat_train::run(&cli.command)) {
        Ok(()) => {
            ranks::leave();
            ExitCode::SUCCESS
        }
        Err(error) => {
            if let Some(error) = error.downcast_ref::<clap::Error>() {
                // Help, the version, or an invalid command line.
                error.exit();
            }
            if let Some(interrupted) = error.downcast_ref::<Interrupted>() {
                ranks::say(&interrupted.to_string());
                ranks::leave();
                return interrupted.exit_code().into();
            }
            ranks::say(&splat_train::describe(&error));
            ranks::abort(1);
            ExitCode::FAILURE
        }
    }
}
