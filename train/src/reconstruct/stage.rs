//! One run of a program: its lines while it runs, Ctrl-C, and how it ended.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};

use crate::stop::{Interrupted, Stop};

/// Time between two looks at whether the user asked to stop.
const LOOK: Duration = Duration::from_millis(100);

/// Last lines that are kept for a message.
const TAIL: usize = 12;

/// How a program ended.
pub struct Ended {
    pub status: ExitStatus,
    pub tail: VecDeque<String>,
    /// The last line on standard error. The order of lines from both outputs is not known.
    pub error: Option<String>,
}

impl Ended {
    pub fn signal(&self) -> Option<i32> {
        #[cfg(unix)]
        return std::os::unix::process::ExitStatusExt::signal(&self.status);
        #[cfg(not(unix))]
        return None;
    }

    /// Its last line that says something.
    pub fn last_line(&self) -> &str {
        if let Some(error) = &self.error {
            return error;
        }
        self.tail.iter().rev().map(|line| line.trim()).find(|line| !line.is_empty()).unwrap_or("nothing")
    }
}

/// Runs a program to its end, and hands each line that it prints to `line` and to the log. The program ends when the
/// user asks to stop. An error is [`Interrupted`] if the user asked to stop, with `during` in the message, or says that
/// the program cannot be started or the log written.
pub fn run(
    mut command: Command,
    stop: &Stop,
    during: &str,
    log: &mut File,
    mut line: impl FnMut(&str),
) -> Result<Ended> {
    let name = command.get_program().to_string_lossy().into_owned();
    writeln!(log, "\n$ {command:?}").context("cannot write the log")?;
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = Running(command.spawn().with_context(|| format!("cannot run `{name}`"))?);
    let (sender, lines) = mpsc::channel();
    let pipes: [Option<Box<dyn Read + Send>>; 2] =
        [child.0.stdout.take().map(|pipe| Box::new(pipe) as _), child.0.stderr.take().map(|pipe| Box::new(pipe) as _)];
    for (pipe, is_error) in pipes.into_iter().zip([false, true]) {
        let (Some(pipe), sender) = (pipe, sender.clone()) else { continue };
        thread::spawn(move || send_lines(pipe, is_error, &sender));
    }
    drop(sender);
    let (mut tail, mut error) = (VecDeque::new(), None);
    loop {
        if let Some(signal) = stop.asked() {
            let by = if signal == signal_hook::consts::SIGINT as u8 { "Ctrl-C" } else { "SIGTERM" };
            let message = format!("stopped by {by} {during}: the same command goes on from the last finished stage");
            return Err(Interrupted { signal, message }.into());
        }
        match lines.recv_timeout(LOOK) {
            Ok((is_error, text)) => {
                writeln!(log, "{text}").context("cannot write the log")?;
                line(&text);
                if is_error && !text.trim().is_empty() {
                    error = Some(text.trim().to_owned());
                }
                tail.push_back(text);
                if tail.len() > TAIL {
                    tail.pop_front();
                }
            }
            // A program that it started may keep the pipe open.
            Err(RecvTimeoutError::Timeout) if child.0.try_wait()?.is_none() => {}
            Err(_) => break,
        }
    }
    let status = child.0.wait().with_context(|| format!("cannot wait for `{name}`"))?;
    // COLMAP, which the terminal stops too, may be gone before the request is heard.
    if let (Some(signal), false) = (stop.asked(), status.success()) {
        let message = format!("stopped {during}: the same command goes on from the last finished stage");
        return Err(Interrupted { signal, message }.into());
    }
    Ok(Ended { status, tail, error })
}

/// A program that does not outlive this value.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail for a program that has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn send_lines(pipe: impl Read, is_error: bool, lines: &Sender<(bool, String)>) {
    let mut pipe = BufReader::new(pipe);
    let mut bytes = Vec::new();
    while pipe.read_until(b'\n', &mut bytes).is_ok_and(|read| read > 0) {
        let text = String::from_utf8_lossy(&bytes).trim_end().to_owned();
        bytes.clear();
        if lines.send((is_error, text)).is_err() {
            return;
        }
    }
}
