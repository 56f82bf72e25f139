//! Runs of several processes under `mpirun`, all on this machine.

#[path = "cli/run.rs"]
#[allow(dead_code, reason = "the other tests of the program use the rest")]
mod run;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::thread;
use std::time::{Duration, Instant};

use run::{DEMO, Ended, end, fresh, splat, succeed};

/// Arguments of a run of three photographs per step, which two ranks cannot share evenly.
const BATCH: [&str; 9] = ["train", "--steps", "24", "--batch", "3", "--max-side", "64", "--seed", "7"];

/// `mpirun` as root and with more processes than cores, as on CI machines.
fn mpirun(ranks: usize) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["-n", &ranks.to_string()]);
    for name in ["OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe"] {
        command.env(name, "1");
    }
    // Shared memory between containers' processes may be forbidden.
    command.env("OMPI_MCA_btl_vader_single_copy_mechanism", "none");
    command
}

/// `splat` with these arguments on several ranks.
fn on(ranks: usize, arguments: &[&str]) -> Command {
    let mut command = mpirun(ranks);
    command.arg(env!("CARGO_BIN_EXE_splat")).args(arguments);
    if arguments[0] == "train" {
        command.args(["--device", "cpu"]);
    }
    command
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn scene(out: &Path) -> Vec<u8> {
    fs::read(out.join("scene.ply")).unwrap()
}

/// Output of the run in one process, with every effect that the demo can have.
fn arguments<'a>(out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    [&BATCH[..], &[text(&DEMO), "--out", text(out)], more].concat()
}

const EFFECTS: [&str; 2] =
    ["--effects", "antialias,exposure,bilateral-grid,pose-refinement,depth-supervision,environment"];

static ALONE: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = fresh("mpi-alone");
    succeed(&mut splat(&arguments(&out, &[])));
    out
});

fn files(folder: &Path) -> BTreeSet<String> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn ranks_train_the_scene_of_one_process() {
    for ranks in [2, 4] {
        let out = fresh(&format!("mpi-{ranks}"));
        let Ended { stdout, stderr, .. } = succeed(&mut on(ranks, &arguments(&out, &[])));
        assert!(scene(&out) == scene(&ALONE), "on {ranks} ranks");
        assert_eq!(files(&out), files(&ALONE));
        // Rank 0 alone speaks.
        assert_eq!(stdout.matches("splats)").count(), 1, "{stdout}");
        assert_eq!(stderr.matches("photographs to train on").count(), 1, "{stderr}");
    }
}

#[test]
fn effects_and_strategies_have_the_same_bits() {
    for (name, more) in
        [("effects", &EFFECTS[..]), ("mcmc", &["--strategy", "mcmc"]), ("absgrad", &["--strategy", "absgrad"])]
    {
        let [alone, together] = ["alone", "together"].map(|kind| fresh(&format!("mpi-{name}-{kind}")));
        succeed(&mut splat(&arguments(&alone, more)));
        succeed(&mut on(2, &arguments(&together, more)));
        assert!(scene(&together) == scene(&alone), "{name}");
    }
}

/// A run that has no end of its own within the test, once it has a checkpoint after its first.
fn begun(ranks: usize, out: &Path) -> Child {
    let child = on(ranks, &long(out, "100000")).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    while steps_in(out).iter().all(|step| *step < 4) {
        assert!(start.elapsed() < Duration::from_secs(60), "the run does not begin");
        thread::sleep(Duration::from_millis(20));
    }
    child
}

/// The steps of the checkpoints.
fn steps_in(out: &Path) -> Vec<usize> {
    let names = fs::read_dir(out.join("checkpoints")).into_iter().flatten().flatten().map(|entry| entry.file_name());
    let step =
        |name: std::ffi::OsString| name.to_str()?.strip_prefix("step-")?.strip_suffix(".safetensors")?.parse().ok();
    names.filter_map(step).collect()
}

/// The process of a rank below `mpirun`.
fn process_of(mpirun: u32, rank: usize) -> u32 {
    let is_rank = |pid: &u32| {
        let read = |name: &str| fs::read(format!("/proc/{pid}/{name}")).unwrap_or_default();
        let parent = String::from_utf8_lossy(&read("stat"))
            .rsplit(") ")
            .next()
            .and_then(|rest| rest.split(' ').nth(1)?.parse().ok());
        let wanted = format!("OMPI_COMM_WORLD_RANK={rank}");
        parent == Some(mpirun) && read("environ").split(|byte| *byte == 0).any(|variable| variable == wanted.as_bytes())
    };
    let mut pids = fs::read_dir("/proc").unwrap().filter_map(|entry| entry.unwrap().file_name().to_str()?.parse().ok());
    pids.find(is_rank).expect("the rank runs")
}

