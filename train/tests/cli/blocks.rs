//! Captures that are cut into blocks, trained by lines of a shell, and merged.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use splat_model::capture::blocks::{BlockFile, keep};
use splat_model::capture::{Capture, Split};
use splat_model::gaussians::GaussianRows;
use splat_model::ply;

use crate::run::{end, fresh, refuse, splat, succeed};
use crate::{json, text};

/// A town of 48 photographs, 48 × 36 px.
static TOWN: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("a town's capture");
    let size = ["--views", "48", "--width", "48", "--height", "36", "--points", "1500"];
    succeed(splat(&["demo", "--town", "--out"]).arg(&folder).args(size));
    folder
});

/// Options of the training of blocks.
const TRAINING: [&str; 8] = ["--steps", "120", "--checkpoint-every", "10", "--device", "cpu", "--max-splats", "2000"];

fn plan(out: &Path, options: &[&str], training: &[&str]) -> Command {
    let mut command = splat(&["blocks", "plan", text(&TOWN), "--out", text(out)]);
    command.args(options).arg("--").args(training);
    command
}

/// A plan of two blocks.
fn two_blocks(name: &str) -> PathBuf {
    let out = fresh(name);
    succeed(&mut plan(&out, &["--blocks", "2"], &TRAINING));
    out
}

fn status(plan: &Path) -> String {
    succeed(&mut splat(&["blocks", "status", text(plan)])).stdout
}

fn scene(plan: &Path, block: usize) -> Vec<u8> {
    fs::read(plan.join(format!("block-{block}/run/scene.ply"))).unwrap()
}

/// A plan whose blocks were trained one after the other.
static IN_TURN: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = two_blocks("blocks in turn");
    let ended = end(Command::new("sh").arg(out.join("jobs.txt")));
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    out
});

#[test]
fn a_plan_is_trained_line_by_line_and_merged() {
    let out = IN_TURN.as_path();
    assert_eq!(status(out).lines().filter(|line| line.contains("finished")).count(), 3);
    // Lines that are run again leave the results as they are.
    let before = fs::metadata(out.join("block-0/run/scene.ply")).unwrap().modified().unwrap();
    let again = end(Command::new("sh").arg(out.join("jobs.txt")));
    assert_eq!((again.code, again.stderr.matches("is finished").count()), (Some(0), 2), "{}", again.stderr);
    assert_eq!(fs::metadata(out.join("block-0/run/scene.ply")).unwrap().modified().unwrap(), before);

    let merged = out.join("merged.ply");
    let said = succeed(&mut splat(&["blocks", "merge", text(out), "--out", text(&merged)])).stdout;
    assert!(said.contains("merged.ply"), "{said}");
    let (rows, origin) = ply::read(&merged).unwrap();
    let mut expected = 0;
    for block in 0..2 {
        let folder = out.join(format!("block-{block}"));
        let (cell, (own, own_origin)) =
            (BlockFile::read(&folder).unwrap().cell, ply::read(&folder.join("run/scene.ply")).unwrap());
        assert_eq!(own_origin, origin);
        let mut kept = GaussianRows { sh_degree: own.sh_degree, ..GaussianRows::default() };
        keep(&cell, &own, &mut kept);
        assert!(kept.len() > own.len() / 2 && kept.len() < own.len(), "{} of {}", kept.len(), own.len());
        assert_eq!(rows.means[expected..][..kept.len()], kept.means);
        assert_eq!(rows.logit_opacities[expected..][..kept.len()], kept.logit_opacities);
        expected += kept.len();
    }
    assert_eq!(rows.len(), expected);

    let scores = out.join("scores");
    let eval = ["eval", text(&TOWN), "--scene", text(&merged), "--out", text(&scores)];
    succeed(&mut splat(&eval));
    let psnr = |path: PathBuf| json(&path)["test"]["psnr"].as_f64().unwrap();
    let merged = psnr(scores.join("metrics.json"));
    // One run of the whole with as many splats, and with what the plan decided for the blocks.
    let whole = out.join("whole");
    let plan = json(&out.join("plan.json"));
    let common = plan["options"].as_array().unwrap().iter().map(|option| option.as_str().unwrap());
    let mut train = splat(&["train", text(&TOWN), "--out", text(&whole), "--device", "cpu"]);
    let common = common.filter(|option| !option.starts_with("--max-splats") && !option.starts_with("--device"));
    train.args(common.filter(|option| *option != "cpu")).args(["--max-splats", &rows.len().to_string()]);
    succeed(&mut train);
    let whole = psnr(whole.join("metrics.json"));
    println!("merged: {merged:.2} dB, the whole: {whole:.2} dB");
    assert!(merged > whole - 0.1, "{merged} dB merged, {whole} dB as a whole");
}

