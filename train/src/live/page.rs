//! The page of a run in progress.

use std::path::Path;

use anyhow::Result;

use super::shared::SCENE;
use crate::output::last_name;
use crate::report::html::escape;
use crate::report::page::{CURVES, CURVES_SCRIPT, PAGE_STYLE};
use crate::view::page::{STYLE, SceneSource, Viewer};
use crate::view::scene::{ShownScene, Viewpoint};

/// Content of the page that does not change during the run.
#[derive(Clone, Copy, Debug)]
pub struct LivePage<'a> {
    /// Output folder of the run.
    pub out: &'a Path,
    /// The scene at the start, for its position and size.
    pub scene: &'a ShownScene,
    /// Viewpoints of the test views.
    pub viewpoints: &'a [Viewpoint],
    /// Background, RGB, 0 to 1.
    pub background: [f32; 3],
    /// Whether the scene is trained with `--antialias`.
    pub antialias: bool,
}

impl LivePage<'_> {
    /// Returns the page.
    ///
    /// # Errors
    /// If the viewer's setup cannot be written as JSON; no such case is known.
    pub fn html(&self) -> Result<String> {
        let Self { out, scene, viewpoints, background, antialias } = *self;
        let viewer = Viewer {
            scene,
            source: SceneSource::Live(SCENE.trim_start_matches('/')),
            viewpoints,
            background,
            antialias,
        };
        let name = escape(&last_name(out));
        Ok(format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width\">\n<title>{name} – splat</title>\n\
             <style>\n{PAGE_STYLE}{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{name}</h1>\n{TILES}\
             <section>\n<h2>Scene</h2>\n{}</section>\n{CURVES}{WORST}</main>\n{}\
             <script>{CURVES_SCRIPT}</script>\n<script>{SCRIPT}</script>\n</body>\n</html>\n",
            viewer.element(),
            viewer.scripts()?,
        ))
    }
}

/// The numbers and the button.
const TILES: &str = "<ul class=\"tiles\">\n\
    <li><strong id=\"live-step\">–</strong> steps</li>\n\
    <li><strong id=\"live-left\">–</strong> left</li>\n\
    <li><strong id=\"live-seconds\">–</strong> training</li>\n\
    <li><strong id=\"live-splats\">–</strong> splats</li>\n\
    <li><strong id=\"live-loss\">–</strong> loss</li>\n\
    <li><strong id=\"live-psnr\">–</strong> PSNR of the test views</li>\n\
    </ul>\n<p><button id=\"live-stop\">Stop and keep</button> <span id=\"live-note\"></span></p>\n";

const WORST: &str = "<section id=\"live-worst\" hidden>\n<h2>Worst test view so far: photograph, render, error</h2>\n\
    <p id=\"live-worst-name\"></p>\n<img id=\"live-worst-picture\" alt=\"photograph, render and error of the worst test view\">\n</section>\n";

const SCRIPT: &str = include_str!("live.js");
