//! Compares the instructions and bytes of each pass of a training step with the record in `benches/counts.tsv`. The counts show
//! the cost of a change on any machine under any load. Growth of more than 5% fails.
//!
//! `SPLAT_COUNTS=accept cargo test --release --workspace --test counts` records the counts. With `SPLAT_COUNTS=require`, which CI
//! sets, a machine that cannot count fails the test. If the variable is unset, the test is skipped there with a message, and `skip`
//! always skips it.
//!
//! Counting requires valgrind, an x86-64 processor with AVX2, and an optimised build.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use splat_benches::counts::{Count, compare, read, write};

const RECORD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/counts.tsv");
const ACCEPT: &str = "SPLAT_COUNTS=accept cargo test --release --workspace --test counts";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            println!("counts: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let mode = std::env::var("SPLAT_COUNTS").unwrap_or_default();
    match (mode.as_str(), obstacle()) {
        ("skip", _) => println!("counts: skipped, because SPLAT_COUNTS is `skip`"),
        ("", Some(obstacle)) => println!("counts: skipped, because {obstacle}"),
        ("require" | "accept", Some(obstacle)) => return Err(obstacle.into()),
        ("accept", None) => accept()?,
        ("" | "require", None) => check()?,
        (other, _) => return Err(format!("SPLAT_COUNTS is `{other}`, expected `require`, `accept` or `skip`").into()),
    }
    Ok(())
}

/// Returns the reason why this machine or build cannot count.
fn obstacle() -> Option<&'static str> {
    #[cfg(target_arch = "x86_64")]
    let avx2 = std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    let avx2 = false;
    match () {
        () if cfg!(debug_assertions) => Some("this build is not optimised: pass `--release`"),
        () if !avx2 => Some("the processor has no AVX2"),
        () if Command::new("valgrind").arg("--version").output().is_err() => {
            Some("valgrind is not installed: `apt-get install valgrind`")
        }
        () => None,
    }
}

fn accept() -> Result<(), Box<dyn Error>> {
    let compiler = Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version").output();
    let compiler = compiler.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default();
    let comments = ["See tests/counts.rs; rewritten with", ACCEPT, &format!("By {compiler}")];
    fs::write(RECORD, write(&count()?, &comments))?;
    println!("counts: written to {RECORD}");
    Ok(())
}

fn check() -> Result<(), Box<dyn Error>> {
    let record = fs::read_to_string(RECORD).map_err(|error| format!("{RECORD}: {error}; `{ACCEPT}` writes it"))?;
    let (recorded, found) = (read(&record)?, count()?);
    print!("{}", write(&found, &["counts:"]));
    let differences = compare(&recorded, &found);
    for difference in &differences {
        println!("{difference}");
    }
    if !differences.iter().any(|difference| difference.fails()) {
        if !differences.is_empty() {
            println!("counts: less than recorded; to record the gain: {ACCEPT}");
        }
        return Ok(());
    }
    let made = record.lines().find_map(|line| line.strip_prefix("# By ")).unwrap_or("an unknown compiler");
    Err(format!("more than recorded (by {made}; another compiler counts differently). If justified: {ACCEPT}").into())
}

/// Runs the passes under callgrind and returns their counts.
fn count() -> Result<Vec<Count>, Box<dyn Error>> {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("counts");
    // Files of an earlier run would be read as this run's.
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder)?;
    let out = folder.join("callgrind");
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .args(["--toggle-collect=splat_counted", "--dump-after=splat_counted"])
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(env!("CARGO_BIN_EXE_counted"))
        // The size of the environment moves the stack.
        .env_clear()
        .envs(std::env::var_os("PATH").map(|path| ("PATH", path)))
        .output()?;
    if !output.status.success() {
        return Err(format!("callgrind: {}\n{}", output.status, String::from_utf8_lossy(&output.stderr)).into());
    }
    let lines = String::from_utf8(output.stdout)?;
    let passes = lines.lines().enumerate();
    passes.map(|(i, line)| with_instructions(line, &folder.join(format!("callgrind.{}", i + 1)))).collect()
}

/// Combines a line of the program with the total of the file that callgrind wrote for it.
fn with_instructions(line: &str, file: &Path) -> Result<Count, Box<dyn Error>> {
    let text = fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let total = text.lines().find_map(|line| line.strip_prefix("totals: ")).ok_or("a file without totals")?;
    let fields: Vec<&str> = line.split('\t').collect();
    let [pass, allocated, peak] = fields[..] else { return Err(format!("not a count: {line:?}").into()) };
    Ok(Count {
        pass: pass.into(),
        instructions: total.trim().parse()?,
        allocated: allocated.parse()?,
        peak: peak.parse()?,
    })
}