/// The plan trains one scene, of the whole and with few splats, and all lines name it. A run that starts from a scene shows it at once.
#[test]
fn blocks_start_from_a_coarse_scene_of_the_whole() {
    let coarse = IN_TURN.canonicalize().unwrap().join("coarse");
    let (scene, scored) = (coarse.join("scene.ply"), json(&coarse.join("metrics.json")));
    // At most a fifth of a block's 1,300 splats (every sixth of 1,500 points), half of its steps, half of the photographs' size but no
    // less than 32 px.
    assert_eq!((scored["splats"].as_u64(), scored["steps"].as_u64()), (Some(250), Some(60)));
    assert_eq!(scored["options"]["max_side"], 32);
    let capture = Capture::load(&TOWN).unwrap();
    assert_eq!(scored["test"]["views"].as_array().unwrap().len(), Split::of(&capture, None).test.len());
    assert_eq!(json(&IN_TURN.join("block-1/run/metrics.json"))["options"]["start"], text(&scene));

    let after_one_step = |start: &[&str]| {
        let out = fresh("one step");
        let run = ["train", text(&TOWN), "--out", text(&out), "--steps", "1", "--device", "cpu", "--effects", "none"];
        succeed(splat(&run).args(start));
        json(&out.join("metrics.json"))["test"]["psnr"].as_f64().unwrap()
    };
    let block = IN_TURN.join("block-0/run/scene.ply");
    let [from_points, from_scene] = [after_one_step(&[]), after_one_step(&["--start", text(&block)])];
    assert!(from_scene > from_points + 0.5, "{from_scene} dB from a scene, {from_points} dB from points");

    let refused = |options: &[&str], parts: &[&str]| {
        let out = fresh("no start");
        refuse(splat(&["train", text(&TOWN), "--out", text(&out), "--steps", "1"]).args(options), parts);
    };
    refused(&["--start", "nowhere.ply"], &["nowhere.ply", "--start"]);
    refused(&["--start", text(&block), "--max-splats", "100"], &["scene.ply", "`--max-splats` is 100", "--start"]);
}

#[test]
fn held_out_photographs_are_held_out_of_every_block() {
    let capture = Capture::load(&TOWN).unwrap();
    let split = Split::of(&capture, None);
    let names = |views: &[usize]| views.iter().map(|&view| capture.views[view].name.clone()).collect::<Vec<_>>();
    let (train, test) = (names(&split.train), names(&split.test));
    for block in ["block-0", "block-1"] {
        let file = BlockFile::read(&IN_TURN.join(block)).unwrap();
        assert!(file.train.iter().all(|name| train.contains(name)) && file.test.iter().all(|name| test.contains(name)));
        let scored = json(&IN_TURN.join(block).join("run/metrics.json"));
        assert_eq!(scored["test"]["views"].as_array().unwrap().len(), file.test.len());
        assert!(scored["splats"].as_u64().unwrap() <= 1_300);
    }
}

/// Kills the training of a block, which only Linux tells by its command line.
fn kill_training_of(block: &Path) -> bool {
    for entry in fs::read_dir("/proc").unwrap().flatten() {
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let mut words = line.split(|byte| *byte == 0);
        let program = words.next() == Some(env!("CARGO_BIN_EXE_splat").as_bytes());
        if program && words.any(|word| word == text(block).as_bytes()) {
            let id = entry.file_name();
            return Command::new("kill").arg("-9").arg(id).status().unwrap().success();
        }
    }
    false
}

