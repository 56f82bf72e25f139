//! `report.html`: the report of a run on one page that loads no other file, neither from disk nor from a network.

mod comparisons;
mod sections;

use std::fmt::Write as _;
use std::io::Write as _;

use anyhow::Result;

use self::comparisons::Comparisons;
use super::history::History;
use super::html::{escape, in_script};
use super::metrics::Metrics;
use super::{REPORT, SCENE};
use crate::output::{OutputFolder, last_name};
use crate::view::page::{POLICY, STYLE, SceneSource, Viewer};
use crate::view::scene::{ShownScene, Viewpoint};

/// Largest size of the scene in a page; its text encoding is a third longer. Browsers are slow with longer pages.
pub const SCENE_BYTES: usize = 20_000_000;

/// Content of the page.
#[derive(Clone, Copy, Debug)]
pub struct ReportPage<'a> {
    pub metrics: &'a Metrics,
    pub history: &'a History,
    /// The scene; `None` if no splat can be drawn.
    pub scene: Option<&'a ShownScene>,
    /// Viewpoints of the test views, in the order of their scores.
    pub viewpoints: &'a [Viewpoint],
    /// Background, RGB, 0 to 1.
    pub background: [f32; 3],
    /// Whether the scene was trained with `--antialias`.
    pub antialias: bool,
}

impl ReportPage<'_> {
    /// Writes the page. Reads the pictures of the test views, which have been written before.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, out: &OutputFolder) -> Result<()> {
        let html = self.html(&Comparisons::of(self.metrics.test.as_ref(), out))?;
        out.write(REPORT, |file| Ok(file.write_all(html.as_bytes())?))
    }

    fn html(&self, comparisons: &Comparisons) -> Result<String> {
        let capture = self.metrics.options["capture"].as_str().unwrap_or_default();
        let name = last_name(capture.as_ref());
        let mut html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
             <meta name=\"viewport\" content=\"width=device-width\">\n<title>{} – splat</title>\n<style>\n{}{STYLE}</style>\n\
             </head>\n<body>\n<main>\n<h1>{}</h1>\n",
            escape(&name),
            PAGE_STYLE,
            escape(&name),
        );
        html.push_str(&sections::summary(self.metrics));
        html.push_str(CURVES);
        self.write_scene(&mut html)?;
        html.push_str(&sections::views(self.metrics.test.as_ref(), comparisons));
        html.push_str(&sections::effects(self.metrics.effects.as_ref()));
        html.push_str(&sections::times(&self.metrics.seconds));
        html.push_str(&sections::options(self.metrics)?);
        html.push_str("</main>\n");
        if let Some(viewer) = self.viewer() {
            html.push_str(&viewer.scripts()?);
        }
        let last = self.metrics.test.as_ref().map(|test| (test.psnr, test.views.len()));
        let data = in_script(&(self.history, last))?;
        write!(
            html,
            "<script type=\"application/json\" id=\"history\">{data}</script>\n<script>{CURVES_SCRIPT}</script>\n<script>{SCRIPT}</script>\n"
        )?;
        Ok(html + "</body>\n</html>\n")
    }

    fn viewer(&self) -> Option<Viewer<'_>> {
        let Self { viewpoints, background, antialias, .. } = *self;
        self.scene.map(|scene| Viewer { scene, source: SceneSource::Page, viewpoints, background, antialias })
    }

    fn write_scene(&self, html: &mut String) -> Result<()> {
        html.push_str("<section>\n<h2>Scene</h2>\n");
        match (self.viewer(), self.scene) {
            (Some(viewer), Some(scene)) => {
                html.push_str(&viewer.element());
                if scene.splats < scene.of || scene.sh_degree < scene.of_sh_degree {
                    writeln!(html, "<p>{}<code>splat view {SCENE}</code> shows more.</p>", scene.omissions())?;
                }
            }
            _ => html.push_str("<p>The scene holds no splat that can be drawn.</p>\n"),
        }
        html.push_str("</section>\n");
        Ok(())
    }
}

/// Style sheet of the page, for other pages too.
pub const PAGE_STYLE: &str = include_str!("page.css");
/// Section of the curves, and the script that draws them.
pub const CURVES: &str = include_str!("curves.html");
pub const CURVES_SCRIPT: &str = include_str!("curves.js");
const SCRIPT: &str = include_str!("page.js");

#[cfg(test)]
mod tests;
