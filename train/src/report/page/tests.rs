use std::path::Path;

use glam::DVec3;
use image::RgbImage;
use serde_json::json;
use splat_model::evaluate::{Scores, ViewScore};
use splat_model::gaussians::GaussianRows;

use super::super::history::{HistoryPoint, HistoryScore};
use super::super::metrics::Seconds;
use super::super::{VIEWS, pictures};
use super::comparisons::MOST;
use super::*;
use crate::inputs::Inputs;
use crate::view::page::SceneSource;
use crate::view::scene::{ShownScene, Viewpoint};

/// Names that someone could give to photographs.
const NASTY: &str = "</script><script>alert('1 & \"2\"')</script><img src=x onerror=alert(2)>.png";

fn view(name: &str, psnr: f64) -> ViewScore {
    ViewScore {
        name: name.into(),
        psnr,
        ssim: 0.5,
        psnr_corrected: psnr + 1.0,
        ssim_corrected: 0.6,
        lpips: None,
        lpips_missing: Some("no <weights>".into()),
    }
}

fn metrics(views: Vec<ViewScore>, capture: &str) -> Metrics {
    let test = Scores {
        psnr: 20.0,
        ssim: 0.5,
        psnr_corrected: 21.0,
        ssim_corrected: 0.6,
        lpips: None,
        lpips_missing: Some("no <weights>".into()),
        lpips_net: None,
        views,
    };
    Metrics {
        test: (!test.views.is_empty()).then_some(test),
        splats: 3,
        culled_non_finite: 0,
        steps: Some(100),
        seconds: Seconds { load: 0.25, train: Some(100.5), scores: Some(2.0), eval: 1.0 },
        peak_rss_mib: None,
        device: NASTY.into(),
        effects: None,
        seed: Some(7),
        options: json!({ "capture": capture, "note": NASTY }),
        version: "0",
    }
}

fn history() -> History {
    let point = |step| HistoryPoint { step, seconds: step as f64, loss: 1.0 / step as f64, splats: 10 * step };
    History {
        points: (1..=9).map(point).collect(),
        scores: vec![HistoryScore { step: 4, seconds: 4.0, psnr: 15.0, ssim: 0.3, lpips: None, views: 2 }],
    }
}

fn scene() -> ShownScene {
    let rows = GaussianRows {
        means: vec![[0.0; 3], [1.0; 3], [2.0; 3]],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        log_scales: vec![[-2.0; 3]; 3],
        logit_opacities: vec![2.0; 3],
        sh_dc: vec![[0.5; 3]; 3],
        sh_rest: Vec::new(),
        sh_degree: 0,
        groups: Vec::new(),
    };
    ShownScene::new(&rows, SCENE_BYTES).unwrap()
}

/// Returns the page of a run with these views, whose pictures exist.
fn page(views: Vec<ViewScore>) -> String {
    let folder = tempfile::tempdir().unwrap();
    let out = OutputFolder::prepare(folder.path(), Inputs::default(), [""; 0], &[]).unwrap();
    for name in pictures::names(views.iter().map(|view| view.name.as_str()), "png") {
        // Names with slashes are in folders; the page must work without their pictures.
        if name.components().count() == 1 {
            std::fs::create_dir_all(out.join(VIEWS)).unwrap();
            RgbImage::new(9, 2).save(out.join(Path::new(VIEWS).join(name))).unwrap();
        }
    }
    let point = |view: &ViewScore| Viewpoint {
        name: view.name.clone(),
        position: [0.0; 3],
        forward: [0.0, 0.0, 1.0],
        up: DVec3::NEG_Y,
        fov_y_degrees: 50.0,
    };
    let viewpoints: Vec<Viewpoint> = views.iter().map(point).collect();
    let metrics = metrics(views, &format!("/captures/{}", NASTY.replace('/', "|")));
    let page = ReportPage {
        metrics: &metrics,
        history: &history(),
        viewer: Some(Viewer {
            scene: &scene(),
            source: SceneSource::Page,
            viewpoints: &viewpoints,
            background: [0.0; 3],
            antialias: false,
        }),
    };
    page.write(&out).unwrap();
    std::fs::read_to_string(out.join(REPORT)).unwrap()
}

/// Returns the page without comments and without the content of its scripts and styles, whose tags stay.
fn markup(page: &str) -> String {
    let mut rest = page.to_owned();
    while let Some((before, after)) = rest.split_once("<!--") {
        let (_, after) = after.split_once("-->").expect("a comment that ends");
        rest = format!("{before}{after}");
    }
    let mut text = String::new();
    for name in ["script", "style"] {
        text.clear();
        while let Some((before, after)) = rest.clone().split_once(&format!("<{name}")) {
            let (attributes, after) = after.split_once('>').unwrap();
            let (_, after) = after.split_once(&format!("</{name}>")).expect("an element that ends");
            text.push_str(&format!("{before}<{name}{attributes}></{name}>"));
            rest = after.to_owned();
        }
        text.push_str(&rest);
        rest.clone_from(&text);
    }
    text
}

