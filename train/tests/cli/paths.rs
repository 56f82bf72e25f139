//! `splat render` along a camera path, from a file or from the page of `splat view`, and its passes.

use std::fs;
use std::path::Path;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use image::RgbImage;
use serde_json::{Value, json};
use splat_model::capture::{Capture, View};
use splat_model::gaussians::GaussianRows;
use splat_model::ply;

use crate::browser::{BrowserPage, assert_drawn, look};
use crate::export::setup;
use crate::origin::{FAR, moved_capture};
use crate::run::{DEMO, TRAINED, fresh, refuse, splat, succeed};
use crate::view::Serving;
use crate::{files, text};

/// A camera as nerfstudio's paths have it.
fn camera(view: &View, origin: DVec3) -> Value {
    let mut world_from_cam = view.cam_from_world.inverse();
    world_from_cam.translation += origin;
    let opencv_from_opengl = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    let rows = (DMat4::from(world_from_cam) * opencv_from_opengl).transpose().to_cols_array();
    let lens = view.intrinsics;
    json!({"camera_to_world": rows, "fov": (2.0 * (0.5 * lens.height as f64 / lens.fy).atan()).to_degrees()})
}

/// The scene of [`TRAINED`] with an origin far away, and a capture there.
fn far(folder: &Path) -> [std::path::PathBuf; 2] {
    let [scene, capture] = ["far.ply", "far"].map(|name| folder.join(name));
    moved_capture(&capture, FAR);
    let (rows, _) = ply::read(&TRAINED.join("scene.ply")).unwrap();
    ply::write(&scene, &rows, DVec3::from(FAR)).unwrap();
    [scene, capture]
}

fn picture(path: &Path) -> RgbImage {
    image::open(path).unwrap().into_rgb8()
}

/// The mean difference of two pictures, levels of 255.
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let all = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b)));
    all.sum::<f64>() / a.as_raw().len() as f64
}

#[test]
fn keyframes_at_photographs_show_what_the_photographs_do() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out, views) = (folder.path().join("path.json"), folder.path().join("out"), folder.path().join("views"));
    for [scene, capture] in [[TRAINED.join("scene.ply"), DEMO.to_path_buf()], far(folder.path())] {
        let loaded = Capture::load(&capture).unwrap();
        let keyframes = [2, 4].map(|view| camera(&loaded.views[view], loaded.origin));
        fs::write(&path, json!({ "camera_path": keyframes }).to_string()).unwrap();
        let render = ["render", "--scene", text(&scene), "--capture", text(&capture)];
        succeed(splat(&render).args(["--path", text(&path), "--frames", "3", "--out", text(&out)]));
        assert_eq!(files(&out), ["0000.png", "0001.png", "0002.png"].map(String::from).into());
        succeed(splat(&render).args(["--view", "all", "--out", text(&views)]));
        let [first, middle, last] = [0, 1, 2].map(|i| picture(&out.join(format!("000{i}.png"))));
        let [second, fourth] = [2, 4].map(|i| picture(&views.join(format!("000{i}.png"))));
        for (along, photograph) in [(&first, &second), (&last, &fourth)] {
            let error = difference(along, photograph);
            assert!(error < 0.1 && 20.0 * error < difference(along, &middle), "{error}");
        }
    }
    fs::write(&path, "{\"camera_path\": []}").unwrap();
    let render = ["render", "--scene", "none", "--capture", text(&DEMO), "--out", text(&out)];
    refuse(splat(&render).args(["--path", text(&path)]), &[text(&path), "`camera_path`", "at least 2", "`orbit`"]);
    refuse(splat(&render).args(["--path", "orbits"]), &["cannot read orbits", "`orbit`"]);
}

/// The values of an array `[height, width, 4]` by pixel.
fn values(path: &Path) -> Vec<[f32; 4]> {
    let bytes = fs::read(path).unwrap();
    let array = npyz::NpyFile::new(&bytes[..]).unwrap();
    assert_eq!(array.shape(), [48, 64, 4]);
    array.into_vec().unwrap().as_chunks().0.to_vec()
}

