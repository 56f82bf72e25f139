//! Shows what a run of `splat train --snapshots` kept, in the Rerun viewer or in a file for it; see `docs/RERUN.md`.

mod run;
mod show;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};
use std::process;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Parser;
use re_sdk::{RecordingStream, RecordingStreamBuilder};

use self::run::Folder;
use self::show::Shown;

/// Time between looks at the folder of a run that goes on.
const BETWEEN_LOOKS: Duration = Duration::from_secs(1);

/// Show what a run of `splat train --snapshots` kept, in the Rerun viewer.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// The run's output folder
    out: PathBuf,
    /// Write a file that the viewer opens
    #[arg(long, value_name = "FILE.rrd", required_unless_present = "connect", conflicts_with = "connect")]
    save: Option<PathBuf>,
    /// Show it in a viewer that listens, at this address
    #[arg(long, value_name = "URL", num_args = 0..=1, default_missing_value = "rerun+http://127.0.0.1:9876/proxy")]
    connect: Option<String>,
    /// Go on until the run is at its last step
    #[arg(long)]
    follow: bool,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let builder = RecordingStreamBuilder::new("splat").recording_id(args.out.display().to_string());
    match (&args.save, args.connect) {
        (Some(path), _) => save(builder, &args.out, path, args.follow),
        (None, Some(url)) => {
            let recording =
                builder.connect_grpc_opts(url.as_str()).with_context(|| format!("could not connect to {url}"))?;
            show(&recording, &args.out, args.follow)?;
            recording.flush_blocking().with_context(|| format!("no viewer takes it at {url}: start one with `rerun`"))
        }
        (None, None) => unreachable!("clap asks for one of the two"),
    }
}

/// Writes a file, which appears under its name when it is complete.
fn save(builder: RecordingStreamBuilder, out: &Path, path: &Path, follow: bool) -> Result<()> {
    let mut name = path.file_name().with_context(|| format!("{} is no name of a file", path.display()))?.to_owned();
    name.push(format!(".tmp-{}", process::id()));
    let temporary = path.with_file_name(name);
    let write = || -> Result<()> {
        let recording = builder.save(&temporary)?;
        show(&recording, out, follow)?;
        recording.flush_blocking()?;
        // The end of the file is written when nobody writes to it any longer.
        drop(recording);
        Ok(fs::rename(&temporary, path)?)
    };
    write().with_context(|| format!("could not write {}", path.display())).inspect_err(|_| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&temporary);
    })
}

fn show(recording: &RecordingStream, out: &Path, follow: bool) -> Result<()> {
    let folder = Folder::of(out);
    let run = folder.run()?;
    let mut shown = Shown::begin(recording, &run)?;
    while shown.update(recording, &folder)? < run.steps && follow {
        thread::sleep(BETWEEN_LOOKS);
    }
    Ok(())
}
