//! Tests that each switch adds to the capture what its documentation says, and nothing else. The tests of the survey are beside
//! this module.

use glam::DVec3;

use super::super::depth;
use super::super::picture::mask;
use super::super::pose;
use super::*;
use splat_model::capture::Capture;
use splat_model::optim::scene_extent;

/// Options with each switch alone.
pub(super) fn switches(base: DemoOptions) -> Vec<(&'static str, DemoOptions)> {
    vec![
        ("glossy", DemoOptions { glossy: true, ..base }),
        ("exposure", DemoOptions { exposure: true, ..base }),
        ("graded", DemoOptions { graded: true, ..base }),
        ("lens", DemoOptions { lens: true, ..base }),
        ("fisheye", DemoOptions { fisheye: true, ..base }),
        ("masks", DemoOptions { masks: true, ..base }),
        ("alpha", DemoOptions { alpha: true, ..base }),
        ("zoom", DemoOptions { zoom: true, ..base }),
        ("poses", DemoOptions { poses: true, ..base }),
        ("far", DemoOptions { far: true, ..base }),
        ("motion", DemoOptions { motion: true, ..base }),
        ("rolling", DemoOptions { rolling: true, ..base }),
        ("depth", DemoOptions { depth: true, ..base }),
    ]
}

/// All switches that may be combined.
const ALL: DemoOptions = DemoOptions {
    glossy: true,
    exposure: true,
    graded: true,
    lens: true,
    masks: true,
    alpha: true,
    zoom: true,
    poses: true,
    motion: true,
    rolling: true,
    depth: true,
    ..TINY
};

const TINY: DemoOptions = DemoOptions { width: 32, height: 24, views: 10, points: 60, ..DemoOptions::PLAIN };

/// The size that figures in pixels refer to, and one view to train on.
pub(super) const FULL: DemoOptions = DemoOptions { views: 3, points: 0, ..DemoOptions::PLAIN };

pub(super) fn scene(options: &DemoOptions) -> LitScene {
    LitScene::new(DemoScene::still_life(options))
}

