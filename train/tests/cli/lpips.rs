//! `--lpips`: a score with weights, and no number without.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::Value;

use crate::run::{DEMO, TRAIN, TRAINED, fresh, refuse, splat, succeed};
use crate::{files, json, text};

/// AlexNet with meaningless weights: uneven, so that pictures differ, and positive, so that features do not vanish.
static WEIGHTS: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("lpips");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join("alex.safetensors");
    let layers = [(0, 64, 3, 11), (3, 192, 64, 5), (6, 384, 192, 3), (8, 256, 384, 3), (10, 256, 256, 3)];
    let tensors = layers.iter().enumerate().flat_map(|(tap, &(number, out, channels, side))| {
        let name = |what: &str| format!("net.slice{}.{number}.{what}", tap + 1);
        let linear = (format!("lin{tap}.model.1.weight"), vec![1, out, 1, 1]);
        [(name("weight"), vec![out, channels, side, side]), (name("bias"), vec![out]), linear]
    });
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = tensors
        .map(|(name, shape)| {
            let terms: usize = shape[1..].iter().product();
            let value = |i: usize| ((i * 7919 % 101) as f32 - 40.0) / (20.0 * terms as f32);
            let value = |i| if name.starts_with("lin") { 0.1 } else { value(i) };
            let bytes = (0..shape.iter().product()).flat_map(|i: usize| value(i).to_le_bytes()).collect();
            (name, shape, bytes)
        })
        .collect();
    let views =
        tensors.iter().map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    safetensors::serialize_to_file(views, None, &path).unwrap();
    path
});

/// Returns the scores of the trained scene with some options, and the program's output.
fn scores(options: &[&str]) -> (Value, String) {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let arguments = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(folder.path())];
    let ended = succeed(splat(&arguments).args(options));
    (json(&folder.path().join("metrics.json"))["test"].clone(), ended.stdout)
}

#[test]
fn it_is_measured_with_weights() {
    let (scaled, said) = scores(&["--lpips", text(&WEIGHTS)]);
    let lpips = scaled["lpips"].as_f64().unwrap();
    assert!(lpips > 0.0 && lpips < 10.0, "{scaled}");
    assert_eq!(scaled["lpips_net"], "alex");
    assert_eq!((&scaled["lpips_missing"], &scaled["views"][0]["lpips_missing"]), (&Value::Null, &Value::Null));
    assert_eq!(scaled["views"][0]["lpips"], scaled["lpips"]);
    assert!(said.contains(&format!("LPIPS: {lpips:.4} (network alex)")), "{said}");
}

#[test]
fn what_cannot_be_measured_has_a_reason_and_no_number() {
    let (without, said) = scores(&[]);
    let (small, _) = scores(&["--lpips", text(&WEIGHTS), "--shrink", "2"]);
    for (scores, reason) in [(&without, "--lpips"), (&small, "32 x 24 px")] {
        for score in [scores, &scores["views"][0]] {
            assert_eq!(score["lpips"], Value::Null, "{score}");
            assert!(score["lpips_missing"].as_str().unwrap().contains(reason), "{score}");
        }
    }
    assert!(said.contains("LPIPS: not measured: no weights were named (`--lpips FILE`)"), "{said}");
    let page = fs::read_to_string(TRAINED.join("report.html")).unwrap();
    assert!(page.contains("<td class=\"number\">not measured</td>"), "no cell says so");
    assert!(page.contains("LPIPS: not measured: no weights were named"), "nothing says why");
}

#[test]
fn a_run_measures_it_meanwhile_and_at_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let run = ["--json", "--quiet", "--eval-during", "16", "--lpips", text(&WEIGHTS), "--out", text(folder.path())];
    let ended = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(run));
    let lines: Vec<Value> = ended.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of = |event: &str| lines.iter().find(|line| line["event"] == event).unwrap();
    let during = of("evaluation")["lpips"].as_f64().unwrap();
    let metrics = &of("done")["metrics"];
    let after = metrics["test"]["lpips"].as_f64().unwrap();
    assert!(after > 0.0 && (during - after).abs() < 1e-4 * after, "{during} {after}");
    assert_eq!(metrics["options"]["lpips"], text(&WEIGHTS));
    let page = fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(page.contains(&format!("<strong>{after:.4}</strong> LPIPS")), "no tile");
}

#[test]
fn weights_that_are_none_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let weights = folder.path().join("weights.safetensors");
    fs::write(&weights, "weights").unwrap();
    let run = ["--lpips", text(&weights), "--out", text(&out)];
    refuse(splat(&TRAIN).arg(DEMO.as_path()).args(run), &["weights.safetensors", "docs/METRICS.md"]);
    refuse(
        splat(&["train", "--eval-every", "0", "--lpips", text(&WEIGHTS), "--out", text(&out)]).arg(DEMO.as_path()),
        &["--lpips", "--eval-every"],
    );
    assert_eq!(files(folder.path()), ["weights.safetensors".to_owned()].into());
}
