//! `splat convert`, and scenes of every format in the other commands.

use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;
use splat_model::formats::{self, Format, SceneFile};
use splat_model::gaussians::GaussianRows;
use splat_model::ply;
use tempfile::TempDir;

use crate::browser::{BrowserPage, look};
use crate::run::{DEMO, TRAINED, end, fresh, refuse, splat, succeed};
use crate::view::Serving;
use crate::{TEST_VIEW, files, json, text};

const COMPRESSED: [Format; 2] = [Format::Spz, Format::Sog];

fn trained() -> PathBuf {
    TRAINED.join("scene.ply")
}

/// The trained scene in another format, and the program's output.
fn converted(folder: &TempDir, format: Format) -> (PathBuf, String) {
    let path = folder.path().join(format!("converted{}", format.extension()));
    let said = succeed(&mut splat(&["convert", text(&trained()), text(&path)]));
    assert_eq!(said.stderr, "");
    (path, said.stdout)
}

#[test]
fn converting_says_what_it_loses() {
    let folder = tempfile::tempdir().unwrap();
    let splats = formats::read(&trained()).unwrap().0.rows.len();
    for format in COMPRESSED {
        let (path, said) = converted(&folder, format);
        assert_eq!(formats::read(&path).unwrap().1, format);
        for part in [text(&trained()), text(&path), &format!("{splats} splats"), "lost:", "position", "scale", "RMS"] {
            assert!(said.contains(part), "{part}: {said}");
        }
        let bytes = |path: &Path| fs::metadata(path).unwrap().len();
        assert!(said.contains(&format!(" {} bytes", bytes(&path))), "{said}");
        assert!(3 * bytes(&path) < bytes(&trained()), "{said}");
        // Values that are rounded already are stored unchanged.
        let back = folder.path().join("back.ply");
        let said = succeed(&mut splat(&["convert", text(&path), text(&back)])).stdout;
        assert!(said.ends_with("nothing is lost\n"), "{said}");
        assert_eq!(formats::read(&back).unwrap().0.rows, formats::read(&path).unwrap().0.rows);
    }
    // No temporary files.
    assert_eq!(files(folder.path()).len(), 3);
}

/// glTF stores floats, and is not read.
#[test]
fn gltf_is_written_and_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    let said = succeed(&mut splat(&["convert", text(&trained()), text(&path)])).stdout;
    assert!(said.contains("glTF, ") && said.ends_with("nothing is lost\n"), "{said}");
    let back = folder.path().join("back.ply");
    refuse(
        &mut splat(&["convert", text(&path), text(&back)]),
        &["scene.glb", "written here and not read", "splat-transform"],
    );
    assert!(!back.exists());
}

#[test]
fn spz_has_the_version_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.spz");
    for (version, begin) in [("3", &[0x1f, 0x8b][..]), ("4", b"NGSP")] {
        succeed(&mut splat(&["convert", text(&trained()), text(&path), "--spz-version", version]));
        assert!(fs::read(&path).unwrap().starts_with(begin), "{version}");
    }
    let other = folder.path().join("scene.sog");
    succeed(&mut splat(&["convert", text(&trained()), text(&other), "--sh-palette", "1"]));
    refuse(&mut splat(&["convert", text(&path), text(&other), "--spz-version", "3"]), &["`--spz-version` is for SPZ"]);
    refuse(
        &mut splat(&["convert", text(&other), text(&path), "--sh-palette", "9"]),
        &["`--sh-palette` is for SOG", ".sog"],
    );
    assert_eq!(end(&mut splat(&["convert", text(&path), text(&other), "--spz-version", "2"])).code, Some(2));
}

