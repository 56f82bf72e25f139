//! Ctrl-C and SIGTERM during a run: the first signal stops the run after its step, the second ends the process at once.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Error of a run that was asked to stop, and did.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Interrupted {
    /// Signal that asked to stop.
    pub signal: u8,
    /// State of the run, for people.
    pub message: String,
}

impl Interrupted {
    /// Exit code that a shell reports for a program ended by that signal: 130 for Ctrl-C, 143 for SIGTERM.
    pub fn exit_code(&self) -> u8 {
        128 + self.signal
    }
}

/// Listens for signals while it exists. Before and afterwards such a signal ends the process at once.
pub struct Stop(&'static Heard);

/// State of the whole process, because handlers stay registered.
#[derive(Default)]
struct Heard {
    signal: Arc<AtomicUsize>,
    at_once: Arc<AtomicBool>,
}

static HEARD: OnceLock<Heard> = OnceLock::new();

impl Stop {
    /// Registers the handlers and begins to listen.
    pub fn listen() -> io::Result<Self> {
        let heard = match HEARD.get() {
            Some(heard) => heard,
            None => {
                let heard = Heard::default();
                for signal in [SIGINT, SIGTERM] {
                    // The order matters: the second signal must find the flag that the first one sets.
                    flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&heard.at_once))?;
                    flag::register(signal, Arc::clone(&heard.at_once))?;
                    flag::register_usize(signal, Arc::clone(&heard.signal), signal as usize)?;
                }
                HEARD.get_or_init(|| heard)
            }
        };
        heard.signal.store(0, Ordering::Relaxed);
        heard.at_once.store(false, Ordering::Relaxed);
        Ok(Self(heard))
    }

    /// Returns the signal that asked to stop, if there was one.
    pub fn asked(&self) -> Option<u8> {
        u8::try_from(self.0.signal.load(Ordering::Relaxed)).ok().filter(|signal| *signal != 0)
    }
}

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.at_once.store(true, Ordering::Relaxed);
    }
}
