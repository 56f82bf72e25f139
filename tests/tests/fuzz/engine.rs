//! The fuzzing loop: mutates an input, reads it, and keeps it if its outcome is new.

use std::collections::HashSet;
use std::env;
use std::fs;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::allocations::most_held;
use super::mutate::{Mutator, mutate};

/// Longest time of a reader on one input, on a machine that is busy with other tests.
pub const LIMIT: Duration = Duration::from_secs(5);

/// Bytes that a reader may hold for any input, mostly for its read buffer.
pub const ROOM: usize = 3 << 20;

/// Further bytes that a reader may hold per byte of input.
pub const MULTIPLE: usize = 24;

/// Length of the longest input. Faults of longer inputs also appear at this length.
const LONGEST: usize = 1 << 16;

/// Largest number of inputs that are mutated further, so that a long run does not fill the memory.
const LARGEST_CORPUS: usize = 20_000;

/// A reader under test.
pub trait FuzzTarget {
    /// Short name, for files.
    fn name(&self) -> &'static str;
    /// Returns valid inputs.
    fn seeds(&self) -> Vec<Vec<u8>>;
    /// Returns words of the format.
    fn words(&self) -> &'static [&'static str];
    /// Splits an input into fields, as far as it still has any. The fields in order are the whole input.
    fn split(&self, input: &[u8]) -> Vec<Vec<u8>>;
    /// Writes an input to the file that [`FuzzTarget::read`] reads.
    fn place(&mut self, input: &[u8]);
    /// Reads the input. Returns a description of the outcome, equal for similar inputs.
    ///
    /// # Errors
    /// A description of an inconsistent result.
    fn read(&mut self) -> Result<String, String>;
}

/// Statistics of a run.
#[derive(Default)]
struct Tally {
    inputs: u64,
    accepted: u64,
    slowest: Duration,
    most_bytes: usize,
    /// Largest `(bytes held − ROOM) / input`.
    multiple: f64,
}

/// Mutates and reads inputs for `SPLAT_FUZZ_SECONDS`.
///
/// # Panics
/// At the first input that breaks a rule, which is kept in `target/tmp/fuzz`.
pub fn fuzz(target: &mut dyn FuzzTarget) {
    let seconds = number("SPLAT_FUZZ_SECONDS").unwrap_or(30);
    let mut mutator = Mutator::new(number("SPLAT_FUZZ_SEED").unwrap_or(0));
    let watch = Watchdog::start(target.name());
    let mut seen = HashSet::new();
    let mut corpus: Vec<Vec<u8>> = Vec::new();
    let mut tally = Tally::default();
    for seed in target.seeds() {
        let outcome = one(target, &seed, &watch, &mut tally);
        assert!(outcome.starts_with("accepted"), "{}: a seed is refused: {outcome}", target.name());
        seen.insert(outcome);
        corpus.push(seed);
    }
    let seeds = corpus.len();
    let until = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < until {
        let input = mutate(&mut mutator, target, &corpus, seeds, LONGEST);
        let outcome = one(target, &input, &watch, &mut tally);
        if seen.insert(outcome) && corpus.len() < LARGEST_CORPUS {
            corpus.push(input);
        }
    }
    watch.stop();
    // The folder belongs to this target and is no longer needed.
    let _ = fs::remove_dir_all(folder(target.name()));
    let Tally { inputs, accepted, slowest, most_bytes, multiple } = tally;
    let line = format!(
        "fuzz {}: {inputs} inputs in {seconds} s ({} per s), {accepted} accepted, {} outcomes, slowest {slowest:.0?}, at most \
         {most_bytes} bytes held, {multiple:.1} per byte beyond {ROOM}",
        target.name(),
        inputs / seconds.max(1),
        seen.len(),
    );
    // Written directly to stderr, because the test harness hides the output of passing tests.
    let _ = writeln!(std::io::stderr(), "{line}");
    // With few accepted inputs the deeper code of a reader would hardly run.
    assert!(accepted * 100 > inputs, "{line}: hardly anything is accepted");
    assert!(seen.len() > 10 || seconds < 10, "{line}: few outcomes");
}

