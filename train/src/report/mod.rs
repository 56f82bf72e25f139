//! Output of a run besides the scene: `metrics.json`, pictures of the test views, `report.html`, and messages while it is in progress.

mod forecast;
pub mod history;
pub mod html;
pub mod log;
pub mod metrics;
pub mod page;
pub mod pictures;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use image::ImageFormat;
use splat_model::capture::Photograph;
use splat_model::effects::background::Background;
use splat_model::evaluate::{Scores, evaluate_each};
use splat_model::metrics::lpips::Lpips;
use splat_op::{RenderOptions, Splats};

pub use self::history::History;
pub use self::html::{escape, in_script, table};
pub use self::log::{LogLine, RunLog};
pub use self::metrics::{Metrics, Seconds, peak_rss_mib, seconds_since};
pub use self::page::{CURVES, CURVES_SCRIPT, PAGE_STYLE, ReportPage, SCENE_BYTES};
use crate::output::OutputFolder;
use crate::progress;

/// The trained scene.
pub const SCENE: &str = "scene.ply";
/// Scores, times and options.
pub const METRICS: &str = "metrics.json";
/// The report, for people.
pub const REPORT: &str = "report.html";
/// Poses of the photographs, where a run refined them.
pub const POSES: &str = "poses.json";
/// The folder of pictures.
pub const VIEWS: &str = "views";

/// Scores a scene on photographs, with LPIPS if it is given, and writes a comparison picture of each to `views/`. An
/// error if a view cannot be rendered or a picture cannot be written.
pub fn measure(
    splats: &Splats,
    photos: &[Photograph],
    background: &Background,
    options: &RenderOptions,
    lpips: Option<&Lpips>,
    out: &OutputFolder,
) -> Result<Scores> {
    let names = pictures::names(photos.iter().map(|photo| photo.name.as_str()), "png");
    let mut names = names.iter();
    let mut written = Ok(());
    let counter = progress::counter("measuring test views", photos.len());
    let pixels = photos.iter().map(|photo| Ok::<_, anyhow::Error>(photo.pixels()?));
    let scores = evaluate_each(splats, pixels, background, options, lpips, |comparison, _| {
        if let (Ok(()), Some(name)) = (&written, names.next()) {
            written = out.write(Path::new(VIEWS).join(name), |file| {
                Ok(pictures::comparison(comparison).write_to(file, ImageFormat::Png)?)
            });
        }
        counter.inc(1);
    });
    written?;
    scores
}

/// The pictures of test views, below the output folder.
pub fn view_files<'a>(views: impl IntoIterator<Item = &'a str>) -> impl Iterator<Item = PathBuf> {
    pictures::names(views, "png").into_iter().map(|name| Path::new(VIEWS).join(name))
}

/// Writes `metrics.json`.
pub fn finish(metrics: &Metrics, out: &OutputFolder) -> Result<()> {
    out.write(METRICS, |file| {
        serde_json::to_writer_pretty(&mut *file, metrics)?;
        Ok(file.write_all(b"\n")?)
    })
}

/// Prints the scores and the location of all files.
pub fn say(metrics: &Metrics, scene: &Path, out: &OutputFolder) {
    match &metrics.test {
        Some(test) => {
            let (count, s) = (test.views.len(), if test.views.len() == 1 { "" } else { "s" });
            progress::say(&format!("test: {:.2} dB PSNR, {:.4} SSIM, mean of {count} view{s}", test.psnr, test.ssim));
            let (psnr, ssim) = (test.psnr_corrected, test.ssim_corrected);
            progress::say(&format!("after colour correction: {psnr:.2} dB PSNR, {ssim:.4} SSIM"));
            progress::say(&format!("LPIPS: {}", perceived(test)));
        }
        None => progress::say("test: none, because `--test-every 0` holds out no photograph"),
    }
    let seconds = &metrics.seconds;
    let train = seconds.train.map(|train| format!("training {train:.1} s, ")).unwrap_or_default();
    progress::say(&format!("time: loading {:.1} s, {train}measuring {:.1} s", seconds.load, seconds.eval));
    progress::say(&format!("scene: {} ({} splats)", scene.display(), metrics.splats));
    progress::say(&format!("metrics: {}", out.join(METRICS).display()));
    if metrics.steps.is_some() {
        progress::say(&format!("report: {}", out.join(REPORT).display()));
    }
    if metrics.test.is_some() {
        progress::say(&format!("pictures (truth | render | error): {}", out.join(VIEWS).display()));
    }
}

/// Formats the mean LPIPS with its network, or the reason why it was not measured.
fn perceived(scores: &Scores) -> String {
    let Scores { lpips, lpips_missing, lpips_net, .. } = scores;
    let of = |text: &Option<String>| text.clone().unwrap_or_default();
    match lpips {
        Some(lpips) => format!("{lpips:.4} (network {})", of(lpips_net)),
        None => format!("not measured: {}", of(lpips_missing)),
    }
}
