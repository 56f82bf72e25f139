//! Ctrl-C and SIGTERM while a run is on its way: the first asks it to stop after its step, the second ends it at once.

use std::fmt::{self, Display};
use std::io;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// A run that was asked to stop, and did.
#[derive(Debug)]
pub struct Interrupted {
    /// Which signal asked.
    pub signal: u8,
    /// What became of the run, for people.
    pub message: String,
}

impl Interrupted {
    /// The code that a shell gives a program which that signal ended: 130 for Ctrl-C, 143 for SIGTERM.
    pub fn exit_code(&self) -> u8 {
        128 + self.signal
    }
}

impl Display for Interrupted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Interrupted {}

/// Listens while it lives. Before and afterwards such a signal ends the program at once.
pub struct Stop(&'static Heard);

/// Of the whole process, because handlers stay.
#[derive(Default)]
struct Heard {
    signal: Arc<AtomicUsize>,
    at_once: Arc<AtomicBool>,
}

static HEARD: OnceLock<Heard> = OnceLock::new();

impl Stop {
    /// Begins to listen.
    ///
    /// # Errors
    /// If the system does not let it.
    pub fn listen() -> io::Result<Self> {
        let heard = match HEARD.get() {
            Some(heard) => heard,
            None => {
                let heard = Heard::default();
                heard.register()?;
                HEARD.get_or_init(|| heard)
            }
        };
        heard.signal.store(0, Ordering::Relaxed);
        heard.at_once.store(false, Ordering::Relaxed);
        Ok(Self(heard))
    }

    /// The signal that has asked to stop.
    pub fn asked(&self) -> Option<u8> {
        u8::try_from(self.0.signal.load(Ordering::Relaxed)).ok().filter(|signal| *signal != 0)
    }
}

impl Heard {
    fn register(&self) -> io::Result<()> {
        for signal in [SIGINT, SIGTERM] {
            // In this order: what the first signal sets is what the second one finds.
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&self.at_once))?;
            flag::register(signal, Arc::clone(&self.at_once))?;
            flag::register_usize(signal, Arc::clone(&self.signal), signal as usize)?;
        }
        Ok(())
    }
}

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.at_once.store(true, Ordering::Relaxed);
    }
}