#[test]
fn what_has_no_place_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut rows = formats::read(&trained()).unwrap().0.rows;
    rows.means[3][0] = f32::NAN;
    rows.sh_degree = 4;
    rows.sh_rest = vec![0.1; 72 * rows.len()];
    let scene = SceneFile { rows, origin: [1e6, 2.5, 0.0].into(), metres_per_unit: Some(0.25), ..SceneFile::default() };
    formats::write(&path("a.ply"), &scene, Format::Ply).unwrap();
    let convert = |from: &str, to: &str, more: &[&str]| {
        succeed(splat(&["convert", text(&path(from)), text(&path(to))]).args(more)).stdout
    };
    let said = convert("a.ply", "a.sog", &["--antialias"]);
    for part in ["1 splats that cannot be rendered", "above degree 3"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("origin") && !said.contains("size of a unit"), "{said}");
    assert_eq!(formats::read(&path("a.sog")).unwrap().0.metres_per_unit, Some(0.25));
    let said = convert("a.ply", "a.spz", &["--antialias", "--sh-degree", "2"]);
    for part in
        ["1 splats that cannot be rendered", "the origin 1000000 2.5 0", "the size of a unit, 0.25 m", "above degree 2"]
    {
        assert!(said.contains(part), "{part}: {said}");
    }
    let spz = formats::read(&path("a.spz")).unwrap().0;
    assert!(spz.trained.antialias && spz.rows.sh_degree == 2);
    let said = convert("a.spz", "b.ply", &[]);
    assert!(said.contains("nothing is lost") && formats::read(&path("b.ply")).unwrap().0.trained.antialias, "{said}");
    // Scales too small for eight bits of a logarithm.
    let mut fine: GaussianRows = spz.rows;
    fine.log_scales[0] = [-14.0; 3];
    formats::write(&path("fine.ply"), &SceneFile { rows: fine, ..SceneFile::default() }, Format::Ply).unwrap();
    let said = convert("fine.ply", "fine.spz", &[]);
    assert!(said.contains("0.000045 to 379"), "{said}");
}

#[test]
fn bits_of_harmonics_are_for_spz() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut scene = formats::read(&trained()).unwrap().0;
    for (i, harmonic) in scene.rows.sh_rest.iter_mut().enumerate() {
        *harmonic = 0.8 * (i as f32).sin();
    }
    let from = path("scene.ply");
    formats::write(&from, &scene, Format::Ply).unwrap();
    let convert =
        |out: &Path, more: &[&str]| succeed(&mut splat(&[&["convert", text(&from), text(out)], more].concat()));
    convert(&path("few.spz"), &[]);
    convert(&path("more.spz"), &["--sh-bits", "8"]);
    let rows = |name: &str| formats::read(&path(name)).unwrap().0.rows;
    let worst = |name: &str| {
        let pairs = rows(name).sh_rest.into_iter().zip(&scene.rows.sh_rest);
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(worst("more.spz") <= 0.5 / 128.0 + 1e-6, "{}", worst("more.spz"));
    assert!(worst("few.spz") > 2.0 * worst("more.spz"), "{} and {}", worst("few.spz"), worst("more.spz"));
    let sog = path("scene.sog");
    let told = ["`--sh-bits` is for SPZ", "SOG"];
    refuse(&mut splat(&["convert", text(&from), text(&sog), "--sh-bits", "8"]), &told);
    assert!(!sog.exists());
}

#[test]
fn names_tell_formats_and_an_option_does() {
    let folder = tempfile::tempdir().unwrap();
    let scene = trained();
    let odd = folder.path().join("below/scene.bin");
    refuse(&mut splat(&["convert", text(&scene), text(&odd)]), &[text(&odd), ".spz", "--format"]);
    let compressed = folder.path().join("below/scene.compressed.ply");
    let told = [text(&compressed), "compressed PLY is read, not written", ".sog"];
    refuse(&mut splat(&["convert", text(&scene), text(&compressed)]), &told);
    assert!(!odd.parent().unwrap().exists());
    let names = ["ply", "spz", "glb", "sog"];
    for (name, format) in names.into_iter().zip(Format::WRITTEN) {
        succeed(&mut splat(&["convert", text(&scene), text(&odd), "--format", name]));
        assert_eq!(
            formats::read(&odd).ok().map(|(_, format)| format),
            Some(format).filter(|format| Format::READ.contains(format))
        );
    }
    assert_eq!(end(&mut splat(&["convert", text(&scene), text(&odd), "--format", "splat"])).code, Some(2));
    assert_eq!(end(&mut splat(&["convert", text(&scene), "a.spz", "--sh-degree", "5"])).code, Some(2));
}

#[test]
fn what_cannot_be_converted_is_said_and_nothing_is_harmed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (good, out) = (path("good.spz"), path("out.spz"));
    succeed(&mut splat(&["convert", text(&trained()), text(&good)]));
    let bytes = fs::read(&good).unwrap();
    refuse(&mut splat(&["convert", text(&good), text(&good)]), &[text(&good), "is an input of this command"]);
    refuse(&mut splat(&["convert", text(&path("none.ply")), text(&good)]), &["none.ply", "is the path right"]);
    fs::write(path("half.spz"), &bytes[..bytes.len() / 2]).unwrap();
    refuse(&mut splat(&["convert", text(&path("half.spz")), text(&good)]), &["half.spz", "export it again"]);
    fs::write(path("none.bin"), "{}").unwrap();
    refuse(&mut splat(&["convert", text(&path("none.bin")), text(&good)]), &["none.bin", "not a scene", "SPZ"]);
    assert_eq!(fs::read(&good).unwrap(), bytes);
    fs::create_dir(&out).unwrap();
    refuse(&mut splat(&["convert", text(&good), text(&out)]), &[text(&out)]);
    refuse(&mut splat(&["convert", text(&good), text(&good.join("below.spz"))]), &["below.spz"]);
}

