//! Shows the snapshots of a `splat train --snapshots` run in the Rerun viewer, or writes them to a file for it; see
//! `docs/RERUN.md`.

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

/// Interval between two checks of the folder of a run in progress.
const BETWEEN_LOOKS: Duration = Duration::from_secs(1);

/// Show the snapshots of a `splat train --snapshots` run in the Rerun viewer
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// Output folder of the run
    out: PathBuf,
    /// Write a recording that the viewer can open
    #[arg(long, value_name = "FILE.rrd", required_unless_present = "connect", conflicts_with = "connect")]
    save: Option<PathBuf>,
    /// Send the data to a running viewer at this address
    #[arg(long, value_name = "URL", num_args = 0..=1, default_missing_value = "rerun+http://127.0.0.1:9876/proxy")]
    connect: Option<String>,
    /// Follow a run in progress until its last step
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
            recording.flush_blocking().with_context(|| format!("no viewer answers at {url}: start one with `rerun`"))
        }
        (None, None) => unreachable!("clap asks for one of the two"),
    }
}

/// Writes a recording to a file, which appears under its name only when it is complete.
fn save(builder: RecordingStreamBuilder, out: &Path, path: &Path, follow: bool) -> Result<()> {
    let mut name = path.file_name().with_context(|| format!("{} is not a file name", path.display()))?.to_owned();
    name.push(format!(".tmp-{}", process::id()));
    let temporary = path.with_file_name(name);
    let write = || -> Result<()> {
        let recording = builder.save(&temporary)?;
        show(&recording, out, follow)?;
        recording.flush_blocking()?;
        // Dropping the recording writes the end of the file.
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
