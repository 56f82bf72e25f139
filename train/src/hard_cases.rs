//! `splat hard-cases`: runs the battery of hard cases and writes the table of results.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::builder::PossibleValuesParser;
use splat_hard_cases::judge::{CaseVerdict, judge};
use splat_hard_cases::table::{Section, summary, tsv};
use splat_hard_cases::{CaseGroup, GROUPS, Processor, TestDevice};

use crate::device::{AdapterKind, DeviceName};
use crate::inputs::Inputs;
use crate::output::OutputFolder;
use crate::progress;

/// Name of the table's file.
pub const TABLE: &str = "hard_cases.tsv";

/// Options of `splat hard-cases`.
#[derive(Clone, Debug, clap::Args)]
pub struct HardCasesArgs {
    /// Folder for hard_cases.tsv
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Run only this group; may be given several times
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(GROUPS.iter().map(|group| group.name)))]
    pub group: Vec<String>,
    /// Run only on this device; may be given several times [default: flex, ndarray, and the best adapter if there is one]
    #[arg(long, value_name = "NAME")]
    pub device: Vec<DeviceName>,
}

/// Runs the battery, writes the table and prints its summary. An error if a device is missing, the table cannot be
/// written, or a case fails; in the last case the table is complete and shows which.
pub fn run(args: &HardCasesArgs) -> Result<()> {
    let places = places(&args.device)?;
    let out = OutputFolder::prepare(&args.out, Inputs::default(), [TABLE], &[])?;
    let chosen = |group: &&CaseGroup| args.group.is_empty() || args.group.iter().any(|name| name == group.name);
    let groups: Vec<_> = GROUPS.iter().filter(chosen).map(|group| (group.title, (group.cases)())).collect();
    let bar = progress::counter("hard cases", groups.iter().map(|(_, cases)| cases.len()).sum());
    let mut sections = Vec::new();
    for (title, cases) in groups {
        let rows = cases.into_iter().map(|case| {
            let row = judge(&case, &places);
            bar.inc(1);
            (case, row)
        });
        sections.push(Section { title, rows: rows.collect() });
    }
    bar.finish_and_clear();
    out.write(TABLE, |file| Ok(file.write_all(tsv(&sections).as_bytes())?))?;
    progress::say(&summary(&sections, &places));
    let rows = || sections.iter().flat_map(|section| &section.rows);
    let failed = rows().filter(|(_, row)| row.verdict() == CaseVerdict::Failed).count();
    if failed > 0 {
        bail!("{failed} of {} hard cases fail: see {}", rows().count(), out.join(TABLE).display());
    }
    Ok(())
}

/// The devices to run on. A missing GPU is an error only where it was asked for, and is noted otherwise.
fn places(names: &[DeviceName]) -> Result<Vec<TestDevice>> {
    if !names.is_empty() {
        return names.iter().map(place).collect();
    }
    let named = |name: &str| place(&name.parse().map_err(anyhow::Error::msg)?);
    let mut places = vec![named("flex")?, named("ndarray")?];
    match named("gpu") {
        Ok(gpu) => places.push(gpu),
        Err(why) => progress::note(&format!("without a GPU: {why}")),
    }
    Ok(places)
}

fn place(name: &DeviceName) -> Result<TestDevice> {
    let (processor, software) = match name.find()? {
        Some(found) => (Processor::Gpu, found.kind == AdapterKind::Software),
        None => (Processor::Cpu, false),
    };
    let (device, name) = name.resolve()?;
    Ok(TestDevice { name, device, processor, software })
}
