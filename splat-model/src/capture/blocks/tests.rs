use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use glam::{DQuat, DVec3, Vec3};
use tempfile::TempDir;

use super::*;
use splat_demo::{self as demo, DemoOptions};

/// A small town and its capture.
static TOWN: LazyLock<(TempDir, Capture)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 32, height: 24, views: 80, points: 3_000, ..DemoOptions::TOWN };
    demo::write(folder.path(), &options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    (folder, capture)
});

fn planned(blocks: usize) -> Vec<Block> {
    let options = BlockOptions { blocks, ..BlockOptions::default() };
    plan(&TOWN.1, &Split::of(&TOWN.1, None), &options).unwrap()
}

#[test]
fn cells_divide_space_and_share_the_points() {
    let capture = &TOWN.1;
    for blocks in [1, 2, 3, 4, 7] {
        let plan = planned(blocks);
        assert_eq!(plan.len(), blocks);
        let held = |at: DVec3| plan.iter().filter(|block| block.cell.contains(at)).count();
        for position in &capture.points.positions {
            assert_eq!(held(Vec3::from(*position).as_dvec3()), 1);
        }
        for far in [DVec3::splat(1e9), DVec3::new(-1e9, 3.0, 0.0), DVec3::NEG_Z * 1e6] {
            assert_eq!(held(far), 1);
        }
        assert_eq!(held(DVec3::new(f64::NAN, 0.0, 0.0)), 0);
        let fair = capture.points.positions.len() as f64 / blocks as f64;
        for block in &plan {
            let share = block.points_in_cell as f64 / fair;
            assert!(share > 0.8 && share < 1.2, "{share} of the points of a fair share of {blocks}");
        }
    }
}

/// The side of a cut belongs to one of two cells, also where a point lies on it.
#[test]
fn a_point_on_a_border_belongs_to_one_cell() {
    let [below, above] = Bounds::everything(glam::DMat3::IDENTITY).cut(0, 2.0);
    let at = |x: f64| DVec3::new(x, 5.0, -5.0);
    assert!(!below.contains(at(2.0)) && above.contains(at(2.0)));
    assert!(below.contains(at(2.0_f64.next_down())) && !above.contains(at(2.0_f64.next_down())));
    assert!(below.grown([0.5, 1.0, 1.0]).contains(at(2.25)) && !below.grown([0.5, 1.0, 1.0]).contains(at(2.5)));
    assert!(above.grown([0.5, 1.0, 1.0]).contains(at(1.5)));
}

/// Turning and moving a capture turns and moves its cells: which way is up is found from the cameras.
#[test]
fn cells_stand_upright_in_any_frame() {
    let capture = &TOWN.1;
    let turned_from_world = glam::DAffine3::from_rotation_translation(
        DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 2.1),
        DVec3::new(30.0, -7.0, 11.0),
    );
    let mut turned = capture.clone();
    for view in &mut turned.views {
        view.cam_from_world *= turned_from_world.inverse();
    }
    for position in &mut turned.points.positions {
        *position = turned_from_world.transform_point3(Vec3::from(*position).as_dvec3()).as_vec3().to_array();
    }
    let options = BlockOptions { blocks: 2, ..BlockOptions::default() };
    let (plan, other) = (planned(2), super::plan(&turned, &Split::of(&turned, None), &options).unwrap());
    for block in &plan {
        let up = DVec3::from(block.cell.box_from_world[2]);
        assert!(up.dot(DVec3::Z) > 0.9, "{up}");
        // The axis that is cut may point either way.
        let same = |other: &&Block| {
            other.points.iter().filter(|point| block.points.contains(point)).count() > block.points.len() * 95 / 100
        };
        assert!(other.iter().any(|block| same(&block)), "no block has the same points");
    }
}

#[test]
fn a_block_has_the_photographs_that_see_it() {
    let capture = &TOWN.1;
    let split = Split::of(capture, None);
    let plan = planned(4);
    let mut used = BTreeSet::new();
    for block in &plan {
        assert!(block.train.iter().all(|view| split.train.contains(view)));
        assert!(!block.test.is_empty() && block.test.iter().all(|view| split.test.contains(view)));
        assert!(block.train.len() < split.train.len(), "a block has all photographs");
        used.extend(block.train.iter().copied());
        let in_region: BTreeSet<usize> = (0..capture.points.positions.len())
            .filter(|&point| block.region.contains(capture.position(point)))
            .collect();
        assert!(in_region.len() >= block.points_in_cell);
        assert!(in_region.iter().all(|point| block.points.binary_search(point).is_ok()));
        let beyond = block.points.len() - in_region.len();
        assert!(beyond > 0 && beyond * 4 <= in_region.len() + 4, "{beyond} beyond {}", in_region.len());
        // Of the points of a photograph that is left out, few lie in the block.
        for view in split.train.iter().filter(|view| !block.train.contains(view)) {
            let of_view = (0..capture.points.positions.len())
                .filter(|&point| capture.tracks.of(point).iter().any(|seen| seen.view == *view));
            let (all, within) = of_view
                .fold((0, 0), |(all, within), point| (all + 1, within + usize::from(in_region.contains(&point))));
            assert!(10 * within < all.max(10), "photograph {view}: {within} of {all}");
        }
    }
    assert!(used.len() > split.train.len() * 9 / 10, "{} of {}", used.len(), split.train.len());
}

