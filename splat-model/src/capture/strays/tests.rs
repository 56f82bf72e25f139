use std::path::PathBuf;

use glam::{DAffine3, DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::Intrinsics;

use super::super::{Observation, Tracks, View};
use super::*;

const VIEWS: usize = 17;

/// A camera at `centre` that looks at `target`.
fn pose(centre: DVec3, target: DVec3) -> DAffine3 {
    let turn = DQuat::from_rotation_arc((target - centre).normalize(), DVec3::Z);
    DAffine3::from_rotation_translation(turn, -(turn * centre))
}

/// Cameras around `offset` and 300 points in front of them, observed where they project, before `change` moves some cameras.
fn capture(offset: DVec3, points: usize, tracked: bool, change: impl Fn(&mut [View])) -> Capture {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let view = |i: usize| {
        let centre = offset + DQuat::from_rotation_y(0.3 * i as f64) * DVec3::new(0.0, -0.8, -3.0);
        let name = format!("{i:02}");
        View {
            image_path: PathBuf::from(&name),
            name,
            intrinsics: Intrinsics::centred(64, 48, 50.0),
            cam_from_world: pose(centre, offset),
            cut: Default::default(),
        }
    };
    let mut views: Vec<View> = (0..VIEWS).map(view).collect();
    let positions: Vec<DVec3> =
        (0..points).map(|_| offset + DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))).collect();
    let mut tracks = Tracks::default();
    for point in positions.iter().filter(|_| tracked) {
        let seen = |(view, of): (usize, &View)| {
            let at_px = of.intrinsics.px_from_cam(of.cam_from_world.transform_point3(*point))?.as_vec2().to_array();
            Some(Observation { view, at_px })
        };
        tracks.push(views.iter().enumerate().filter_map(seen).collect::<Vec<_>>(), 0.5);
    }
    change(&mut views);
    let colours = vec![[0; 3]; points];
    let split = Some(Split { train: (1..VIEWS).collect(), test: vec![0] });
    let masks = (0..VIEWS).map(|view| Some(PathBuf::from(format!("{view:02}.png")))).collect();
    Capture { tracks, split, masks, ..Capture::near_zero(&PathBuf::new(), views, &positions, colours) }
}

const UTM: DVec3 = DVec3::new(500_123.25, 5_412_345.5, 312.125);

#[test]
fn a_photograph_at_zero_far_away_or_with_another_pose_is_named_and_left_out() {
    let at_zero = |views: &mut [View]| views[5].cam_from_world = DAffine3::IDENTITY;
    let far = |views: &mut [View]| views[5].cam_from_world.translation = DVec3::new(3000.0, 200.0, 5000.0);
    let turned = |views: &mut [View]| {
        views[5].cam_from_world = DAffine3::from_rotation_y(std::f64::consts::PI) * views[5].cam_from_world;
    };
    let beside = |views: &mut [View]| views[5].cam_from_world.translation.x += 1.5;
    type Case<'a> = (&'a str, DVec3, usize, bool, &'a dyn Fn(&mut [View]), &'a str);
    let cases: [Case; 6] = [
        ("unaligned", UTM, 300, true, &at_zero, "times the size of the scene"),
        ("unaligned, no tracks", UTM, 300, false, &at_zero, "times the size of the scene"),
        ("unaligned, no points", UTM, 0, false, &at_zero, "times the size of the scene"),
        ("far", DVec3::ZERO, 300, false, &far, "times the size of the scene"),
        ("turned", DVec3::ZERO, 300, true, &turned, "its points are outside of its picture"),
        ("beside", DVec3::ZERO, 300, true, &beside, "% of its longer side beside their places"),
    ];
    for (name, offset, points, tracked, change, why) in cases {
        let given = capture(offset, points, tracked, change);
        assert!(given.origin.distance(offset) < 4.0, "{name}: the origin is {}", given.origin);
        let observations = given.tracks.observations();
        let left = leave_out(given);
        let remark = left.remarks.join("");
        assert!(remark.contains("1 of 17 photographs") && remark.contains("05 (") && remark.contains(why), "{remark}");
        assert!(left.views.len() == VIEWS - 1 && left.views.iter().all(|view| view.name != "05"), "{name}");
        // What belongs to the views goes with them.
        assert_eq!(left.masks[5], Some(PathBuf::from("06.png")));
        assert_eq!(left.split, Some(Split { train: (1..VIEWS - 1).collect(), test: vec![0] }), "{name}");
        if tracked {
            assert_eq!(left.tracks.observations() * VIEWS, observations * (VIEWS - 1), "{name}");
            assert!(misses(&left).iter().all(Option::is_none), "{name}");
        }
    }
}

#[test]
fn photographs_that_can_be_right_stay() {
    let kept = |given: Capture| {
        let left = leave_out(given);
        (left.views.len(), left.remarks)
    };
    let all = (VIEWS, Vec::new());
    let overview = |views: &mut [View]| views[5].cam_from_world = pose(DVec3::new(0.0, -15.0, -20.0), DVec3::ZERO);
    let turned = |views: &mut [View]| {
        views.iter_mut().for_each(|view| view.cam_from_world = DAffine3::from_rotation_x(3.0) * view.cam_from_world);
    };
    for tracked in [true, false] {
        assert_eq!(kept(capture(DVec3::ZERO, 300, tracked, |_| {})), all);
        assert_eq!(kept(capture(UTM, 300, tracked, |_| {})), all);
        assert_eq!(kept(capture(DVec3::ZERO, 300, tracked, turned)), all, "the capture is wrong, not a photograph");
    }
    assert_eq!(kept(capture(DVec3::ZERO, 300, false, overview)), all);
    let one = Capture { views: capture(UTM, 0, false, |_| {}).views[..1].to_vec(), ..capture(UTM, 0, false, |_| {}) };
    assert_eq!(kept(one).0, 1);
}
