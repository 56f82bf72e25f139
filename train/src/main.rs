//! `splat`: the command-line program over [`splat_train`].

use std::process::ExitCode;

use clap::Parser;
use splat_train::memory::Counted;
use splat_train::options::Cli;
use splat_train::ranks;
use splat_train::train::Interrupted;

#[cfg(target_os = "linux")]
use tikv_jemallocator::Jemalloc as Fast;

#[cfg(not(target_os = "linux"))]
use mimalloc::MiMalloc as Fast;

/// Allocator that keeps freed blocks for a while. A step allocates and frees tensors of megabytes; the system's allocator returns
/// such blocks to the kernel each time and has them cleared on the next use. The wrapper counts bytes while `splat pareto` measures the
/// memory of a pass.
#[global_allocator]
static ALLOCATOR: Counted<Fast> = Counted(Fast);

/// Options of jemalloc. Freed memory goes back to the system within a second, and all blocks come from one arena, so that large ones are kept for
/// the next step too and threads use what others freed.
#[cfg(target_os = "linux")]
// SAFETY: jemalloc reads a string under this name, which ends with a zero.
#[unsafe(export_name = "_rjem_malloc_conf")]
static MALLOC_CONF: &[u8] = b"narenas:1,oversize_threshold:0,dirty_decay_ms:1000,muzzy_decay_ms:0\0";

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
    match splat_train::run(&Cli::parse().command) {
        Ok(()) => {
            ranks::leave();
            ExitCode::SUCCESS
        }
        Err(error) => {
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