/// FNV-1a (Fowler, Noll, Vo) of the pixels and the model that the program wrote when it had two switches. The last bit of a
/// sine may differ between systems, and so may a level or a coordinate.
#[test]
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn the_plain_demo_is_what_it_always_was() {
    let folder = TempDir::new().unwrap();
    write(folder.path(), &DemoOptions { width: 64, height: 48, views: 6, ..DemoOptions::PLAIN }).unwrap();
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    let mut add =
        |bytes: &[u8]| bytes.iter().for_each(|&b| digest = (digest ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    for view in 0..6 {
        add(image::open(folder.path().join(format!("images/{view:04}.png"))).unwrap().into_rgb8().as_raw());
    }
    for name in ["cameras", "images", "points3D"] {
        add(&fs::read(folder.path().join(format!("sparse/0/{name}.bin"))).unwrap());
    }
    assert_eq!(format!("{digest:#x}"), "0xaf1129113bcd1803");
}

#[test]
fn each_switch_changes_the_capture_and_can_be_repeated() {
    let plain = written(&TINY);
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for (name, options) in switches(TINY).into_iter().chain([("all", ALL)]) {
        let once = written(&options);
        assert!(once != plain, "{name} does nothing");
        assert!(one_thread.install(|| written(&options)) == once, "{name} is not repeatable");
        let beside = once.keys().filter(|file| !file.starts_with("sparse/")).map(String::as_str);
        let mut expected: Vec<_> =
            super::super::files(&options).iter().map(|file| file.to_str().unwrap().to_string()).collect();
        expected.sort();
        let tells = ["poses", "motion", "rolling", "all"].contains(&name);
        assert_eq!(once.contains_key("truth.json"), tells, "{name}");
        assert!(beside.eq(expected.iter().map(String::as_str)), "{name} writes other files than it says");
        let parts = |file: &String| PARTS.contains(&file.split('/').next().unwrap());
        assert!(once.keys().all(parts), "{name}");
    }
}

#[test]
fn what_excludes_each_other_is_refused() {
    let lenses = DemoOptions { lens: true, fisheye: true, ..TINY };
    for (options, names) in
        [(lenses, ["lens", "fisheye"]), (DemoOptions { far: true, alpha: true, ..TINY }, ["far", "alpha"])]
    {
        let message = write(Path::new("/nonexistent"), &options).unwrap_err().to_string();
        assert!(names.iter().all(|name| message.contains(name)) && message.contains("leave one"), "{message}");
    }
}

#[test]
fn lenses_bend_as_far_as_they_say() {
    let lens = cameras(&DemoOptions { lens: true, ..FULL })[0].intrinsics;
    let moved = [(0.0, 0.0), (0.0, 180.0), (240.0, 0.0), (240.0, 180.0)].map(|(x, y)| {
        let slopes = lens.cam_from_px(DVec2::new(x, y)).truncate();
        DVec2::new(lens.fx * slopes.x + lens.cx, lens.fy * slopes.y + lens.cy).distance(DVec2::new(x, y)) / 240.0
    });
    let most = moved.into_iter().fold(0.0, f64::max);
    assert!((most / DemoOptions::LENS_SHARE - 1.0).abs() < 0.1, "{moved:?}");
    assert!(lens.distortion[..4].iter().all(|coefficient| *coefficient != 0.0), "no part of the model is idle");
    // The lens reaches the corners of a picture of any shape.
    for (width, height) in [(16, 4096), (4096, 16)] {
        let lens = cameras(&DemoOptions { lens: true, width, height, ..FULL })[0].intrinsics;
        assert!(lens.px_from_cam(lens.cam_from_px(DVec2::ZERO)).unwrap().length() < 1e-6);
    }
    let fisheye = cameras(&DemoOptions { fisheye: true, ..FULL })[0].intrinsics;
    let angle = fisheye.cam_from_px(DVec2::new(0.0, 90.0)).angle_between(DVec3::Z).to_degrees();
    assert!((2.0 * angle - DemoOptions::FISHEYE_FOV_DEG).abs() < 1e-6, "{angle}");
}

/// A photograph shows a point in its own colour at the position in its track, through each lens and with a rolling shutter.
#[test]
fn tracks_lead_to_what_the_pictures_show() {
    let base = DemoOptions { width: 64, height: 48, views: 6, points: 200, ..DemoOptions::PLAIN };
    let lens = DemoOptions { lens: true, ..base };
    let fisheye = DemoOptions { fisheye: true, ..base };
    let rolling = DemoOptions { rolling: true, ..base };
    for options in [base, lens, fisheye, rolling, DemoOptions { rolling: true, ..lens }] {
        let scene = scene(&options);
        let shots = shots(&options);
        let (cloud, tracks) = sample(&scene, &shots, &options);
        let mut seen = 0;
        for (point, colour) in cloud.colours.iter().enumerate() {
            for observation in tracks.of(point) {
                let ray = shots[observation.view].ray(glam::Vec2::from(observation.at_px).as_dvec2(), 0.0);
                let shown = super::super::picture::to_bytes(display(scene.along(&ray)));
                let apart = (0..3).map(|i| shown[i].abs_diff(colour[i])).max().unwrap();
                // Rounded to f32, a position beside an edge may lie on it.
                seen += usize::from(apart <= 2);
            }
        }
        let observations: usize = (0..cloud.positions.len()).map(|point| tracks.of(point).len()).sum();
        assert!(observations > 400 && seen * 100 >= observations * 99, "{seen} of {observations}: {options:?}");
    }
}

#[test]
fn masks_exclude_what_covers_the_scene_and_little_more() {
    let options = DemoOptions { masks: true, views: 10, ..FULL };
    let scene = scene(&options);
    for (view, shot) in shots(&options).iter().enumerate() {
        assert_eq!(shot.discs.len(), if DemoOptions::held_out(view) { 0 } else { DemoOptions::MASKED_PLACES });
        for disc in &shot.discs {
            let share = 2.0 * disc.radius_px / 240.0;
            let [least, largest] = DemoOptions::MASKED_SIZE;
            assert!((least..=largest).contains(&share), "{share}");
        }
        if !(1..=3).contains(&view) {
            continue;
        }
        let (covered, clear) =
            (render(&scene, shot).into_rgb8(), render(&scene, &Shot::plain(shot.camera)).into_rgb8());
        let mask = mask(shot);
        let (mut excluded, mut changed, mut strong) = (0, 0, 0);
        for ((mask, covered), clear) in mask.pixels().zip(covered.pixels()).zip(clear.pixels()) {
            assert!(mask.0[0] == 0 || covered == clear, "what counts shows the scene");
            let difference = (0..3).map(|i| covered[i].abs_diff(clear[i])).max().unwrap();
            excluded += usize::from(mask.0[0] == 0);
            changed += usize::from(difference > 0);
            strong += usize::from(difference > 50);
        }
        let margin: f64 = shot.discs.iter().map(|disc| std::f64::consts::TAU * disc.radius_px * 3.0).sum();
        assert!(strong * 10 > changed * 8 && strong > 100, "{strong} of {changed} pixels differ strongly");
        assert!(excluded >= changed && ((excluded - changed) as f64) < margin, "{excluded} {changed}");
    }
}

#[test]
fn no_track_leads_to_what_covers_the_scene() {
    let options = DemoOptions { masks: true, views: 10, points: 400, ..SMALL };
    let (scene, shots) = (scene(&options), shots(&options));
    let (cloud, tracks) = sample(&scene, &shots, &options);
    let observations = (0..cloud.positions.len()).flat_map(|point| tracks.of(point));
    assert!(observations.clone().count() > 1000);
    for observation in observations {
        let at_px = glam::Vec2::from(observation.at_px).as_dvec2();
        assert!(
            shots[observation.view].discs.iter().all(|disc| disc.middle_px.distance(at_px) > disc.radius_px - 1e-4)
        );
    }
}

/// Compares with nine rays of each pixel, which the test counts itself.
#[test]
fn alpha_and_colour_come_from_the_same_rays() {
    let options = DemoOptions { alpha: true, ..SMALL };
    let scene = scene(&options);
    let shot = &shots(&options)[1];
    let picture = render(&scene, shot).into_rgba8();
    let mut partial = 0;
    for (x, y, pixel) in picture.enumerate_pixels() {
        let (mut sum, mut count) = (DVec3::ZERO, 0);
        for i in 0..9 {
            let at_px =
                DVec2::new(f64::from(x), f64::from(y)) + (DVec2::new(f64::from(i % 3), f64::from(i / 3)) + 0.5) / 3.0;
            let ray = shot.camera.ray_through(at_px);
            let kind = scene.scene.objects[scene.scene.hit(&ray).unwrap().object].kind;
            if !matches!(kind, ObjectKind::Ground | ObjectKind::Sky) {
                sum += scene.along(&ray);
                count += 1;
            }
        }
        partial += usize::from((1..9).contains(&count));
        assert_eq!(pixel.0[3], (255.0 * f64::from(count) / 9.0).round() as u8);
        if count > 0 {
            let colour = 255.0 * display(sum / f64::from(count));
            let found = DVec3::new(pixel.0[0].into(), pixel.0[1].into(), pixel.0[2].into());
            assert!((colour - found).abs().max_element() < 0.51, "{found} instead of {colour}");
        }
    }
    let clear = picture.pixels().filter(|pixel| pixel.0[3] == 0).count();
    assert!(partial > 50 && clear > 500, "{partial} {clear}");
    let (cloud, _) = sample(&scene, &shots(&options), &options);
    assert!(cloud.positions.len() == 200 && cloud.positions.iter().all(|p| p[0].hypot(p[1]) < 1.96 && p[2] > -0.361));
}

#[test]
fn zoomed_cameras_stand_free_at_three_distances() {
    let options = DemoOptions { zoom: true, ..DemoOptions::PLAIN };
    let scene = scene(&options);
    let (plain, zoomed) = (cameras(&DemoOptions::PLAIN), cameras(&options));
    let mut kinds = Vec::new();
    for (usual, camera) in plain.iter().zip(&zoomed) {
        let subject =
            camera.centre_world + camera.subject_distance * camera.ray_through(DVec2::new(120.0, 90.0)).direction;
        let times = camera.subject_distance / usual.centre_world.distance(subject);
        let apart = |expected: f64| (times / expected - 1.0).abs() < 1e-9;
        kinds.push(match () {
            () if apart(DemoOptions::ZOOM_NEAR) => 1,
            () if apart(DemoOptions::ZOOM_FAR) => 2,
            () => 0,
        });
        // No object is directly before the lens, and no camera is inside an object, where it would see surfaces from behind.
        for ray in grid(camera).iter().step_by(7) {
            let point = scene.scene.hit(ray).unwrap();
            assert!(point.distance > 0.2 && point.normal_world.dot(ray.direction) < 1e-6, "{point:?}");
        }
    }
    for kind in 0..3 {
        assert_eq!(kinds.iter().filter(|&&found| found == kind).count(), 16, "{kinds:?}");
    }
    let held_out: Vec<_> = kinds.into_iter().step_by(DemoOptions::HELD_OUT_EVERY).collect();
    assert_eq!(held_out, [0, 2, 1, 1, 0, 2]);
}

#[test]
fn poses_are_wrong_by_what_is_stated_and_only_where_training_looks() {
    let options = DemoOptions { poses: true, ..TINY };
    let shots = shots(&options);
    let extent = scene_extent(&shots.iter().map(|shot| shot.camera.centre_world).collect::<Vec<_>>());
    for (view, (shot, pose)) in shots.iter().zip(pose::written(&shots, &options)).enumerate() {
        let turn = shot.camera.cam_from_world.matrix3 * pose.matrix3.transpose();
        let angle = (0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0)).min(1.0).acos().to_degrees();
        let moved = pose.inverse().translation.distance(shot.camera.centre_world) / extent;
        if DemoOptions::held_out(view) {
            assert_eq!(pose, shot.camera.cam_from_world);
        } else {
            assert!((angle - 1.0).abs() < 1e-6 && (moved - 0.01).abs() < 1e-9, "{angle} {moved}");
        }
    }
    let (plain, wrong) = (written(&TINY), written(&options));
    for (name, bytes) in &wrong {
        let same = !name.contains("sparse/0/images.bin") && name != "truth.json";
        assert!(!same || plain[name] == *bytes, "{name}");
    }
}

#[test]
fn depth_maps_hold_depth_along_the_axis() {
    for (options, unknown) in [
        (DemoOptions { depth: true, ..SMALL }, false),
        (DemoOptions { depth: true, lens: true, ..SMALL }, false),
        (DemoOptions { depth: true, alpha: true, ..SMALL }, true),
        (DemoOptions { depth: true, far: true, ..SMALL }, true),
    ] {
        let scene = scene(&options);
        let shot = &shots(&options)[2];
        let axis = shot.camera.world_from_cam() * DVec3::Z;
        let mut zeros = 0;
        for (x, y, level) in depth::render(&scene, shot).enumerate_pixels() {
            let ray = shot.camera.ray_through(DVec2::new(f64::from(x), f64::from(y)) + 0.5);
            let point = scene.scene.hit(&ray).unwrap();
            if unknown && scene.scene.objects[point.object].kind == ObjectKind::Sky {
                assert_eq!(level.0[0], 0);
            }
            zeros += usize::from(level.0[0] == 0);
            let found = f64::from(level.0[0]) * DemoOptions::DEPTH_SCALE;
            let expected = point.distance * ray.direction.dot(axis);
            assert!(
                level.0[0] == 0 || (found - expected).abs() < 0.500001 * DemoOptions::DEPTH_SCALE,
                "{found} {expected}"
            );
        }
        assert_eq!(zeros > 0, unknown, "{options:?}");
    }
}

/// The capture with all switches can be loaded, and so can every other.
#[test]
fn captures_of_every_switch_are_read() {
    for (name, options) in switches(TINY).into_iter().chain([("all", ALL)]) {
        let folder = TempDir::new().unwrap();
        write(folder.path(), &options).unwrap();
        let capture = Capture::load(folder.path()).unwrap();
        assert_eq!((capture.views.len(), capture.points.positions.len()), (10, 60), "{name}");
        for view in &capture.views {
            splat_model::capture::image::load(view, None).unwrap();
        }
    }
}
