//! `splat pareto`: measures the time and the error of every dial, on a given scene and device.

mod csv;
mod dials;
mod errors;
mod measure;
mod quartiles;
mod reference;
mod subject;

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::builder::RangedU64ValueParser;
use splat_model::evaluate::evaluate;

use self::dials::candidates;
use self::measure::{Bench, BenchOutcome, SettingMeasurements};
use self::quartiles::frontier;
use crate::background::ShowArgs;
use crate::input::PhotoArgs;
use crate::inputs::Inputs;
use crate::output::OutputFolder;
use crate::{input, progress};

/// The measurements, a line per setting.
pub const TABLE: &str = "pareto.csv";

/// Quartiles of fewer rounds than this are unreliable.
const FEW_ROUNDS: usize = 8;

/// Options of `splat pareto`.
#[derive(Clone, Debug, clap::Args)]
pub struct ParetoArgs {
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`
    pub capture: PathBuf,
    /// Scene file, in any format that `convert` reads
    #[arg(long, value_name = "FILE")]
    pub scene: PathBuf,
    /// Folder for pareto.csv
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Seconds to spend on timing; every setting is timed at least three times
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    pub budget: u64,
    /// Number of test views to measure, spread evenly
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub views: usize,
    #[command(flatten)]
    pub photos: PhotoArgs,
    #[command(flatten)]
    pub show: ShowArgs,
    /// Ignore the pixels that the capture's masks exclude; for scenes trained with the effect `masks`
    #[arg(long)]
    pub masks: bool,
}

/// Measures all settings, writes the table, and prints the frontier. An error if the capture or the scene cannot be
/// read, no photograph is held out, a setting is broken, or the results cannot be written.
pub fn run(args: &ParetoArgs) -> Result<()> {
    let (device, _) = args.show.device.resolve()?;
    let capture = input::capture(&args.capture)?;
    let (split, _) = args.photos.split(&capture);
    let views = spread(split.require_test()?, args.views);
    let (rows, trained, _) = input::rows("--scene", &args.scene, Some(&capture))?;
    let background = args.show.background(&args.scene, &trained)?;
    let inputs = Inputs::of([&args.scene]).and_capture(&capture).and(args.show.file());
    let out = OutputFolder::prepare(&args.out, inputs, [TABLE], &[])?;
    let photos = input::photographs(&capture, &views, args.photos.max_side, args.masks)?;
    let base = args.show.model.or(&trained).config().render_options(input::extent(&capture));
    let bench = Bench::new(&rows, &photos, background.colour(), base, &device)?;
    let all = candidates(&base, splat_op::is_gpu(&device));
    progress::note(&format!("{} settings, {} views of {} splats", all.len(), photos.len(), rows.len()));
    let outcome = bench.run(all, Duration::from_secs(args.budget), |options| {
        let scores = evaluate(&bench.place.splats, &photos, &background, options, |_, _| ())?;
        Ok((scores.psnr, scores.ssim))
    })?;

    // Model choices are not on the frontier: they have no error to be placed by.
    let point = |row: &SettingMeasurements| (row.error_db().unwrap_or(f64::NAN), row.times.forward);
    let members = frontier(&outcome.rows.iter().map(point).collect::<Vec<_>>());
    let table = csv::text(&outcome.rows, &members);
    out.write(TABLE, |file| Ok(file.write_all(table.as_bytes())?))?;
    say(&out, &outcome, &members);
    Ok(())
}

/// Returns up to `count` of the views, spread evenly.
fn spread(views: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(views.len());
    (0..count).map(|i| views[i * views.len() / count]).collect()
}

fn say(out: &OutputFolder, outcome: &BenchOutcome, members: &[usize]) {
    let BenchOutcome { rows, reference, rounds } = outcome;
    let few = if *rounds < FEW_ROUNDS { ": few, raise `--budget` before believing small differences" } else { "" };
    progress::say(&format!("measured every setting {rounds} times, in turns{few}"));
    progress::say(&format!("the float64 reference is within {reference:.0e} of the exact renderer"));
    progress::say("the frontier of renders, from accurate to fast:");
    for row in members.iter().map(|&i| &rows[i]) {
        let (db, ms) = (row.error_db().unwrap_or(f64::NAN), row.times.forward.median);
        progress::say(&format!("  {db:6.1} dB {ms:9.2} ms  {} ({})", row.candidate.name, row.candidate.setting));
    }
    progress::say(&out.join(TABLE).display().to_string());
}

#[cfg(test)]
mod tests;
