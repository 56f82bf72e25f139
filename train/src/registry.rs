//! The program as a function, for programs with losses, strategies, effects and formats of captures of their own.

use std::ffi::OsString;
use std::process::ExitCode;

pub use crate::parts::Registry;
use crate::stop::Interrupted;
use crate::{options, parts, ranks};

/// Silences GPU drivers, which look for a Wayland display: its library prints an error where nobody is logged in to a
/// desktop and this variable is unset or empty.
fn quieten_wayland() {
    const FOLDER: &str = "XDG_RUNTIME_DIR";
    if cfg!(target_os = "linux") && std::env::var_os(FOLDER).is_none_or(|folder| folder.is_empty()) {
        // SAFETY: no other thread exists yet that could read the environment.
        unsafe { std::env::set_var(FOLDER, "/nonexistent") };
    }
}

/// Runs the program `splat` on the command line of the process, with the parts of a registry beside its own. Call it once, as all of
/// `main`.
///
/// Exit codes: 0 on success, 1 on an error, 2 (from clap) for an invalid command line, 130 and 143 for a run stopped by Ctrl-C and SIGTERM.
pub fn main_with(registry: Registry) -> ExitCode {
    main_of(registry, std::env::args_os())
}

/// [`main_with`] on other words than those of the process. For tests.
#[doc(hidden)]
pub fn main_of(registry: Registry, words: impl IntoIterator<Item = OsString>) -> ExitCode {
    // A second call would find the names of the first.
    parts::install(registry);
    quieten_wayland();
    match options::parse(words).and_then(|cli| crate::run(&cli.command)) {
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
            ranks::say(&crate::describe(&error));
            ranks::abort(1);
            ExitCode::FAILURE
        }
    }
}