fn signal(pid: u32, signal: &str) {
    assert!(Command::new("kill").args([signal, &pid.to_string()]).status().unwrap().success());
}

/// Waits for the end of a run, for a minute at most.
fn ended(mut child: Child) -> Ended {
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < Duration::from_secs(60), "the run does not end");
        thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ended { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

#[test]
fn a_rank_that_dies_ends_the_run_which_any_number_of_ranks_resumes() {
    for rank in [1, 0] {
        let out = fresh("mpi-killed");
        let child = begun(3, &out);
        signal(process_of(child.id(), rank), "-KILL");
        let ended = ended(child);
        assert!(ended.code != Some(0) && ended.stderr.contains(&format!("rank {rank} ")), "{}", ended.stderr);
        assert!(ended.stderr.contains("Killed"), "{}", ended.stderr);
    }
    let [alone, parts] = ["alone", "parts"].map(|kind| fresh(&format!("mpi-killed-{kind}")));
    succeed(&mut splat(&long(&alone, "150")));
    in_parts(&parts);
    assert!(scene(&parts) == scene(&alone));
}

/// Arguments of a run of so many steps, with a checkpoint after every second.
fn long<'a>(out: &'a Path, steps: &'a str) -> Vec<&'a str> {
    let arguments = arguments(out, &["--checkpoint-every", "2"]);
    arguments.into_iter().map(|argument| if argument == "24" { steps } else { argument }).collect()
}

/// A run that is killed on three ranks, goes on on two, is killed again, and ends alone.
fn in_parts(out: &Path) {
    let at = |ranks, arguments: &[&str], step: usize| {
        let child = on(ranks, arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        while steps_in(out).iter().all(|found| *found < step) {
            assert!(start.elapsed() < Duration::from_secs(60), "the run does not go on");
            thread::sleep(Duration::from_millis(2));
        }
        let mut child = child;
        signal(process_of(child.id(), ranks - 1), "-KILL");
        child.wait().unwrap();
    };
    at(3, &long(out, "150"), 10);
    at(2, &["resume", text(out)], 40);
    succeed(&mut splat(&["resume", text(out)]));
}

#[test]
fn a_run_that_is_asked_to_stop_saves_itself() {
    let out = fresh("mpi-stopped");
    let child = begun(2, &out);
    signal(child.id(), "-TERM");
    let ended = ended(child);
    assert!(ended.stderr.contains("`splat resume"), "{}", ended.stderr);
    let said = ended.stderr.split("stopped after step ").nth(1).and_then(|rest| rest.split(';').next()).unwrap();
    assert!(steps_in(&out).contains(&said.parse().unwrap()), "{said}");
}

#[test]
fn ranks_with_other_options_are_refused() {
    let out = fresh("mpi-other");
    let given = arguments(&out, &["--device", "cpu"]);
    let refused = |other: &[&str], parts: &[&str]| {
        let mut command = mpirun(1);
        command
            .arg(env!("CARGO_BIN_EXE_splat"))
            .args(&given)
            .args([":", "-n", "1", env!("CARGO_BIN_EXE_splat")])
            .args(other);
        let ended = end(&mut command);
        assert_ne!(ended.code, Some(0));
        assert!(parts.iter().all(|part| ended.stderr.contains(part)), "{}", ended.stderr);
        assert!(!out.exists(), "nothing is written");
    };
    let seed = given.iter().map(|argument| if *argument == "7" { "8" } else { argument }).collect::<Vec<_>>();
    refused(&seed, &["error: the option `seed` is 8 on rank 1, and 7 on rank 0"]);
    let other = fresh("mpi-other-capture");
    succeed(splat(&["demo", "--views", "8", "--width", "64", "--height", "48", "--out"]).arg(&other));
    let capture =
        given.iter().map(|argument| if *argument == text(&DEMO) { text(&other) } else { argument }).collect::<Vec<_>>();
    refused(&capture, &["the option `capture` is", "on rank 1"]);
}

#[test]
fn an_error_of_one_rank_names_it_and_ends_all() {
    let (capture, out) = (fresh("mpi-broken-capture"), fresh("mpi-broken"));
    succeed(splat(&["demo", "--views", "8", "--width", "64", "--height", "48", "--out"]).arg(&capture));
    // Of seven training photographs the first three ranks decode two each, and rank 3 the last one.
    fs::write(capture.join("images/0007.png"), "no picture").unwrap();
    let arguments = [&BATCH[..], &[text(&capture), "--out", text(&out), "--effects", "none"]].concat();
    let ended = end(&mut on(4, &arguments));
    assert_ne!(ended.code, Some(0));
    assert!(ended.stderr.contains("rank 3: error: ") && ended.stderr.contains("0007.png"), "{}", ended.stderr);
}