#[test]
fn every_command_takes_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let eval = |scene: &Path, name: &str| {
        let out = folder.path().join(name);
        let said = succeed(&mut splat(&["eval", text(&DEMO), "--scene", text(scene), "--out", text(&out)])).stdout;
        assert!(said.contains(text(scene)), "{said}");
        json(&out.join("metrics.json"))["test"]["psnr"].as_f64().unwrap()
    };
    let before = eval(&trained(), "before");
    for format in COMPRESSED {
        let (path, _) = converted(&folder, format);
        let after = eval(&path, format.extension());
        assert!((before - after).abs() < 0.3, "{format}: {before} dB became {after} dB");
        let pictures = folder.path().join("pictures");
        let render =
            ["render", "--scene", text(&path), "--capture", text(&DEMO), "--view", TEST_VIEW, "--device", "cpu"];
        succeed(splat(&render).args(["--out", text(&pictures)]));
        let serving = Serving::start(&[text(&path)]);
        assert!(
            String::from_utf8_lossy(&serving.ask("GET", "/"))
                .contains(&format!("<title>converted{}", format.extension()))
        );
    }
}

#[test]
fn a_mark_of_antialiasing_is_obeyed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("marked.spz");
    succeed(&mut splat(&["convert", text(&trained()), text(&path), "--antialias"]));
    let out = folder.path().join("out");
    let render = ["render", "--scene", text(&path), "--capture", text(&DEMO), "--view", TEST_VIEW, "--device", "cpu"];
    let picture = |more: &[&str]| {
        succeed(splat(&render).args(["--out", text(&out)]).args(more));
        fs::read(out.join(TEST_VIEW)).unwrap()
    };
    let marked = picture(&[]);
    assert!(marked == picture(&["--antialias"]) && marked != picture(&["--antialias=false"]));
}

/// A page that opens a file with Spark's own readers and writes the result where [`look`] finds it.
fn reading_page(bytes: &[u8], kind: &str) -> String {
    let library = include_str!("../../assets/viewer/library.js");
    let data = STANDARD.encode(bytes);
    format!(
        "<!DOCTYPE html><meta charset=\"utf-8\"><p id=\"viewer-note\"></p><script>{library}</script><script>
        (async () => {{
          const note = document.getElementById('viewer-note');
          let state = 'drawn';
          try {{
            const fileBytes = Uint8Array.from(atob('{data}'), (c) => c.charCodeAt(0));
            const mesh = new SplatLibrary.SplatMesh({{ fileBytes, fileType: '{kind}', extSplats: true }});
            await mesh.initialized;
            const rows = [];
            mesh.forEachSplat((i, c, s, q, o, rgb) => rows.push(
              [c.x, c.y, c.z, s.x, s.y, s.z, q.w, q.x, q.y, q.z, o, rgb.r, rgb.g, rgb.b]));
            note.textContent = JSON.stringify(rows);
          }} catch (error) {{ state = 'failed'; note.textContent = String(error); }}
          document.documentElement.dataset.viewer = state;
        }})();
        </script>"
    )
}

/// Spark, the viewer of most web pages with splats, reads every value of every splat in our files.
#[test]
fn browsers_read_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let kinds = [(Format::Ply, "ply"), (Format::Spz, "spz"), (Format::Sog, "pcsogszip")];
    for (format, kind) in kinds {
        let (path, _) = converted(&folder, format);
        if format == Format::Spz {
            // Spark 2.2 does not read version 4.
            succeed(&mut splat(&["convert", text(&trained()), text(&path), "--spz-version", "3"]));
        }
        let rows = formats::read(&path).unwrap().0.rows;
        let name = format!("reading-{}", &format.extension()[1..]);
        let page = fresh(&format!("{name}-page")).with_extension("html");
        fs::create_dir_all(page.parent().unwrap()).unwrap();
        fs::write(&page, reading_page(&fs::read(&path).unwrap(), kind)).unwrap();
        let Some(seen) = look(&name, BrowserPage::File(page), "") else { return };
        let note = seen.state["note"].as_str().unwrap_or_default();
        assert_eq!(seen.state["viewer"], "drawn", "{format}: {note} {:?}", seen.console);
        let theirs: Vec<[f64; 14]> = serde_json::from_str::<Value>(note)
            .and_then(serde_json::from_value)
            .unwrap_or_else(|error| panic!("{format}: {error}: {}", &note[..note.len().min(200)]));
        assert_eq!(theirs.len(), rows.len(), "{format}");
        assert_read(format, &rows, &theirs);
    }
}