#[test]
fn passes_are_the_depth_and_the_normals_of_what_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ply");
    let view = &Capture::load(&DEMO).unwrap().views[3];
    // A disc that faces the camera 5 units ahead, and one at 45 degrees beside it 3 units ahead.
    let world_from_cam = view.cam_from_world.inverse();
    let discs = [(0.0, 5.0, 0.0), (-1.0, 3.0, std::f64::consts::FRAC_PI_4)].map(|(x, z, turn)| {
        world_from_cam * DAffine3::from_rotation_translation(DQuat::from_rotation_y(turn), DVec3::new(x, 0.0, z))
    });
    let rows = GaussianRows {
        means: discs.map(|disc| disc.translation.as_vec3().to_array()).to_vec(),
        rotations: discs
            .map(|disc| {
                let [x, y, z, w] = DQuat::from_mat3(&disc.matrix3).as_quat().to_array();
                [w, x, y, z]
            })
            .to_vec(),
        log_scales: vec![[-1.0, -1.0, -6.0]; 2],
        logit_opacities: vec![6.0; 2],
        sh_dc: vec![[0.5; 3]; 2],
        sh_rest: Vec::new(),
        sh_degree: 0,
        groups: Vec::new(),
    };
    ply::write(&scene, &rows, DVec3::ZERO).unwrap();
    let out = folder.path();
    let render = |pass: &str, format: &str| {
        let arguments = ["--scene", text(&scene), "--capture", text(&DEMO), "--view", "0003.png", "--format", format];
        succeed(splat(&["render", "--pass", pass, "--out", text(out)]).args(arguments));
        out.join(format!("0003.{format}"))
    };
    let px = |disc: usize| {
        let [x, y, z] = view.cam_from_world.transform_point3(discs[disc].translation).to_array();
        let lens = view.intrinsics;
        let [column, row] = [lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy].map(|px| px as usize);
        assert!(column < 64 && row < 48);
        64 * row + column
    };
    let depth = values(&render("depth", "npy"));
    for (disc, z) in [(0, 5.0), (1, 3.0)] {
        let [r, g, b, alpha] = depth[px(disc)];
        assert!((r - z).abs() < 1e-3 && [g, b] == [r; 2] && alpha > 0.9, "{disc}: {:?}", depth[px(disc)]);
    }
    assert_eq!(depth[0], [0.0; 4], "nothing is in the corner");
    assert_eq!(image::open(render("depth", "exr")).unwrap().into_rgba32f().as_raw(), depth.as_flattened());
    let shown = picture(&render("depth", "png"));
    let level = |disc: usize| f32::from(shown.as_raw()[3 * px(disc)]) / 255.0;
    let mut depths: Vec<f32> = depth.iter().filter(|[.., alpha]| *alpha >= 0.5).map(|[z, ..]| *z).collect();
    depths.sort_by(f32::total_cmp);
    let middle = depths[depths.len() / 2];
    for (disc, z) in [(0, 5.0), (1, 3.0)] {
        let expected = depth[px(disc)][3] * middle / (middle + z);
        assert!((level(disc) - expected).abs() < 0.01, "{disc}: {} instead of {expected}", level(disc));
    }
    assert_eq!(shown.as_raw()[..3], [0; 3]);
    let normals = values(&render("normals", "npy"));
    let levels = picture(&render("normals", "png"));
    for disc in [0, 1] {
        let expected = (-discs[disc].matrix3.z_axis).as_vec3();
        let [x, y, z, _] = normals[px(disc)];
        assert!(glam::Vec3::new(x, y, z).distance(expected) < 1e-3, "{disc}: {x} {y} {z} instead of {expected}");
        for (axis, value) in [x, y, z].into_iter().enumerate() {
            let level = f32::from(levels.as_raw()[3 * px(disc) + axis]);
            assert!((level / 127.5 - 1.0 - value).abs() < 0.01, "{disc}: {level} for {value}");
        }
    }
    assert_eq!((normals[0], &levels.as_raw()[..3]), ([0.0; 4], &[128; 3][..]));
}