/// Reads one input, checks the reader against the rules and returns the outcome.
fn one(target: &mut dyn FuzzTarget, input: &[u8], watch: &Watchdog, tally: &mut Tally) -> String {
    target.place(input);
    watch.begin();
    let start = Instant::now();
    let (read, held) = most_held(|| catch_unwind(AssertUnwindSafe(|| target.read())));
    let took = start.elapsed();
    watch.end();
    let fail = |what: String| -> ! {
        let kept = keep(target.name(), input);
        panic!("{}: {what}; the input is {}", target.name(), kept.display())
    };
    let outcome = match read {
        Err(_) => fail("the reader panicked".into()),
        Ok(Err(what)) => fail(what),
        Ok(Ok(outcome)) => outcome,
    };
    if took > LIMIT {
        fail(format!("it took {took:?}"));
    }
    let beyond = held.saturating_sub(ROOM);
    if beyond > MULTIPLE * input.len() {
        fail(format!("{held} bytes were held for {} bytes of input", input.len()));
    }
    tally.inputs += 1;
    tally.accepted += u64::from(outcome.starts_with("accepted"));
    tally.slowest = tally.slowest.max(took);
    tally.most_bytes = tally.most_bytes.max(held);
    tally.multiple = tally.multiple.max(beyond as f64 / input.len().max(1) as f64);
    outcome
}

/// Returns the folder of a target's files, in memory if the system supports it, because each input is a file.
pub fn folder(name: &str) -> PathBuf {
    let shared_memory = Path::new("/dev/shm");
    let base = if shared_memory.is_dir() { shared_memory } else { Path::new(env!("CARGO_TARGET_TMPDIR")) };
    let folder = base.join(format!("splat-fuzz-{}", std::process::id())).join(name);
    fs::create_dir_all(&folder).expect("the folder can be written to");
    folder
}

fn keep(name: &str, input: &[u8]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz");
    let path = folder.join(format!("{name}-{:016x}", checksum(input)));
    fs::create_dir_all(&folder).and_then(|()| fs::write(&path, input)).expect("the target folder can be written to");
    path
}

/// Hashes bytes by FNV-1a, for a file name.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

fn number(variable: &str) -> Option<u64> {
    let text = env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text} is not a number: give a whole number")))
}

/// Ends the process if a reader never returns, because a test cannot be ended otherwise. The input is then still in its folder.
struct Watchdog(Arc<WatchdogTimes>);

struct WatchdogTimes {
    start: Instant,
    /// Start of the current input, ms since `start`, plus 1; 0 between inputs, `u64::MAX` at the end.
    since: AtomicU64,
}

impl Watchdog {
    fn start(name: &'static str) -> Self {
        let times = Arc::new(WatchdogTimes { start: Instant::now(), since: AtomicU64::new(0) });
        let watched = times.clone();
        thread::spawn(move || {
            loop {
                thread::sleep(Duration::from_millis(500));
                let (now, since) = (watched.now(), watched.since.load(Ordering::Relaxed));
                match since {
                    u64::MAX => return,
                    1.. if now.saturating_sub(since) > 4 * LIMIT.as_millis() as u64 => {
                        let folder = folder(name);
                        let _ =
                            writeln!(std::io::stderr(), "{name}: a reader hangs; its input is in {}", folder.display());
                        std::process::abort();
                    }
                    _ => {}
                }
            }
        });
        Self(times)
    }

    fn begin(&self) {
        self.0.since.store(self.0.now(), Ordering::Relaxed);
    }

    fn end(&self) {
        self.0.since.store(0, Ordering::Relaxed);
    }

    fn stop(self) {
        self.0.since.store(u64::MAX, Ordering::Relaxed);
    }
}

impl WatchdogTimes {
    fn now(&self) -> u64 {
        self.start.elapsed().as_millis() as u64 + 1
    }
}
