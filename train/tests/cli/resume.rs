//! Runs that are stopped, killed or obstructed, and resumed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::run::{DEMO, end, fresh, refuse, splat, succeed};
use crate::{files, json, text};

/// Number of steps of a run, enough for some to be lost.
const STEPS: usize = 60;

/// Steps between its checkpoints.
const EVERY: usize = 7;

fn training(out: &Path) -> Command {
    let mut command = splat(&["train"]);
    let numbers = [STEPS, EVERY].map(|number| number.to_string());
    command.args(["--steps", &numbers[0], "--checkpoint-every", &numbers[1], "--max-side", "64", "--seed", "7"]);
    command.arg(DEMO.as_path()).arg("--out").arg(out);
    command
}

/// A resumed run keeps its options; any other option is an error.
fn resuming(out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_splat"));
    command.args(["resume", text(out)]);
    command
}

/// Output and duration of such a run without interruption.
static WHOLE: LazyLock<(PathBuf, Duration)> = LazyLock::new(|| {
    let (out, start) = (fresh("whole"), Instant::now());
    succeed(&mut training(&out));
    (out, start.elapsed())
});

/// Returns the steps of the existing checkpoints.
fn checkpoints(out: &Path) -> Vec<usize> {
    let folder = out.join("checkpoints");
    let mut steps: Vec<usize> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| {
            let name = entry.unwrap().file_name().into_string().unwrap();
            name.strip_prefix("step-")?.strip_suffix(".safetensors")?.parse().ok()
        })
        .collect();
    steps.sort_unstable();
    steps
}

/// Checks that the scene is the same, bit for bit, and so are the scores.
#[track_caller]
fn assert_as_whole(out: &Path) {
    let whole = WHOLE.0.as_path();
    assert!(fs::read(out.join("scene.ply")).unwrap() == fs::read(whole.join("scene.ply")).unwrap(), "another scene");
    let test = |out: &Path| json(&out.join("metrics.json"))["test"].clone();
    assert_eq!(test(out), test(whole));
    assert_eq!(files(out), files(whole));
}

