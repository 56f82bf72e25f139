//! `splat mesh`: the surface of a scene.

use std::fs;
use std::path::Path;

use serde_json::Value;
use splat_model::formats::{self, Format, SceneFile};

use crate::run::{DEMO, TRAINED, end, fresh, refuse, splat, succeed};
use crate::{files, text};

/// The document of a .glb.
fn document(path: &Path) -> Value {
    let bytes = fs::read(path).unwrap();
    let end = 20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..end]).unwrap()
}

#[test]
fn a_scene_becomes_a_mesh() {
    let folder = fresh("mesh");
    let (scene, out) = (TRAINED.join("scene.ply"), folder.join("new/mesh.glb"));
    let command = |more: &[&str]| {
        let mut command = splat(&["mesh", text(&scene), "--capture", text(&DEMO), "--out", text(&out)]);
        command.args(more);
        command
    };
    let said = succeed(&mut command(&["--min-component", "50"])).stdout;
    assert!(said.contains("new/mesh.glb: ") && said.contains("triangles, from 8 views"), "{said}");
    let of = |out: &Path| document(out)["accessors"][3]["count"].as_u64().unwrap() / 3;
    let count = of(&out);
    assert!(said.contains(&format!("{count} triangles")) && count > 500, "{said}");
    assert_eq!(files(&folder), ["new/mesh.glb".to_owned()].into(), "nothing else is left");
    let said = succeed(&mut command(&["--voxel", "0.4", "--watertight", "--views", "3", "--max-side", "32"])).stdout;
    assert!(said.contains("from 3 views") && of(&out) < count, "{said}");

    let written = fs::read(&out).unwrap();
    let refused: [(&[&str], &[&str]); 6] = [
        (&["--voxel", "0"], &["scene.ply", "`voxel` is 0"]),
        (&["--voxel", "1e-9"], &["scene.ply", "`voxel` is 0.000000001", "a millionth"]),
        (&["--truncation", "nan"], &["`truncation` is NaN", "at least 2"]),
        (&["--min-component", "99999999"], &["show no surface", "99999999", "`--min-component`"]),
        (&["--out", "mesh.obj"], &["mesh.obj does not end in .glb"]),
        (&["--capture", "nowhere"], &["no capture folder nowhere"]),
    ];
    for (more, told) in refused {
        // The last of an option given twice is an error of its own.
        let mut words = vec!["mesh", text(&scene)];
        for (option, value) in [("--capture", text(&DEMO)), ("--out", text(&out))] {
            if more[0] != option {
                words.extend([option, value]);
            }
        }
        refuse(splat(&words).args(more), told);
    }
    refuse(&mut splat(&["mesh", "none.ply", "--capture", text(&DEMO), "--out", text(&out)]), &["none.ply"]);
    assert!(fs::read(&out).unwrap() == written, "what fails leaves the file as it was");
    for wrong in [["--views", "0"], ["--max-side", "2"], ["--voxel", "small"]] {
        assert_eq!(end(&mut command(&wrong)).code, Some(2), "{wrong:?}");
    }
}

#[test]
fn a_scene_that_no_view_shows_has_no_mesh() {
    let folder = fresh("mesh-of-nothing");
    fs::create_dir_all(&folder).unwrap();
    let (path, out) = (folder.join("one.ply"), folder.join("mesh.glb"));
    let mut rows = formats::read(&TRAINED.join("scene.ply")).unwrap().0.rows.part(0..1);
    rows.means[0] = [0.0, 0.0, 900.0];
    formats::write(&path, &SceneFile { rows, ..SceneFile::default() }, Format::Ply).unwrap();
    let arguments = ["mesh", text(&path), "--capture", text(&DEMO), "--out", text(&out)];
    refuse(&mut splat(&arguments), &["one.ply", "show no surface", "of this capture"]);
    assert!(!out.exists());
}
