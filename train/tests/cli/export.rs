//! `splat export`: one page with the viewer, the scene and named views.

use std::fs;

use serde_json::Value;

use crate::browser::{BrowserPage, assert_drawn, look};
use crate::run::{DEMO, TRAINED, fresh, refuse, splat, succeed};
use crate::{TEST_VIEW, text};

/// The setup of a page's viewer.
pub fn setup(page: &str) -> Value {
    let (_, rest) = page.split_once("id=\"viewer-setup\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_page_holds_the_viewer_the_scene_and_named_views() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, page) = (TRAINED.join("scene.ply"), folder.path().join("below/page.html"));
    let front = format!("{TEST_VIEW}=The <front>");
    let views =
        ["--views", text(&DEMO), "--view", &front, "--view", "0003.png", "--title", "A & B", "--background", "white"];
    let said = succeed(splat(&["export", text(&scene), "--html", text(&page)]).args(views)).stdout;
    let html = fs::read_to_string(&page).unwrap();
    assert!(said.contains(&format!("{} bytes", html.len())) && said.contains("2 views"), "{said}");
    assert!(html.contains("<title>A &amp; B</title>") && html.contains("Permission is hereby granted"));
    assert!(html.contains(">The &lt;front&gt;</button>") && html.contains(">0003.png</button>"));
    let found = setup(&html);
    assert_eq!(
        (&found["kind"], &found["url"], &found["background"][0]),
        (&"pcsogszip".into(), &Value::Null, &1.0.into())
    );
    assert_eq!((&found["cameras"][0]["name"], found["cameras"].as_array().unwrap().len()), (&"The <front>".into(), 2));
    // The libraries have 3 MB, and the scene is a fraction of its PLY file.
    let library = 3_100_000;
    assert!((html.len() as u64) < library + fs::metadata(&scene).unwrap().len(), "{} bytes", html.len());
    // Without a choice there are views from all sides, and without a capture one from outside.
    succeed(&mut splat(&["export", text(&scene), "--html", text(&page), "--views", text(&DEMO)]));
    let names: Vec<String> = setup(&fs::read_to_string(&page).unwrap())["cameras"]
        .as_array()
        .unwrap()
        .iter()
        .map(|camera| camera["name"].as_str().unwrap().to_owned())
        .collect();
    assert!(names.len() == 8 && names[0] == TEST_VIEW && names.is_sorted(), "{names:?}");
    succeed(&mut splat(&["export", text(&scene), "--html", text(&page), "--sh-degree", "0"]));
    let alone = fs::read_to_string(&page).unwrap();
    assert_eq!(setup(&alone)["cameras"][0]["name"], "from outside");
    assert!(!alone.contains("<button"));
}

#[test]
fn what_cannot_be_exported_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, page) = (TRAINED.join("scene.ply"), folder.path().join("page.html"));
    let export = |more: &[&str], told: &[&str]| {
        refuse(splat(&["export", text(&scene), "--html", text(&page)]).args(more), told);
        assert!(!page.exists());
    };
    export(&["--views", text(&DEMO), "--view", "none.png"], &["no view \"none.png\"", TEST_VIEW]);
    export(&["--views", text(&DEMO), "--view", &format!("{TEST_VIEW}=")], &["no text after `=`"]);
    export(&["--views", text(folder.path())], &[text(folder.path())]);
    let missing = folder.path().join("none.ply");
    refuse(&mut splat(&["export", text(&missing), "--html", text(&page)]), &["none.ply", "is the path right"]);
}

/// The page from its file, after a flight to its second view: another picture than that of the first.
#[test]
fn browsers_fly_to_the_named_views_of_a_page() {
    let folder = fresh("exported");
    fs::create_dir_all(&folder).unwrap();
    let (scene, page) = (TRAINED.join("scene.ply"), folder.join("page.html"));
    let views = ["--views", text(&DEMO), "--view", TEST_VIEW, "--view", "0004.png=Behind"];
    succeed(splat(&["export", text(&scene), "--html", text(&page)]).args(views));
    let Some(first) = look("export-first", BrowserPage::File(page.clone()), "") else { return };
    assert_drawn(&first);
    assert_eq!(first.state["view"], Value::Null, "{}", first.state);
    let fly = "const buttons = page.querySelectorAll('#viewer-views button');
        for (let i = 0; i < 1000 && !page.documentElement.dataset.viewer; i++) await wait(100);
        buttons[1].click();
        for (let i = 0; i < 200 && !page.documentElement.dataset.view; i++) await wait(100);";
    let second = look("export-second", BrowserPage::File(page), fly).unwrap();
    assert_drawn(&second);
    assert_eq!(second.state["view"], "1", "{}", second.state);
    let differing = first.picture.pixels().zip(second.picture.pixels()).filter(|(a, b)| a != b).count();
    assert!(differing > 10_000, "{differing} pixels changed on the way");
}