/// Returns the names of a page's tags in their order, with a slash for those that end an element.
fn tags(markup: &str) -> Vec<&str> {
    markup.split('<').skip(1).map(|tag| tag.split([' ', '>', '\n']).next().unwrap()).collect()
}

#[test]
fn every_element_ends_where_it_should() {
    let page = page(vec![view(NASTY, 20.0), view("a.png", 19.0)]);
    let markup = markup(&page);
    let mut open = Vec::new();
    for tag in tags(&markup) {
        match tag.strip_prefix('/') {
            Some(name) => assert_eq!(open.pop(), Some(name), "in {open:?}"),
            None if ["!DOCTYPE", "meta", "img", "input"].contains(&tag) => {}
            None => open.push(tag),
        }
    }
    assert_eq!(open, [""; 0]);
    assert_eq!(
        markup.matches("<script").count(),
        7,
        "setup, scene, libraries, viewer, history, curves and page, and no script of others"
    );
    assert_eq!(markup.matches(" onerror=").count(), markup.matches("&gt;&lt;img src=x onerror=").count());
}

#[test]
fn every_test_view_is_there_the_worst_first() {
    let page = page(vec![view("b.png", 20.0), view("left/c.png", 30.0), view("a & b.png", 10.0)]);
    let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("no {part}"));
    let rows = [">a &amp; b.png</a></td><td class=\"number\">10.00", ">b.png</a></td><td class=\"number\">20.00"];
    assert!(at(rows[0]) < at(rows[1]) && at(rows[1]) < at("<td class=\"\">left/c.png</td><td class=\"number\">30.00"));
    assert_eq!(
        page.matches("src=\"data:image/jpeg;base64,").count(),
        4,
        "photograph and render of the two that have a picture"
    );
    assert!(page.contains("Pictures of 2 of 3 views"));
}

#[test]
fn captures_of_many_views_have_pictures_of_some() {
    let views = (0..60).map(|i| view(&format!("{i:02}.png"), 10.0 + f64::from(i))).collect();
    let page = page(views);
    for i in 0..60 {
        assert!(page.contains(&format!("{i:02}.png")), "{i}");
    }
    assert_eq!(page.matches("<figure id=").count(), MOST);
    assert!(page.contains("id=\"view-0\"") && page.contains("id=\"view-59\"") && !page.contains("id=\"view-30\""));
    assert!(page.contains("Pictures of 24 of 60 views: the 12 worst and the 12 best"));
}

#[test]
fn nothing_is_asked_of_others() {
    let page = page(vec![view("a.png", 20.0)]);
    let without_comments = page.split("<!--").map(|part| part.split_once("-->").map_or(part, |(_, after)| after));
    let text: String = without_comments.collect();
    // An XML namespace that three.js gives to elements it makes. Nothing fetches it.
    let text = text.replace("http://www.w3.org/1999/xhtml", "");
    for scheme in ["http:/", "https:/", "ws:/", "wss:/"] {
        if let Some(at) = text.find(scheme) {
            panic!("{scheme}: {}", &text[at.saturating_sub(60)..at + 60]);
        }
    }
    let markup = markup(&page);
    for attribute in ["src=\"", "href=\""] {
        for value in markup.split(attribute).skip(1) {
            assert!(value.starts_with("data:") || value.starts_with('#'), "{attribute}{}", &value[..40]);
        }
    }
    assert!(markup.contains("content=\"default-src 'none';"), "the browser sees to it too");
}

#[test]
fn the_script_reads_the_history_as_it_is() {
    let page = page(vec![view("a.png", 20.0), view("b.png", 21.0)]);
    let (_, text) = page.split_once("id=\"history\">").unwrap();
    let (read, last): (History, (f64, usize)) = serde_json::from_str(text.split_once("</script>").unwrap().0).unwrap();
    assert_eq!(read, history());
    assert_eq!(last, (20.0, 2));
}

#[test]
fn a_run_without_test_views_or_splats_has_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let out = OutputFolder::prepare(folder.path(), Inputs::default(), [""; 0], &[]).unwrap();
    let metrics = metrics(Vec::new(), "");
    let history = History::default();
    let page = ReportPage { metrics: &metrics, history: &history, viewer: None };
    let html = page.html(&Comparisons::default()).unwrap();
    assert!(html.contains("holds out no photograph") && html.contains("no splat that can be drawn"));
    page.write(&out).unwrap();
}