/// Spark keeps positions of SPZ in the frame of the file, right-up-back, and positions of PLY unchanged.
fn assert_read(format: Format, rows: &GaussianRows, theirs: &[[f64; 14]]) {
    let signs = if format == Format::Spz { [1.0, -1.0, -1.0] } else { [1.0; 3] };
    for (i, row) in theirs.iter().enumerate() {
        let near = |what: &str, found: f64, expected: f64, within: f64| {
            assert!(
                (found - expected).abs() <= within,
                "{format}, {what} of splat {i}: {found}, expected {expected}\n{row:?}"
            );
        };
        let unit = |q: [f64; 4]| {
            let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            q.map(|x| x / length)
        };
        let [w, x, y, z] = unit(rows.rotations[i].map(f64::from));
        let turned = [w, signs[0] * x, signs[1] * y, signs[2] * z];
        let theirs = unit([row[6], row[7], row[8], row[9]]);
        let cosine = turned.iter().zip(theirs).map(|(a, b)| a * b).sum::<f64>().abs();
        near("the rotation", cosine, 1.0, 1e-4);
        for axis in 0..3 {
            let mean = signs[axis] * f64::from(rows.means[i][axis]);
            near("the position", row[axis], mean, 1e-3 * mean.abs().max(0.01));
            let scale = f64::from(rows.log_scales[i][axis]).exp();
            near("the scale", row[3 + axis], scale, 0.01 * scale);
            let colour = 0.5 + 0.28209479 * f64::from(rows.sh_dc[i][axis]);
            near("the colour", row[11 + axis], colour, 0.003 * colour.abs().max(1.0));
        }
        let opacity = (1.0 + f64::from(-rows.logit_opacities[i]).exp()).recip();
        near("the opacity", row[10], opacity, 0.003);
    }
}

#[test]
fn a_scene_of_which_nothing_is_left_replaces_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut rows = formats::read(&trained()).unwrap().0.rows;
    rows.rotations.fill([0.0; 4]);
    let (count, mut file) = (rows.len(), Vec::new());
    ply::write_to(&mut file, &rows, glam::DVec3::ZERO).unwrap();
    fs::write(path("nothing.ply"), &file).unwrap();
    for format in Format::WRITTEN {
        let out = path(&format!("out{}", format.extension()));
        fs::write(&out, "precious").unwrap();
        let all = format!("{count} of {count} cannot be rendered");
        refuse(
            &mut splat(&["convert", text(&path("nothing.ply")), text(&out)]),
            &[text(&out), "no splat is left", &all],
        );
        let cleaned = end(&mut splat(&["clean", text(&path("nothing.ply")), text(&out), "--box=-9,-9,-9,9,9,9"]));
        assert!(cleaned.code == Some(1) && cleaned.stderr.contains("no splat would be left"), "{cleaned:?}");
        assert_eq!(fs::read_to_string(&out).unwrap(), "precious");
    }
    let page = path("out.html");
    fs::write(&page, "precious").unwrap();
    refuse(&mut splat(&["export", text(&path("nothing.ply")), "--html", text(&page)]), &["nothing.ply"]);
    assert_eq!(fs::read_to_string(&page).unwrap(), "precious");
    assert_eq!(files(folder.path()).len(), 2 + Format::WRITTEN.len(), "a temporary file is left");
}

#[test]
fn what_is_done_with_outliers_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut scene = formats::read(&trained()).unwrap().0;
    scene.rows.means[5] = [1e6, 0.0, 0.0];
    formats::write(&path("far.ply"), &scene, Format::Ply).unwrap();
    let said = succeed(&mut splat(&["convert", text(&path("far.ply")), text(&path("far.spz"))])).stdout;
    assert!(said.contains("the distance of 1 splats"), "{said}");
}
