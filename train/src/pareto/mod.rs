//! `splat pareto`: measures the time and the error of every dial, on a given scene and device.

mod csv;
mod dials;
mod errors;
mod formats;
mod measure;
mod page;
pub mod plot;
mod quartiles;
mod reference;
mod subject;
mod time;
mod training;

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use burn::tensor::Device;
use clap::builder::RangedU64ValueParser;
use splat_model::capture::{Capture, Photo, Split};
use splat_model::evaluate::evaluate;
use splat_model::gaussians::GaussianRows;
use splat_op::{RenderOptions, Splats};

use self::dials::{Role, candidates};
use self::errors::MeasuredError;
use self::formats::StoredScene;
use self::measure::{Bench, BenchOutcome, SettingMeasurements};
use self::plot::{Chart, Dot, DotMark};
use self::quartiles::{Quartiles, decibels, frontier};
use self::subject::{DeviceScene, MeasuredView, off_the_clamp};
use self::time::FrameTimes;
use self::training::{Runs, TrainingResult};
use crate::accuracy::ModelArgs;
use crate::background::ShownBackground;
use crate::device::{self, DeviceName};
use crate::inputs::Inputs;
use crate::options::PhotoArgs;
use crate::output::{OutputFolder, last_name};
use crate::{input, progress};

/// The measurements, a line per setting.
pub const TABLE: &str = "pareto.csv";
/// The tables and their summary.
pub const PAGE: &str = "pareto.md";
/// Plot of time against error, as SVG and as PNG.
pub const PLOT: [&str; 2] = ["pareto.svg", "pareto.png"];
/// Plot of bytes a splat against error, as SVG and as PNG.
pub const FORMATS_PLOT: [&str; 2] = ["pareto_formats.svg", "pareto_formats.png"];
/// Plot of seconds of training against PSNR, as SVG and as PNG.
pub const TRAIN_PLOT: [&str; 2] = ["pareto_train.svg", "pareto_train.png"];