/// A folder of a block reads as its part of the capture, in the frame of the whole.
#[test]
fn a_folder_of_a_block_is_a_capture() {
    let (folder, capture) = &*TOWN;
    let out = folder.path().join("blocks/1");
    fs::create_dir_all(&out).unwrap();
    let block = &planned(2)[1];
    BlockFile::of(capture, PathBuf::from("../.."), block).write(&out).unwrap();
    let part = Capture::load(&out).unwrap();
    let names = |capture: &Capture, views: &[usize]| -> Vec<String> {
        views.iter().map(|&view| capture.views[view].name.clone()).collect()
    };
    let split = Split::of(&part, None);
    assert_eq!(names(&part, &split.train), names(capture, &block.train));
    assert_eq!(names(&part, &split.test), names(capture, &block.test));
    assert_eq!((part.origin, part.views.len()), (capture.origin, block.train.len() + block.test.len()));
    assert!(part.views.iter().all(|view| view.image_path.is_file()));
    assert_eq!(part.focus, Some(block.region));
    assert_eq!(part.points.positions.len(), block.points.len());
    for (now, &was) in block.points.iter().enumerate().step_by(50) {
        assert_eq!(part.points.positions[now], capture.points.positions[was]);
        for seen in part.tracks.of(now) {
            let name = &part.views[seen.view].name;
            let same = |of: &&crate::capture::Observation| capture.views[of.view].name == *name;
            assert_eq!(capture.tracks.of(was).iter().find(same).unwrap().at_px, seen.at_px);
        }
    }
}

#[test]
fn a_block_that_does_not_fit_its_capture_is_refused() {
    let (folder, capture) = &*TOWN;
    let out = folder.path().join("wrong");
    fs::create_dir_all(&out).unwrap();
    let good = BlockFile::of(capture, folder.path().to_owned(), &planned(2)[0]);
    good.write(&out).unwrap();
    assert_eq!(Capture::load(&out).unwrap().files, [&capture.files[..], &[out.join(BLOCK)]].concat());
    let refused = |file: &BlockFile| {
        file.write(&out).unwrap();
        Capture::load(&out).unwrap_err().to_string()
    };
    let twice = good.train[0].clone();
    for (file, parts) in [
        (BlockFile { counts: [79, 3_000], ..good.clone() }, ["counts", "79 photographs", "80 and 3000"]),
        (BlockFile { train: vec!["x.png".into()], ..good.clone() }, ["train", "x.png", "names"]),
        (BlockFile { test: vec![twice.clone()], ..good.clone() }, ["test", &twice, "once"]),
        (BlockFile { points: vec![3_000], ..good.clone() }, ["points", "3000", "indices"]),
        (BlockFile { capture: out.clone(), ..good.clone() }, ["capture", "which is a block", "whole"]),
        (BlockFile { capture: "nowhere".into(), ..good }, ["nowhere", "sparse", "found"]),
    ] {
        let error = refused(&file);
        assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    }
    fs::write(out.join(BLOCK), "{\"capture\": 3}").unwrap();
    let error = Capture::load(&out).unwrap_err().to_string();
    assert!(error.contains("block.json") && error.contains("splat blocks plan"), "{error}");
}

/// Without tracks, projections tell which photographs see a block.
#[test]
fn a_capture_without_tracks_is_cut_too() {
    let capture = Capture { tracks: Default::default(), ..TOWN.1.clone() };
    let plan = plan(&capture, &Split::of(&capture, None), &BlockOptions { blocks: 2, ..Default::default() }).unwrap();
    for (block, with) in plan.iter().zip(planned(2)) {
        assert_eq!(block.cell, with.cell);
        assert!(block.train.len() >= with.train.len(), "nothing hides a point from a projection");
    }
}

#[test]
fn what_cannot_be_cut_is_refused() {
    let capture = &TOWN.1;
    let split = Split::of(capture, None);
    let refused = |capture: &Capture, blocks| {
        plan(capture, &split, &BlockOptions { blocks, ..BlockOptions::default() }).unwrap_err().to_string()
    };
    assert!(refused(capture, 0).contains("0 blocks"));
    assert!(refused(capture, 5_000).contains("into 5000 blocks: plan fewer"));
    let without_points = Capture { points: Default::default(), ..capture.clone() };
    assert!(refused(&without_points, 2).contains("no sparse points"));
    let mut one = capture.clone();
    one.points.positions.fill([1.0; 3]);
    for view in &mut one.views {
        view.cam_from_world = glam::DAffine3::from_translation(DVec3::NEG_ONE);
    }
    assert!(refused(&one, 2).contains("into 2 blocks: plan fewer"));
}
