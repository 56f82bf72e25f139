//! Interactive viewer of a scene, as parts of an HTML page.

use std::fmt::Write;

use anyhow::Result;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::DVec3;
use serde::Serialize;
use splat_op::RenderOptions;

use super::scene::{ShownScene, Viewpoint};
use crate::report::html::{escape, in_script};

/// JavaScript libraries; see `assets/viewer/README.md`.
const LIBRARY: &str = include_str!("../../assets/viewer/library.js");
/// Licences of the libraries, which go with every copy.
const LICENSES: &str = include_str!("../../assets/viewer/LICENSES.txt");
const SCRIPT: &str = include_str!("viewer.js");
const STYLE: &str = include_str!("viewer.css");

/// Content-Security-Policy of pages with a viewer: nothing is loaded from outside. The libraries run WebAssembly, in
/// workers that they make from text.
pub const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; \
     connect-src 'self' blob: data:; img-src data: blob:; style-src 'unsafe-inline'";

/// Location of the scene's data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SceneSource<'a> {
    /// In the page itself.
    Page,
    /// In the page itself as SOG, which is these bytes; the page shows nothing else.
    Whole(&'a [u8]),
    /// At a URL of the same server. The page saves camera paths in the world of the scene's file, whose rows are relative to this origin.
    Url(&'static str, DVec3),
    /// There too, and changing: an event `splat-scene` of the page's window names the URL of each new one.
    Live(&'static str),
}

/// A viewer of a scene.
#[derive(Clone, Copy, Debug)]
pub struct Viewer<'a> {
    pub scene: &'a ShownScene,
    pub source: SceneSource<'a>,
    /// Viewpoints to choose from, beginning at the first; without any, the scene is seen from outside.
    pub viewpoints: &'a [Viewpoint],
    /// Background, RGB, 0 to 1.
    pub background: [f32; 3],
    /// Whether the scene was trained with `--antialias`.
    pub antialias: bool,
}

/// Setup that `viewer.js` reads. Lengths are in scene units.
#[derive(Serialize)]
struct ViewerSetup<'a> {
    url: Option<&'static str>,
    /// The origin that camera paths are not relative to.
    origin: Option<[f64; 3]>,
    /// The library's name of the data's format.
    kind: &'static str,
    centre: [f64; 3],
    radius: f64,
    up: [f64; 3],
    cameras: &'a [Viewpoint],
    background: [f32; 3],
    antialias: bool,
    /// Variance of the blur, px².
    blur: f64,
    /// Whether the page scrolls.
    wheel_after_click: bool,
}

impl Viewer<'_> {
    /// Returns the HTML element that holds the picture.
    pub fn element(&self) -> String {
        let bar = match self.viewpoints {
            [] => String::new(),
            viewpoints if matches!(self.source, SceneSource::Whole(_)) => {
                let button =
                    |viewpoint: &Viewpoint| format!("<button type=\"button\">{}</button>", escape(&viewpoint.name));
                format!("<div id=\"viewer-views\">{}</div>", viewpoints.iter().map(button).collect::<String>())
            }
            viewpoints => {
                let option = |(i, viewpoint): (usize, &Viewpoint)| {
                    format!("<option value=\"{i}\">{}</option>", escape(&viewpoint.name))
                };
                let options: String = viewpoints.iter().enumerate().map(option).collect();
                format!(
                    "<div id=\"viewer-bar\"><select id=\"viewer-camera\" title=\"look from\">{options}</select></div>"
                )
            }
        };
        let wheel = if self.scrolls() { "wheel after a click" } else { "wheel" };
        let how = format!("drag to rotate, right button to pan, {wheel} to zoom");
        let (omissions, splats) = (self.scene.omissions(), self.scene.splats);
        let shown = match self.source {
            SceneSource::Live(_) => String::new(),
            _ if omissions.is_empty() => format!("{splats} splats. "),
            _ => omissions,
        };
        format!("<div id=\"viewer\"><p id=\"viewer-note\">{}{how}</p>{bar}</div>\n", escape(&shown))
    }

    /// Whether the viewer is part of a page that scrolls.
    fn scrolls(&self) -> bool {
        matches!(self.source, SceneSource::Page | SceneSource::Live(_))
    }

    /// Returns the scripts that must follow the element.
    pub fn scripts(&self) -> Result<String> {
        let outside = [Viewpoint::outside(&self.scene.extent)];
        let viewpoints = if self.viewpoints.is_empty() { &outside } else { self.viewpoints };
        let up: DVec3 = viewpoints.iter().map(|viewpoint| viewpoint.up).sum();
        let setup = ViewerSetup {
            url: match self.source {
                SceneSource::Page | SceneSource::Whole(_) => None,
                SceneSource::Url(url, _) | SceneSource::Live(url) => Some(url),
            },
            origin: if let SceneSource::Url(_, origin) = self.source { Some(origin.to_array()) } else { None },
            kind: if matches!(self.source, SceneSource::Whole(_)) { "pcsogszip" } else { "ply" },
            centre: self.scene.extent.centre.to_array(),
            radius: self.scene.extent.radius,
            // Cameras that look in all directions have no common up direction.
            up: up.try_normalize().unwrap_or(viewpoints[0].up).to_array(),
            cameras: viewpoints,
            background: self.background,
            antialias: self.antialias,
            blur: RenderOptions::standard().blur,
            wheel_after_click: self.scrolls(),
        };
        let mut text = format!("<!--\n{LICENSES}\n-->\n");
        writeln!(text, "<script type=\"application/json\" id=\"viewer-setup\">{}</script>", in_script(&setup)?)?;
        let inside = match self.source {
            SceneSource::Page => Some(&self.scene.ply[..]),
            SceneSource::Whole(sog) => Some(sog),
            SceneSource::Url(..) | SceneSource::Live(_) => None,
        };
        if let Some(bytes) = inside {
            text.push_str("<script type=\"text/plain\" id=\"viewer-scene\">");
            BASE64_STANDARD.encode_string(bytes, &mut text);
            text.push_str("</script>\n");
        }
        writeln!(text, "<script>{LIBRARY}</script>\n<script>{SCRIPT}</script>")?;
        Ok(text)
    }

    /// Returns a whole page that shows the scene and nothing else.
    pub fn page(&self, title: &str) -> Result<String> {
        Ok(document(title, include_str!("page.css"), &(self.element() + &self.scripts()?)))
    }
}

/// Returns a page with a viewer: its style sheet comes after `style`.
pub fn document(title: &str, style: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{}</title>\n<style>\n{style}{STYLE}</style>\n\
         </head>\n<body>\n{body}</body>\n</html>\n",
        escape(title)
    )
}

#[cfg(test)]
mod tests;
