//! `splat demo`: writes the demo capture.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use splat_demo::{self as demo, DemoOptions};
use splat_model::capture::Capture;

use crate::{output, progress};

/// Marks a folder as a demo capture and records the options it was made with.
const MARK: &str = "demo.json";

/// Options of `splat demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct DemoArgs {
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub effects: DemoOptions,
    /// Number of photographs
    #[arg(long, value_name = "N", help = usual("Number of photographs", |options| options.views))]
    pub views: Option<usize>,
    /// Number of sparse points
    #[arg(long, value_name = "N", help = usual("Number of sparse points", |options| options.points))]
    pub points: Option<usize>,
    /// Width of the photographs, px
    #[arg(long, value_name = "PX", help = usual("Width of the photographs, px", |options| options.width))]
    pub width: Option<usize>,
    /// Height of the photographs, px
    #[arg(long, value_name = "PX", help = usual("Height of the photographs, px", |options| options.height))]
    pub height: Option<usize>,
    /// Seed of the cameras, the choice of sparse points, and the random draws of each effect
    #[arg(long, value_name = "S", default_value_t = DemoOptions::default().seed)]
    pub seed: u64,
}

/// Help on an option whose default depends on `--town`.
fn usual(what: &str, of: fn(&DemoOptions) -> usize) -> String {
    format!("{what} [default: {}; with --town {}]", of(&DemoOptions::PLAIN), of(&DemoOptions::TOWN))
}

impl DemoArgs {
    /// Returns the options in the library's type.
    pub fn options(&self) -> DemoOptions {
        let usual = if self.effects.town { DemoOptions::TOWN } else { DemoOptions::PLAIN };
        DemoOptions {
            width: self.width.unwrap_or(usual.width),
            height: self.height.unwrap_or(usual.height),
            views: self.views.unwrap_or(usual.views),
            points: self.points.unwrap_or(usual.points),
            seed: self.seed,
            ..self.effects
        }
    }
}

/// Writes the capture and prints its folder.
pub fn run(args: &DemoArgs) -> Result<()> {
    let made = ensure(&args.out, &args.options())?;
    let what = if made { "demo capture" } else { "demo capture, unchanged" };
    progress::say(&format!("{what}: {}", args.out.display()));
    Ok(())
}

/// Writes the demo capture into `folder`, unless the same one is already there and complete; returns whether it wrote.
///
/// Everything is made in a hidden folder first, so that files under their own names are complete. If the process is
/// killed meanwhile, the hidden folder stays. An error if an option is out of range, two exclude each other, the folder
/// holds anything else where the capture is to be, or it cannot be written.
pub fn ensure(folder: &Path, options: &DemoOptions) -> Result<bool> {
    if is_complete(folder, options) {
        return Ok(false);
    }
    for taken in demo::PARTS.iter().chain(&[MARK]).map(|name| folder.join(name)) {
        ensure!(
            !taken.exists(),
            "{} already exists, and is not of this demo capture: choose another folder with `--out`, or move it away",
            taken.display()
        );
    }
    progress::note("making the demo capture");
    let shown = folder.display();
    make(folder, options).with_context(|| {
        format!("cannot make the demo capture in {shown}: fix the problem named below, or choose another `--out`")
    })?;
    Ok(true)
}

/// Makes the capture beside its place and moves it there. The model is moved last, so that the capture never looks complete before.
fn make(folder: &Path, options: &DemoOptions) -> Result<()> {
    fs::create_dir_all(folder)?;
    let temporary = tempfile::Builder::new().prefix(".demo.tmp-").tempdir_in(folder)?;
    let temporary = temporary.path();
    demo::write(temporary, options)?;
    output::write(&folder.join(MARK), |file| Ok(serde_json::to_writer_pretty(file, &made_with(options))?))?;
    for name in demo::PARTS {
        let (source, target) = (temporary.join(name), folder.join(name));
        if source.exists() {
            fs::rename(source, &target).with_context(|| format!("cannot write {}", target.display()))?;
        }
    }
    Ok(())
}

/// Everything that the content of a demo capture depends on: the options, and the version of the program under `splat demo`.
fn made_with(options: &DemoOptions) -> Value {
    let mut made_with = json!(options);
    made_with["splat demo"] = env!("CARGO_PKG_VERSION").into();
    made_with
}

fn is_complete(folder: &Path, options: &DemoOptions) -> bool {
    let mark = fs::read(folder.join(MARK)).ok().and_then(|text| serde_json::from_slice::<Value>(&text).ok());
    mark == Some(made_with(options))
        && Capture::load(folder).is_ok_and(|capture| capture.views.len() == options.views)
        && demo::files(options).iter().all(|file| folder.join(file).is_file())
}

#[cfg(test)]
mod tests;
