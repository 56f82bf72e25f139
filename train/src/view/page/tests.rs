use splat_model::gaussians::GaussianRows;

use super::*;

/// Gaussians in a row.
fn scene() -> ShownScene {
    let count = 5;
    let rows = GaussianRows {
        means: (0..count).map(|i| [i as f32, 0.0, 4.0]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: vec![[-2.0; 3]; count],
        logit_opacities: vec![2.0; count],
        sh_dc: vec![[0.5; 3]; count],
        sh_rest: Vec::new(),
        sh_degree: 0,
        groups: Vec::new(),
    };
    ShownScene::new(&rows, usize::MAX).unwrap()
}

fn viewpoint(name: &str, up: DVec3) -> Viewpoint {
    Viewpoint { name: name.into(), position: [0.0; 3], forward: [0.0, 0.0, 1.0], up, fov_y_degrees: 40.0 }
}

fn viewer<'a>(scene: &'a ShownScene, viewpoints: &'a [Viewpoint], source: SceneSource<'a>) -> Viewer<'a> {
    Viewer { scene, source, viewpoints, background: [0.0, 0.5, 1.0], antialias: false }
}

/// Returns the setup that the script reads.
fn setup(scripts: &str) -> serde_json::Value {
    let (_, rest) = scripts.split_once("id=\"viewer-setup\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn the_library_is_the_one_that_is_written_down() {
    // The size is stated in assets/viewer/README.md. The file is not meant to be changed by hand.
    assert_eq!(LIBRARY.len(), 3_030_979);
    assert!(LIBRARY.is_ascii(), "a server or an editor with another encoding would spoil it");
    for part in ["</script", "<!--"] {
        assert!(
            !LIBRARY.to_lowercase().contains(part) && !SCRIPT.contains(part),
            "{part} would end the script element"
        );
    }
    for part in ["Spark", "three.js", "fflate", "Permission is hereby granted"] {
        assert!(LICENSES.contains(part), "{part}");
    }
    assert!(!LICENSES.contains("--"), "that would end the comment");
}

#[test]
fn a_page_holds_its_scene_and_a_server_hands_it_out() {
    let scene = scene();
    let page = viewer(&scene, &[], SceneSource::Page).scripts().unwrap();
    let (_, text) = page.split_once("id=\"viewer-scene\">").unwrap();
    let text = text.split_once("</script>").unwrap().0;
    assert_eq!(BASE64_STANDARD.decode(text).unwrap(), scene.ply);
    assert_eq!((&setup(&page)["url"], &setup(&page)["origin"]), (&serde_json::Value::Null, &serde_json::Value::Null));
    let served = viewer(&scene, &[], SceneSource::Url("/scene.ply", DVec3::new(1.0, 2.0, 3.0))).scripts().unwrap();
    assert!(!served.contains("viewer-scene\">"));
    assert_eq!(setup(&served)["url"], "/scene.ply");
    assert_eq!(setup(&served)["origin"], serde_json::json!([1.0, 2.0, 3.0]));
}

#[test]
fn without_viewpoints_one_looks_from_outside() {
    let scene = scene();
    let setup = setup(&viewer(&scene, &[], SceneSource::Page).scripts().unwrap());
    assert_eq!(setup["up"], serde_json::json!([0.0, -1.0, 0.0]));
    let position: [f64; 3] = serde_json::from_value(setup["cameras"][0]["position"].clone()).unwrap();
    assert!(position[2] < 4.0 && position[1] < 0.0, "in front of the scene and above it: {position:?}");
    assert_eq!(setup["centre"], serde_json::json!([2.0, 0.0, 4.0]));
    assert!((setup["blur"].as_f64().unwrap() - 0.3).abs() < 1e-9);
}

#[test]
fn upwards_is_what_the_cameras_agree_on() {
    let scene = scene();
    let up = |ups: &[DVec3]| {
        let viewpoints: Vec<Viewpoint> = ups.iter().map(|&up| viewpoint("a", up)).collect();
        let up = setup(&viewer(&scene, &viewpoints, SceneSource::Page).scripts().unwrap())["up"].clone();
        DVec3::from_array(serde_json::from_value(up).unwrap())
    };
    assert!(up(&[DVec3::X, DVec3::Y]).distance(DVec3::new(0.5, 0.5, 0.0).normalize()) < 1e-12);
    assert_eq!(up(&[DVec3::X, DVec3::NEG_X]), DVec3::X, "cameras that agree on nothing");
}

#[test]
fn names_of_photographs_are_text() {
    let scene = scene();
    let viewpoints = [viewpoint("</select><script>alert(1)</script>", DVec3::Y)];
    let viewer = viewer(&scene, &viewpoints, SceneSource::Page);
    assert!(!viewer.element().contains("<script>"), "{}", viewer.element());
    assert!(!viewer.scripts().unwrap().contains("<script>alert"));
}