fn spawn(command: &mut Command) -> Child {
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Waits until a run has a checkpoint of at least this step.
fn wait_for(out: &Path, step: usize, child: &mut Child) {
    while checkpoints(out).last().is_none_or(|newest| *newest < step) {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns a run that was killed after this step or a later one.
fn killed(name: &str, step: usize) -> PathBuf {
    let out = fresh(name);
    let mut child = spawn(&mut training(&out));
    wait_for(&out, step, &mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    out
}

/// Kills a run at `times` random moments and resumes it after each, then lets it end.
fn killed_at_random(name: &str, times: usize) {
    let (out, duration) = (fresh(name), WHOLE.1);
    let mut rng = ChaCha8Rng::seed_from_u64(times as u64);
    let mut kills = 0;
    while kills < times {
        // A run killed before its first checkpoint has not begun.
        let begun = !checkpoints(&out).is_empty();
        let before = checkpoints(&out).pop().unwrap_or(0);
        let mut command = if begun { resuming(&out) } else { training(&out) };
        let said = out.with_extension("log");
        let mut child = command.stdout(Stdio::null()).stderr(fs::File::create(&said).unwrap()).spawn().unwrap();
        std::thread::sleep(duration.mul_f64(rng.random_range(0.0..1.0)));
        let ended = child.try_wait().unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        if let Some(ended) = ended {
            let said = fs::read_to_string(&said).unwrap();
            assert!(ended.success(), "a run failed after {kills} kills: {said}");
            assert_as_whole(&out);
            fs::remove_dir_all(&out).unwrap();
            continue;
        }
        kills += 1;
        let found = checkpoints(&out);
        if found.is_empty() && out.join("metrics.json").is_file() {
            // Killed on exit, after its results were written.
            assert_as_whole(&out);
            fs::remove_dir_all(&out).unwrap();
            continue;
        }
        assert!(found.len() <= 3 && (!begun || found.last().is_some_and(|newest| *newest >= before)), "{found:?}");
        // Only the steps since the last checkpoint are lost.
        assert!(found.windows(2).all(|pair| pair[1] - pair[0] == EVERY), "{found:?}");
    }
    let begun = !checkpoints(&out).is_empty();
    succeed(&mut if begun { resuming(&out) } else { training(&out) });
    assert_as_whole(&out);
}

#[test]
fn a_run_that_is_killed_at_random_moments_goes_on() {
    killed_at_random("killed", 5);
}

#[test]
#[ignore = "takes minutes"]
fn a_run_that_is_killed_at_fifty_random_moments_goes_on() {
    killed_at_random("killed-often", 50);
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_the_run() {
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let out = fresh(&format!("stopped-{signal}"));
        let mut child = training(&out).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        wait_for(&out, EVERY, &mut child);
        succeed(Command::new("kill").args(["-s", signal, &child.id().to_string()]));
        let output = child.wait_with_output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert!(
            stderr.contains("stopped after step") && stderr.contains(&format!("splat resume {}", text(&out))),
            "{stderr}"
        );
        assert!(!stderr.contains("error"), "{stderr}");
        succeed(&mut resuming(&out));
        assert_as_whole(&out);
    }
}

#[test]
fn options_are_those_of_the_run() {
    let out = killed("options", EVERY);
    let ended = end(resuming(&out).args(["--steps", "9"]));
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.stderr.contains("--steps"), "{}", ended.stderr);
    // Resumed from another folder, under another name.
    let moved = fresh("options-moved");
    fs::rename(&out, &moved).unwrap();
    let ended = succeed(resuming(&moved).current_dir("/"));
    assert!(ended.stderr.contains("resuming from step"), "{}", ended.stderr);
    assert_as_whole(&moved);
    // The same line can be run again and again.
    let ended = succeed(&mut resuming(&moved));
    assert!(ended.stderr.contains("is finished"), "{}", ended.stderr);
    assert_as_whole(&moved);
}

/// A run of which there is nothing but its options begins.
#[test]
fn a_run_is_repeated_from_its_options() {
    let (again, begun) = (fresh("again"), fresh("begun"));
    let options = WHOLE.0.join("run.toml");
    succeed(&mut splat(&["train", "--config", text(&options), "--out", text(&again)]));
    assert_as_whole(&again);
    let text_of = |out: &Path| fs::read_to_string(out.join("run.toml")).unwrap();
    assert_eq!(text_of(&again), fs::read_to_string(&options).unwrap());
    for part in ["steps = 60", "effects = \"none\"", "sh_degree = ", "max_side = 64", "checkpoint_every = 7"] {
        assert!(text_of(&again).contains(part), "{part}: {}", text_of(&again));
    }
    fs::create_dir_all(&begun).unwrap();
    fs::copy(&options, begun.join("run.toml")).unwrap();
    succeed(&mut resuming(&begun));
    assert_as_whole(&begun);
    refuse(&mut splat(&["train", "--config", text(&options), "--out", text(&WHOLE.0)]), &["run.toml is an input"]);
}

#[test]
fn where_there_is_no_run_none_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    refuse(&mut resuming(folder.path()), &["no checkpoint", text(folder.path())]);
    refuse(&mut resuming(&folder.path().join("none")), &["is not a folder", "none"]);
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_one_before_it_goes_on() {
    let out = killed("damaged", 2 * EVERY);
    let steps = checkpoints(&out);
    let [older, newest] = steps[steps.len() - 2..] else { panic!("two are kept: {steps:?}") };
    let path = out.join(format!("checkpoints/step-{newest:08}.safetensors"));
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&path, &bytes).unwrap();
    refuse(&mut resuming(&out), &[text(&path), "damaged", &format!("step {older}")]);
    bytes.truncate(middle);
    fs::write(&path, &bytes).unwrap();
    refuse(&mut resuming(&out), &[text(&path), "damaged"]);
    assert_eq!(checkpoints(&out), steps, "something was lost");
    fs::remove_file(&path).unwrap();
    succeed(&mut resuming(&out));
    assert_as_whole(&out);
}

#[test]
fn a_checkpoint_of_another_version_is_refused() {
    let out = killed("version", EVERY);
    let newest = checkpoints(&out).pop().unwrap();
    let path = out.join(format!("checkpoints/step-{newest:08}.safetensors"));
    let mut state = splat_model::state::State::read(&path).unwrap();
    let _: String = state.told("version").unwrap();
    state.tell("version", &"9.9.9").unwrap();
    state.write(&path).unwrap();
    refuse(&mut resuming(&out), &[text(&path), "splat 9.9.9", "resume with that version"]);
}

#[test]
fn a_capture_that_has_changed_is_refused() {
    let capture = fresh("changed-capture");
    let size = ["--views", "8", "--width", "64", "--height", "48"];
    succeed(splat(&["demo", "--out"]).arg(&capture).args(size));
    let out = fresh("changed");
    let mut child =
        spawn(splat(&["train", "--steps", "60", "--checkpoint-every", "7"]).arg(&capture).arg("--out").arg(&out));
    wait_for(&out, EVERY, &mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    let larger = ["--views", "8", "--width", "80", "--height", "48"];
    fs::remove_dir_all(&capture).unwrap();
    succeed(splat(&["demo", "--out"]).arg(&capture).args(larger));
    refuse(&mut resuming(&out), &["photograph 1", "80 x 48", "64 x 48"]);
}

#[test]
fn a_new_run_does_not_replace_an_unfinished_one() {
    let out = killed("aside", EVERY);
    refuse(&mut training(&out), &["unfinished run", "splat resume", "--out"]);
    succeed(&mut resuming(&out));
    assert_as_whole(&out);
}

/// Other programs keep their state in a folder of that name too.
#[test]
fn checkpoints_of_another_program_stay() {
    let out = fresh("another program's");
    let kept = ["checkpoints/checkpoint.resume", "checkpoints/run1/model.ckpt"];
    let keep = || {
        for name in kept {
            fs::create_dir_all(out.join(name).parent().unwrap()).unwrap();
            fs::write(out.join(name), "a week of work").unwrap();
        }
    };
    let kept_all =
        || kept.iter().all(|name| fs::read_to_string(out.join(name)).is_ok_and(|text| text == "a week of work"));
    keep();
    succeed(&mut training(&out));
    assert!(kept_all() && checkpoints(&out).is_empty(), "{:?}", files(&out));
    assert!(fs::read_dir(out.join("checkpoints")).unwrap().count() == 2);
    // A file with the name of a checkpoint would be replaced by one.
    let taken = out.join("checkpoints/step-00000000.safetensors");
    fs::write(&taken, "tensors of another program").unwrap();
    refuse(&mut training(&out), &["step-00000000.safetensors", "none of this program", "--out"]);
    assert_eq!(fs::read_to_string(&taken).unwrap(), "tensors of another program");
}

#[test]
fn two_runs_do_not_share_a_folder() {
    let out = fresh("shared");
    // Longer than the other one takes to begin.
    let mut long = splat(&["train", "--steps", "100000", "--max-side", "64"]);
    let mut child = spawn(long.arg(DEMO.as_path()).arg("--out").arg(&out));
    wait_for(&out, 0, &mut child);
    refuse(&mut training(&out), &["another `splat train`", text(&out)]);
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Returns a command that cannot write files of more than `blocks` blocks of 512 bytes, as on a full disk.
#[cfg(unix)]
fn with_little_room(command: &Command, blocks: usize) -> Command {
    let mut limited = Command::new("sh");
    limited.args(["-c", &format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$@\""), "sh"]);
    limited.arg(command.get_program()).args(command.get_args());
    limited
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_found_before_the_first_step() {
    let out = fresh("full");
    refuse(&mut with_little_room(&training(&out), 1), &["checkpoints", "room left"]);
    assert!(checkpoints(&out).is_empty());
}

#[cfg(unix)]
#[test]
fn a_disk_that_fills_up_loses_nothing() {
    let out = killed("filled", EVERY);
    let before = checkpoints(&out);
    let kept = |out: &Path| before.iter().all(|step| checkpoints(out).contains(step));
    let ended = end(&mut with_little_room(&resuming(&out), 1));
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(ended.stderr.contains("no checkpoint could be written"), "{}", ended.stderr);
    assert!(ended.stderr.contains("scene.ply"), "{}", ended.stderr);
    assert!(!ended.stderr.contains("panicked") && kept(&out), "{}", ended.stderr);
    succeed(&mut resuming(&out));
    assert_as_whole(&out);
}

#[test]
fn a_file_in_the_way_is_named() {
    let out = fresh("in-the-way");
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("checkpoints"), "").unwrap();
    refuse(&mut training(&out), &["checkpoints", "is a file"]);
}
