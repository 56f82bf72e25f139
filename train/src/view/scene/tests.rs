use splat_model::capture::Photo;

use super::*;

/// Gaussians in a row along x, each a little larger than the one before.
fn rows(count: usize, sh_degree: usize) -> GaussianRows {
    let rest = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
    GaussianRows {
        means: (0..count).map(|i| [i as f32, 2.0, 3.0]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: (0..count).map(|i| [-4.0 + 0.1 * i as f32, -4.0, -9.0]).collect(),
        logit_opacities: vec![2.0; count],
        sh_dc: vec![[0.5; 3]; count],
        sh_rest: (0..count * rest).map(|i| i as f32).collect(),
        sh_degree,
        groups: Vec::new(),
    }
}

/// Returns the rows that a viewer reads.
fn read(scene: &ShownScene) -> GaussianRows {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, &scene.ply).unwrap();
    ply::read(&path).unwrap().0
}

#[test]
fn a_small_scene_is_shown_whole() {
    let rows = rows(20, 2);
    let scene = ShownScene::new(&rows, usize::MAX).unwrap();
    assert_eq!(read(&scene), rows);
    assert_eq!((scene.splats, scene.of, scene.sh_degree, scene.of_sh_degree), (20, 20, 2, 2));
    assert_eq!(scene.omissions(), "");
    assert!(
        scene.ply.len() >= 20 * bytes_per_row(2) && scene.ply.len() < 20 * bytes_per_row(2) + 2000,
        "{}",
        scene.ply.len()
    );
}

#[test]
fn colours_are_cut_before_splats_are() {
    let rows = rows(100, 3);
    let scene = ShownScene::new(&rows, 100 * bytes_per_row(1)).unwrap();
    assert_eq!((scene.splats, scene.sh_degree), (100, 1));
    let shown = read(&scene);
    assert_eq!(shown.means, rows.means);
    assert_eq!(shown.sh_rest[9..18], rows.sh_rest[45..54], "the coefficients of degree 1 come first");
    assert!(scene.omissions().contains("degree 1 of 3"), "{}", scene.omissions());
    let degree_4 = ShownScene::new(&self::rows(3, 4), usize::MAX).unwrap();
    assert_eq!(degree_4.sh_degree, 3, "the library reads no more");
}

#[test]
fn the_splats_that_cover_the_most_are_kept_in_their_order() {
    let mut rows = rows(100, 1);
    rows.logit_opacities[99] = -200.0;
    rows.log_scales[0] = [2.0, 2.0, -9.0];
    let scene = ShownScene::new(&rows, 10 * bytes_per_row(0) + 3).unwrap();
    assert_eq!((scene.splats, scene.of, scene.sh_degree), (10, 100, 0));
    let kept: Vec<f32> = read(&scene).means.iter().map(|mean| mean[0]).collect();
    assert_eq!(kept, [0.0, 90.0, 91.0, 92.0, 93.0, 94.0, 95.0, 96.0, 97.0, 98.0]);
    assert!(scene.omissions().contains("10 splats of 100"), "{}", scene.omissions());
}

#[test]
fn what_cannot_be_drawn_is_left_out() {
    let mut rows = rows(4, 0);
    rows.means[1][0] = f32::NAN;
    let scene = ShownScene::new(&rows, usize::MAX).unwrap();
    assert_eq!((scene.splats, read(&scene).means.len()), (3, 3));
    assert!(scene.extent.centre.is_finite() && scene.extent.radius.is_finite());
    rows.logit_opacities.fill(f32::NAN);
    assert!(ShownScene::new(&rows, usize::MAX).unwrap_err().to_string().contains("no splat"));
    assert!(ShownScene::new(&GaussianRows::default(), usize::MAX).is_err());
    rows.logit_opacities.pop();
    assert!(ShownScene::new(&rows, usize::MAX).is_err(), "rows that do not fit together");
}

#[test]
fn one_splat_far_away_does_not_count() {
    let mut rows = rows(101, 0);
    rows.means[100] = [1e6, 0.0, 0.0];
    let Extent { centre, radius } = ShownScene::new(&rows, usize::MAX).unwrap().extent;
    assert_eq!(centre, DVec3::new(50.0, 2.0, 3.0));
    assert!((40.0..50.0).contains(&radius), "{radius}");
    let one = ShownScene::new(&self::rows(1, 0), usize::MAX).unwrap().extent;
    assert_eq!(one.radius, 1.0);
}

#[test]
fn viewpoints_are_where_the_cameras_are() {
    // A camera with OpenCV axes at (0, 0, -5), looking along +z.
    let photo = Photo {
        name: "a".into(),
        intrinsics: Intrinsics::centred(200, 100, 50.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.0, 0.0, 5.0)),
        rgb: Vec::new(),
        alpha: None,
        mask: None,
    };
    let found = Viewpoint::of(&photo.name, &photo.intrinsics, &photo.cam_from_world);
    assert_eq!((found.position, found.forward), ([0.0, 0.0, -5.0], [0.0, 0.0, 1.0]));
    assert_eq!(found.up, DVec3::NEG_Y);
    assert!((found.fov_y_degrees - 90.0).abs() < 1e-9);
}
