//! Tests that disabled effects leave no trace in the shaders of a plain training step, letter for letter. An effect in a kernel
//! is a compile-time argument of the kernel, and must not change the kernel of a scene without the effect. After an intended
//! change of a plain kernel, this command rewrites the record:
//!
//! ```text
//! SPLAT_KERNELS=accept cargo test --release --workspace --test plain_kernels
//! ```

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use burn::tensor::Device;
use sha2::{Digest, Sha256};
use splat_tests::data::announce;
use splat_tests::places;
use splat_tests::slope::slope_trainer;

const RECORD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/plain_kernels.tsv");

/// Longest time that the thread of the log may take to write it.
const PATIENCE: Duration = Duration::from_secs(60);

/// Returns the driver in software of the record. Kernels depend on the features that a device supports.
fn software() -> Option<Device> {
    places().into_iter().find(|place| place.name == "gpu" && place.software).map(|place| place.device)
}

/// Returns the shaders of this project, each as the kernel's name and the digest of its text. The text is taken without the digest
/// in its function name, which CubeCL derives from the compile-time arguments and their names.
fn kernels(log: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in log.split("[START_KERNEL_COMPILATION]").skip(1) {
        let Some((head, rest)) = entry.split_once("```wgsl\n") else { continue };
        let (Some((text, _)), Some(name)) =
            (rest.split_once("\n```"), head.lines().find_map(|l| l.strip_prefix("name: ")))
        else {
            continue;
        };
        let Some(name) = name.strip_prefix("splat_op::").map(|name| name.split('<').next().unwrap_or(name)) else {
            continue;
        };
        let text: Vec<&str> =
            text.lines().map(|line| if line.starts_with("fn ") { signature(line) } else { line }).collect();
        let digest = Sha256::digest(text.join("\n"));
        let digest: String = digest[..8].iter().map(|byte| format!("{byte:02x}")).collect();
        found.insert(format!("{name}\t{digest}"));
    }
    found
}

/// Returns a function's line from its arguments on.
fn signature(line: &str) -> &str {
    line.find('(').map_or(line, |at| &line[at..])
}

/// Trains in a separate process and returns its log, because CubeCL reads its settings once per process.
fn log_of_a_run(file: &Path) -> String {
    let status = Command::new(env::current_exe().expect("a test has a file"))
        .args(["--exact", "a_run_whose_kernels_are_logged", "--ignored", "--quiet"])
        .env("CUBECL_DEBUG_LOG", file)
        .status()
        .expect("a test can run itself");
    assert!(status.success(), "{status}");
    fs::read_to_string(file).expect("CubeCL writes its log")
}

#[test]
#[ignore = "run by the other test, in a process of its own"]
fn a_run_whose_kernels_are_logged() {
    // A run of all ignored tests has no file to log to.
    let (Some(device), Some(file)) = (software(), env::var_os("CUBECL_DEBUG_LOG").map(PathBuf::from)) else { return };
    let mut run = slope_trainer(&device);
    for _ in 0..6 {
        run.step().expect("a sound run").loss.into_scalar::<f32>();
    }
    let (start, mut before) = (Instant::now(), None);
    while start.elapsed() < PATIENCE {
        thread::sleep(Duration::from_millis(500));
        let size = fs::metadata(&file).map(|file| file.len()).ok();
        if size.is_some() && size == before {
            return;
        }
        before = size;
    }
}

#[test]
fn a_plain_step_compiles_the_kernels_it_always_did() {
    if software().is_none() {
        announce("SKIPPED: the kernels of a plain step: they were recorded on a driver in software");
        return;
    }
    let folder = tempfile::tempdir().expect("a place for a log");
    let log = log_of_a_run(&folder.path().join("kernels.log"));
    // Many units write whether their pixel is open, and all read it before a barrier.
    let forward = log.split("[START_KERNEL_COMPILATION]").find(|entry| entry.contains("rasterize_forward_kernel_"));
    assert!(forward.is_some_and(|text| text.contains("workgroupUniformLoad(")), "a race for the flag of open pixels");
    let found = kernels(&log);
    assert!(
        found.iter().any(|line| line.starts_with("stages::rasterize::")) && found.len() > 20,
        "not the log of a step: {found:#?}"
    );
    if env::var("SPLAT_KERNELS").is_ok_and(|wish| wish == "accept") {
        let lines: Vec<&str> = found.iter().map(String::as_str).collect();
        fs::write(RECORD, lines.join("\n") + "\n").expect("the record can be written");
        return;
    }
    let record = fs::read_to_string(RECORD).expect("the record is committed");
    let recorded: BTreeSet<String> = record.lines().map(str::to_owned).collect();
    let (missing, new): (Vec<_>, Vec<_>) =
        (recorded.difference(&found).collect(), found.difference(&recorded).collect());
    assert!(
        missing.is_empty() && new.is_empty(),
        "new kernels of a plain step: {new:#?}, missing kernels: {missing:#?}. If a plain kernel was meant to change: \
         SPLAT_KERNELS=accept cargo test --release --workspace --test plain_kernels"
    );
}

#[test]
fn a_letter_of_a_kernel_changes_its_line() {
    let log = |body: &str, hash: &str| {
        format!(
            "[START_KERNEL_COMPILATION]\nname: splat_op::a::b_kernel::B<f32>\nsource:\n```wgsl\nfn b_{hash}(v: u32) \
             {{\n{body}\n}}\n```\n[END_KERNEL_COMPILATION]\n"
        )
    };
    let one = kernels(&log("let x = 1;", "aa"));
    assert_eq!(one.len(), 1);
    assert!(one.iter().all(|line| line.starts_with("a::b_kernel::B\t")));
    assert_eq!(one, kernels(&log("let x = 1;", "bb")));
    assert_ne!(one, kernels(&log("let x = 2;", "aa")));
    assert!(kernels("[START_KERNEL_COMPILATION]\nname: burn::x\n```wgsl\nfn x()\n```").is_empty());
}