/// Options of `splat pareto`.
#[derive(Clone, Debug, clap::Args)]
pub struct ParetoArgs {
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`
    pub capture: PathBuf,
    /// Scene file, in any format that `convert` reads
    #[arg(long, value_name = "FILE")]
    pub scene: PathBuf,
    /// Folder for pareto.md, pareto.csv and the plots
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Device to measure; the exact reference is computed on the CPU in float64
    #[arg(long, value_name = "NAME", default_value_t, help = device::help())]
    pub device: DeviceName,
    /// Seconds to spend on timing; every setting is timed at least three times
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    pub budget: u64,
    /// Number of test views to measure, spread evenly
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub views: usize,
    /// Photographs.
    #[command(flatten)]
    pub photos: PhotoArgs,
    /// Model choices.
    #[command(flatten)]
    pub model: ModelArgs,
    /// Background behind the scene: black, white, R,G,B from 0 to 1, or the background.json of a training run [default: that of the
    /// scene's training]
    #[arg(long, value_name = "WHAT")]
    pub background: Option<ShownBackground>,
    /// Ignore the pixels that the capture's masks exclude; for scenes trained with the effect `masks`
    #[arg(long)]
    pub masks: bool,
    /// Also measure the training dials, by short training runs
    #[arg(long)]
    pub train: bool,
    /// With `--train`: steps of each run
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub train_steps: usize,
}

/// Measures all settings, writes all files, and prints their location.
///
/// # Errors
/// If the capture or the scene cannot be read, no photograph is held out, a setting is broken, or the results cannot be written.
pub fn run(args: &ParetoArgs) -> Result<()> {
    let (device, device_name) = args.device.resolve()?;
    let capture = input::capture(&args.capture)?;
    let (split, _) = args.photos.split(&capture);
    let views = spread(split.require_test()?, args.views);
    let (rows, trained) = input::rows("--scene", &args.scene, &capture)?;
    let background = ShownBackground::read(args.background.as_ref(), &args.scene, &trained)?;
    let out = prepare(args, &capture)?;
    let photos = input::photographs(&capture, &views, args.photos.max_side, args.masks)?;
    let shots: Vec<MeasuredView> = photos.iter().map(MeasuredView::from).collect();
    let extent = input::extent(&capture);
    let base = args.model.or(&trained).config().render_options(extent);
    let bench = Bench::new(&rows, shots, background.colour(), base, &device)?;
    let all = candidates(&base, splat_op::is_gpu(&device));
    progress::note(&format!("{} settings, {} views of {} splats", all.len(), photos.len(), rows.len()));
    let score = |splats: &Splats, options: &RenderOptions| -> Result<_> {
        let scores = evaluate(splats, &photos, &background, options, |_, _| ())?;
        Ok((scores.psnr, scores.ssim))
    };
    let outcome =
        bench.run(all, Duration::from_secs(args.budget), |options| Ok(Some(score(&bench.place.splats, options)?)))?;
    let trial = tempfile::tempdir().context("cannot make a temporary folder")?;
    let stored = formats::measure(&bench, &rows, &trial.path().join("scene"), |splats| score(splats, &base))?;
    let trained = if args.train { train(args, &capture, &split, &photos, &device)? } else { Vec::new() };

    let subject = page::PageSubject {
        capture: last_name(&args.capture),
        scene: last_name(&args.scene),
        device: &device_name,
        splats: rows.len(),
        views: photos.iter().map(|photo| photo.name.clone()).collect(),
        size: photos.iter().map(|photo| (photo.intrinsics.width, photo.intrinsics.height)).max().unwrap_or_default(),
        base,
    };
    write(&out, &subject, (&outcome, &stored), &trained)?;
    say(&out, &outcome, &trained);
    Ok(())
}

/// Returns up to `count` of the views, spread evenly.
fn spread(views: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(views.len());
    (0..count).map(|i| views[i * views.len() / count]).collect()
}

fn prepare(args: &ParetoArgs, capture: &Capture) -> Result<OutputFolder> {
    let mut files = [&[TABLE, PAGE], &PLOT[..], &FORMATS_PLOT].concat();
    files.extend(args.train.then_some(TRAIN_PLOT).into_iter().flatten());
    let inputs = Inputs::default()
        .and_scene(&args.scene)
        .and_capture(capture)
        .and(args.background.as_ref().and_then(ShownBackground::file));
    OutputFolder::prepare(&args.out, inputs, &files, &[])
}

impl<'a> Bench<'a> {
    /// Prepares a scene and views of it over a colour.
    ///
    /// # Errors
    /// If the rows do not fit together, or there is no view.
    fn new(
        rows: &GaussianRows,
        shots: Vec<MeasuredView<'a>>,
        background: [f32; 3],
        base: RenderOptions,
        device: &Device,
    ) -> Result<Self> {
        ensure!(!shots.is_empty(), "there is no view to measure with");
        let rows = off_the_clamp(rows);
        let place = DeviceScene::new(&rows, &shots, background, device)?;
        Ok(Self { place, exact: DeviceScene::in_f64(&rows, &shots, background)?, shots, base })
    }
}

fn train(
    args: &ParetoArgs,
    capture: &Capture,
    split: &Split,
    test: &[Photo],
    device: &Device,
) -> Result<Vec<TrainingResult>> {
    let photos = input::photographs(capture, split.require_train()?, args.photos.max_side, args.masks)?;
    let config = args.model.config().with_steps(args.train_steps);
    let extent = input::extent(capture);
    Runs { train: &photos, test, points: &capture.points, extent, config, device }.all()
}

/// Rows on the frontier of renders, and rows on the frontier of training steps.
fn members(outcome: &BenchOutcome) -> [Vec<usize>; 2] {
    let of = |error: fn(&MeasuredError) -> f64, time: fn(&FrameTimes) -> Quartiles| {
        // Model choices are not on it: they have no error to be placed by.
        let quality_db = |row: &SettingMeasurements| row.accuracy.as_ref().map_or(f64::NAN, |a| decibels(error(a)));
        frontier(&outcome.rows.iter().map(|row| (quality_db(row), time(&row.times))).collect::<Vec<_>>())
    };
    [of(|accuracy| accuracy.rms, |times| times.forward), of(|accuracy| accuracy.gradient_error, |times| times.step)]
}

fn write(
    out: &OutputFolder,
    subject: &page::PageSubject,
    (outcome, stored): (&BenchOutcome, &[StoredScene]),
    trained: &[TrainingResult],
) -> Result<()> {
    let [render, step] = members(outcome);
    let put = |name: &str, bytes: &[u8]| out.write(name, |file| Ok(file.write_all(bytes)?));
    put(TABLE, csv::text(&outcome.rows, &render).as_bytes())?;
    let (formats, title) = (formats::section(stored), format!("{} ({} splats)", subject.capture, subject.splats));
    put(PAGE, page::page(subject, outcome, [&render, &step], &[&formats, &page::training(trained)]).as_bytes())?;
    let charts = [
        (PLOT, Some(chart(subject, outcome, &render))),
        (FORMATS_PLOT, Some(formats::chart(stored, title))),
        (TRAIN_PLOT, train_chart(trained)),
    ];
    for ([svg, png], chart) in charts {
        // Plots of an earlier run stay: no mark in them says who made them.
        if let Some(chart) = chart {
            put(svg, plot::svg(&chart)?.as_bytes())?;
            put(png, &plot::png(&chart)?)?;
        }
    }
    Ok(())
}

fn chart(subject: &page::PageSubject, outcome: &BenchOutcome, members: &[usize]) -> Chart {
    let dot = |(i, row): (usize, &SettingMeasurements)| {
        let time = row.times.forward;
        Some(Dot {
            name: row.candidate.name.clone(),
            mark: match row.candidate.role {
                Role::Preset => DotMark::Preset,
                Role::Dial(_) => DotMark::Dial,
                Role::Combination => DotMark::Combination,
            },
            x: [time.lower, time.median, time.upper],
            y: row.error_db()?,
            member: members.contains(&i),
        })
    };
    Chart {
        title: format!("{} ({} splats), {}", subject.capture, subject.splats, subject.device),
        x: "time of a frame, ms (median and quartiles)",
        y: "PSNR against the exact render, dB",
        dots: outcome.rows.iter().enumerate().filter_map(dot).collect(),
    }
}

fn train_chart(trained: &[TrainingResult]) -> Option<Chart> {
    let members = frontier(&trained.iter().map(|run| (run.psnr.median, run.seconds)).collect::<Vec<_>>());
    let dot = |(i, run): (usize, &TrainingResult)| Dot {
        name: run.name.into(),
        mark: if i == 0 { DotMark::Preset } else { DotMark::Dial },
        x: [run.seconds.lower, run.seconds.median, run.seconds.upper],
        y: run.psnr.median,
        member: members.contains(&i),
    };
    (!trained.is_empty()).then(|| Chart {
        title: "training under its dials".into(),
        x: "training, s (median and quartiles)",
        y: "PSNR of the test photographs, dB",
        dots: trained.iter().enumerate().map(dot).collect(),
    })
}

fn say(out: &OutputFolder, outcome: &BenchOutcome, trained: &[TrainingResult]) {
    let [render, _] = members(outcome);
    progress::say("the frontier of renders, from accurate to fast:");
    for row in render.iter().map(|&i| &outcome.rows[i]) {
        let (db, ms) = (row.error_db().unwrap_or(f64::NAN), row.times.forward.median);
        progress::say(&format!("  {db:6.1} dB {ms:9.2} ms  {} ({})", row.candidate.name, row.candidate.setting));
    }
    for name in [PAGE, TABLE].into_iter().chain(PLOT).chain(FORMATS_PLOT).chain(TRAIN_PLOT) {
        if !trained.is_empty() || !TRAIN_PLOT.contains(&name) {
            progress::say(&out.join(name).display().to_string());
        }
    }
}

#[cfg(test)]
mod tests;
