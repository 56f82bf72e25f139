//! `report.html`: the report of a run on one page that loads no other file, neither from disk nor from a network.

mod comparisons;
mod sections;

use std::fmt::Write as _;
use std::io::Write as _;

use anyhow::Result;

use self::comparisons::Comparisons;
use super::{History, Metrics, REPORT, SCENE, escape, in_script};
use crate::output::{OutputFolder, last_name};
use crate::view::{Viewer, document};

/// Largest size of the scene in a page; its text encoding is a third longer. Browsers are slow with longer pages.
pub const SCENE_BYTES: usize = 20_000_000;

#[derive(Clone, Copy, Debug)]
pub struct ReportPage<'a> {
    pub metrics: &'a Metrics,
    pub history: &'a History,
    /// Viewer of the scene from the test views, in the order of their scores; `None` if no splat can be drawn.
    pub viewer: Option<Viewer<'a>>,
}

impl ReportPage<'_> {
    /// Writes the page. Reads the pictures of the test views, which have been written before.
    pub fn write(&self, out: &OutputFolder) -> Result<()> {
        let html = self.html(&Comparisons::of(self.metrics.test.as_ref(), out))?;
        out.write(REPORT, |file| Ok(file.write_all(html.as_bytes())?))
    }

    fn html(&self, comparisons: &Comparisons) -> Result<String> {
        let capture = self.metrics.options["capture"].as_str().unwrap_or_default();
        let name = last_name(capture.as_ref());
        let mut body = format!("<main>\n<h1>{}</h1>\n{}{CURVES}", escape(&name), sections::summary(self.metrics));
        self.write_scene(&mut body)?;
        body.push_str(&sections::views(self.metrics.test.as_ref(), comparisons));
        body.push_str(&sections::effects(self.metrics.effects.as_ref()));
        body.push_str(&sections::times(&self.metrics.seconds));
        body.push_str(&sections::options(self.metrics)?);
        body.push_str("</main>\n");
        if let Some(viewer) = self.viewer {
            body.push_str(&viewer.scripts()?);
        }
        let last = self.metrics.test.as_ref().map(|test| (test.psnr, test.views.len()));
        let data = in_script(&(self.history, last))?;
        writeln!(body, "<script type=\"application/json\" id=\"history\">{data}</script>")?;
        writeln!(body, "<script>{CURVES_SCRIPT}</script>\n<script>{}</script>", include_str!("page.js"))?;
        Ok(document(&format!("{name} – splat"), PAGE_STYLE, &body))
    }

    fn write_scene(&self, html: &mut String) -> Result<()> {
        html.push_str("<section>\n<h2>Scene</h2>\n");
        match self.viewer {
            Some(viewer) => {
                html.push_str(&viewer.element());
                let omissions = viewer.scene.omissions();
                if !omissions.is_empty() {
                    writeln!(html, "<p>{omissions}<code>splat view {SCENE}</code> shows more.</p>")?;
                }
            }
            None => html.push_str("<p>The scene holds no splat that can be drawn.</p>\n"),
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

#[cfg(test)]
mod tests;