/// Two blocks side by side end with the bits of one after the other, also where one was killed in the middle and its line was run
/// again.
#[test]
fn blocks_run_under_gnu_parallel_and_survive_a_kill() {
    let required = std::env::var("SPLAT_PARALLEL").is_ok_and(|value| value == "require");
    let there = Command::new("parallel").arg("--version").output().is_ok_and(|output| output.status.success());
    if !there || !cfg!(target_os = "linux") {
        assert!(!required, "SPLAT_PARALLEL=require, but there is no GNU parallel");
        // Written past the test harness, which swallows the output of passing tests.
        let line = b"SKIPPED: no GNU parallel on the path (SPLAT_PARALLEL=require makes that a failure)\n";
        let _ = std::io::stderr().write_all(line);
        return;
    }
    let out = two_blocks("blocks side by side");
    let parallel = || {
        let mut command = Command::new("parallel");
        command.args(["--will-cite", "--jobs", "2"]).stdin(fs::File::open(out.join("jobs.txt")).unwrap());
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let mut running = parallel().spawn().unwrap();
    let start = Instant::now();
    let killed = out.join("block-1/run").canonicalize().unwrap();
    let begun = || fs::read_dir(killed.join("checkpoints")).is_ok_and(|entries| entries.count() > 1);
    while !begun() {
        assert!(start.elapsed() < Duration::from_secs(120) && running.try_wait().unwrap().is_none(), "no checkpoint");
        std::thread::sleep(Duration::from_millis(5));
    }
    let shown = status(&out);
    assert!(shown.lines().any(|line| line.starts_with("block-1") && line.contains("training")), "{shown}");
    assert!(kill_training_of(&killed), "the training of block-1 was not found");
    // GNU parallel ends with the number of lines that failed.
    assert_eq!(running.wait().unwrap().code(), Some(1));
    let shown = status(&out);
    assert!(shown.lines().any(|line| line.starts_with("block-1") && line.contains("stopped")), "{shown}");
    assert!(shown.lines().any(|line| line.starts_with("block-0") && line.contains("finished")), "{shown}");
    let merged = out.join("merged.ply");
    let merge = ["blocks", "merge", text(&out), "--out", text(&merged)];
    refuse(&mut splat(&merge), &["1 of 2 blocks", "(block-1)", "jobs.txt"]);

    assert!(parallel().status().unwrap().success());
    for block in 0..2 {
        assert!(scene(&out, block) == scene(&IN_TURN, block), "block {block} is another scene");
    }
}

#[test]
fn plans_that_cannot_be_are_refused() {
    let refused = |options: &[&str], training: &[&str], parts: &[&str]| {
        let out = fresh("no plan");
        refuse(&mut plan(&out, options, training), parts);
        assert!(!out.exists(), "{options:?} {training:?} left a folder");
    };
    refused(&["--blocks", "9000"], &[], &["9000 blocks", "plan fewer"]);
    refused(&["--blocks", "2"], &["--steps", "0"], &["--steps"]);
    refused(&["--blocks", "2"], &["--strategy", "mcmc"], &["mcmc", "another strategy"]);
    refused(&["--blocks", "2"], &["--background", "environment"], &["background"]);
    refused(&["--blocks", "2"], &["--out", "there"], &["--out"]);
    refused(&["--blocks", "2"], &["--no-such"], &["--no-such"]);
    assert_eq!(end(&mut plan(Path::new("x"), &[], &[])).code, Some(2), "how many blocks?");
    refuse(&mut plan(&IN_TURN, &["--blocks", "2"], &[]), &["already exists"]);
    let block = IN_TURN.join("block-0");
    let nested = ["blocks", "plan", text(&block), "--out", "x", "--blocks", "2"];
    refuse(&mut splat(&nested), &["is a block already"]);
    refuse(&mut splat(&["blocks", "status", text(&TOWN)]), &["plan.json", "splat blocks plan"]);
}

#[test]
fn the_splats_of_a_block_decide_the_number_of_blocks() {
    let out = fresh("blocks of a size");
    let options = ["--splats-per-block", "900", "--coarse-steps", "0"];
    let said = succeed(&mut plan(&out, &options, &TRAINING)).stdout;
    assert!(said.contains("each block may have 900 splats"), "{said}");
    // 1.3 times 2,000 splats in blocks of 900.
    let jobs = fs::read_to_string(out.join("jobs.txt")).unwrap();
    assert_eq!(jobs.lines().count(), 3);
    for (block, line) in jobs.lines().enumerate() {
        let run = out.canonicalize().unwrap().join(format!("block-{block}/run"));
        assert!(line.contains(&format!(" resume '{}'", text(&run))), "{line}");
        let options = fs::read_to_string(run.join("run.toml")).unwrap();
        assert!(options.contains("\nmax_splats = 900\n") && !options.contains("start ="), "{options}");
    }
    assert!(!out.join("coarse").exists());
    assert_eq!(status(&out).matches("waiting").count(), 3);
}
