//! `splat eval`: scores a scene on the held-out photographs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use serde::Serialize;
use splat_model::accuracy::Setting;
use splat_model::capture::{Photo, Photograph};
use splat_model::gaussians::Gaussians;
use splat_op::Intrinsics;

use crate::accuracy::AccuracyArgs;
use crate::background::{ShowArgs, ShownBackground};
use crate::input::{self, PhotoArgs};
use crate::inputs::Inputs;
use crate::lpips::LpipsArgs;
use crate::output::OutputFolder;
use crate::report::{self, METRICS, Metrics, Seconds, VIEWS, peak_rss_mib, seconds_since};

/// Options of `splat eval`. The scores equal those of the training run if the photographs are split and sized alike.
#[derive(Clone, Debug, clap::Args)]
pub struct EvalArgs {
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`
    pub capture: PathBuf,
    /// Scene file, in any format that `convert` reads
    #[arg(long, value_name = "FILE")]
    pub scene: PathBuf,
    /// Folder for metrics.json and views/
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub photos: PhotoArgs,
    #[command(flatten)]
    pub show: ShowArgs,
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
    /// Compare as from further away: average each N × N pixels of the photographs to one
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=64))]
    pub shrink: usize,
    /// Ignore the pixels that the capture's masks exclude; for scenes trained with the effect `masks`
    #[arg(long)]
    pub masks: bool,
    /// Treat photographs as opaque, whatever their alpha channels hold; for scenes trained without the effect `alpha`
    #[arg(long)]
    pub ignore_alpha: bool,
    #[command(flatten)]
    pub lpips: LpipsArgs,
}

/// The `options` of `metrics.json`.
#[derive(Serialize)]
struct EvalOptionsRecord<'a> {
    capture: &'a Path,
    scene: &'a Path,
    #[serde(flatten)]
    photos: &'a PhotoArgs,
    antialias: bool,
    dials: &'a Setting,
    masks: bool,
    ignore_alpha: bool,
    shrink: usize,
    background: Option<&'a ShownBackground>,
    #[serde(flatten)]
    lpips: &'a LpipsArgs,
}

/// Measures the scores, writes all files, and prints their location. An error if the capture or the scene cannot be
/// read, no photograph is held out, or a result is one of the files that are read or cannot be written.
pub fn run(args: &EvalArgs) -> Result<Metrics> {
    let (device, device_name) = args.show.device.resolve()?;
    let lpips = args.lpips.read(&device)?;
    let start = Instant::now();
    let capture = input::capture(&args.capture)?;
    let (split, photo_args) = args.photos.split(&capture);
    let test = split.require_test()?;
    let (rows, trained, _) = input::rows("--scene", &args.scene, Some(&capture))?;
    let background = args.show.background(&args.scene, &trained)?;
    let config = args.show.model.or(&trained).config();
    let mut photos = input::photographs(&capture, test, args.photos.max_side, args.masks)?;
    if args.ignore_alpha {
        photos.iter_mut().for_each(|photo| photo.alpha = None);
    }
    if args.shrink > 1 {
        let small = |photo: &Photo| {
            let Intrinsics { width, height, .. } = photo.intrinsics;
            photo.box_filtered(args.shrink).with_context(|| {
                format!("{} is {width} x {height} px, too small for `--shrink {}`", photo.name, args.shrink)
            })
        };
        photos = photos.iter().map(small).collect::<Result<_>>()?;
    }
    let inputs = Inputs::of([&args.scene]).and_capture(&capture);
    let inputs = inputs.and(args.show.file()).and(&args.lpips.lpips);
    let views = report::view_files(photos.iter().map(|photo| photo.name.as_str()));
    let out = OutputFolder::prepare(&args.out, inputs, views.chain([METRICS.into()]), &[VIEWS])?;
    let culled_non_finite = rows.unusable();
    let load = seconds_since(start);
    let dials = args.accuracy.accuracy.setting();
    let render_options = dials.apply(config.render_options(input::extent(&capture)));
    let start = Instant::now();
    let splats = Gaussians::from_own_rows(rows, &device)?.splats();
    let load = load + seconds_since(start);
    let photos: Vec<Photograph> = photos.into_iter().map(Photograph::from).collect();
    let start = Instant::now();
    let scores = report::measure(&splats, &photos, &background, &render_options, lpips.as_ref(), &out)?;
    let eval = seconds_since(start);
    let options = EvalOptionsRecord {
        capture: &args.capture,
        scene: &args.scene,
        photos: &photo_args,
        antialias: config.antialias,
        dials: &config.dials.and(&dials),
        masks: args.masks,
        ignore_alpha: args.ignore_alpha,
        shrink: args.shrink,
        background: args.show.background.as_ref(),
        lpips: &args.lpips,
    };
    let metrics = Metrics {
        test: Some(scores),
        splats: splats.means.dims()[0],
        culled_non_finite,
        seconds: Seconds { load, eval, ..Seconds::default() },
        peak_rss_mib: peak_rss_mib(),
        device: device_name,
        options: serde_json::to_value(options)?,
        version: env!("CARGO_PKG_VERSION"),
        ..Metrics::default()
    };
    report::finish(&metrics, &out)?;
    report::say(&metrics, &args.scene, &out);
    Ok(metrics)
}