/// Adds keyframes before and after the scene comes nearer, and one too many; `page.seen` holds the file, and the buttons on the way.
const KEYFRAMES: &str = r##"
  const view = frame.contentWindow;
  for (let i = 0; i < 1000 && !page.documentElement.dataset.viewer; i++) await wait(100);
  const [add, remove, save] = page.querySelectorAll("#viewer-bar button");
  const label = () => `${save.textContent} ${remove.disabled} ${save.disabled}`;
  const labels = [label()];
  add.click();
  labels.push(label());
  const canvas = page.querySelector("canvas");
  canvas.dispatchEvent(new view.WheelEvent("wheel", { deltaY: -400, clientX: 500, clientY: 500, cancelable: true }));
  add.click();
  add.click();
  labels.push(label());
  remove.click();
  labels.push(label());
  view.HTMLAnchorElement.prototype.click = function () { page.seen = [this.download, decodeURIComponent(this.href.split(",")[1]), ...labels]; };
  save.click();
"##;

#[test]
fn browsers_save_a_path_that_is_rendered_as_the_page_shows_it() {
    let folder = fresh("keyframes");
    fs::create_dir_all(&folder).unwrap();
    let [scene, capture] = far(&folder);
    let serving = Serving::start(&[text(&scene)]);
    let start = setup(&String::from_utf8(serving.get("/")).unwrap())["cameras"][0].clone();
    let Some(seen) = look("keyframes", BrowserPage::Served(serving), KEYFRAMES) else { return };
    assert_drawn(&seen);
    let seen_text = |at: usize| seen.state["seen"][at].as_str().unwrap();
    let labels: Vec<&str> = (2..6).map(seen_text).collect();
    let expected = ["of 0 true true", "of 1 false true", "of 3 false false", "of 2 false false"];
    assert_eq!(labels, expected.map(|label| format!("save path {label}")));
    assert_eq!(seen_text(0), "camera_path.json");
    let path = folder.join("path.json");
    fs::write(&path, seen_text(1)).unwrap();
    // The page begins outside the scene.
    let keyframes = splat_model::capture::read_keyframes(&path).unwrap();
    let of = |field: &str| DVec3::from_array(serde_json::from_value(start[field].clone()).unwrap());
    let (position, forward) = (of("position") + DVec3::from(FAR), of("forward"));
    assert_eq!((keyframes.len(), keyframes[0].1), (2, start["fov_y_degrees"].as_f64()));
    let first = keyframes[0].0;
    assert!(first.translation.distance(position) < 1e-6, "{first} instead of {position}");
    assert!(first.matrix3.z_axis.distance(forward) < 1e-6 && first.matrix3.x_axis.x > 0.999, "{first}");
    let step = keyframes[1].0.translation - position;
    assert!(step.dot(forward) > 0.1 && step.reject_from(forward).length() < 1e-6, "{step}");
    // The last keyframe is what the page shows, with as much in the vertical. Without antialiasing few pixels are brighter than many.
    let render = ["render", "--scene", text(&scene), "--capture", text(&capture), "--path", text(&path)];
    succeed(splat(&render).args(["--frames", "2", "--antialias", "--out", text(&folder.join("out"))]));
    let rendered = picture(&folder.join("out/0001.png"));
    let side = |name: &str| seen.state["box"][name].as_f64().unwrap();
    let scale = side("height") / 48.0;
    // Without the buttons above, the note below, and what the window cuts off.
    let rows = 4..((f64::from(seen.picture.height()) - side("top")) / scale - 3.0).min(44.0) as u32;
    let page = RgbImage::from_fn(48, rows.end, |x, y| {
        let left = side("left") + 0.5 * side("width") + (f64::from(x) - 24.0) * scale;
        let block = image::imageops::crop_imm(
            &seen.picture,
            left as u32,
            (f64::from(y) * scale) as u32,
            scale as u32,
            scale as u32,
        );
        image::imageops::thumbnail(&block.to_image(), 1, 1)[(0, 0)]
    });
    let part = |of: &RgbImage, left: u32| {
        image::imageops::crop_imm(of, left, rows.start, 48, rows.end - rows.start).to_image()
    };
    let (shown, expected) = (part(&page, 0), part(&rendered, 8));
    let error = difference(&shown, &expected);
    let mirrored = difference(&shown, &image::imageops::flip_horizontal(&expected));
    assert!(error < 5.0 && 3.0 * error < mirrored, "{error}; mirrored {mirrored}");
}
