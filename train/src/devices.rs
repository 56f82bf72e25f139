//! `splat devices`: lists the devices to compute on.

use std::num::NonZero;
use std::thread;

use anyhow::Result;
use indicatif::BinaryBytes;

use crate::device::{self, Adapter, DeviceName, Facts, Runtime, choose};
use crate::progress;

/// Head of the table. The first column is the value of `--device`.
const COLUMNS: [&str; 6] = ["--device", "adapter", "kind", "runtime", "largest buffer", "f32 atomics"];

type TableRow = [String; COLUMNS.len()];

/// Prints the devices, the runtimes of this build, and the device that `auto` chooses.
///
/// # Errors
/// None today: an adapter that does not open is listed as such.
pub fn run() -> Result<()> {
    let found = device::list(&Runtime::built());
    let opened: Vec<Result<Facts>> = found.iter().map(device::open).collect();
    let mut rows = vec![cpu(DeviceName::Flex), cpu(DeviceName::Ndarray)];
    rows.extend(found.iter().zip(&opened).map(|(found, opened)| row(found, opened)));
    for line in table(&rows) {
        progress::say(&line);
    }
    let open = found.iter().zip(&opened).filter(|(_, opened)| opened.is_ok());
    let open: Vec<Adapter> = open.map(|(found, _)| found.clone()).collect();
    progress::say("");
    for line in remarks(&open, found.is_empty())? {
        progress::say(&line);
    }
    Ok(())
}

/// Row of a CPU backend. Columns that do not apply hold a dash.
fn cpu(name: DeviceName) -> TableRow {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let adapter = format!("the CPU, {threads} {}", if threads == 1 { "thread" } else { "threads" });
    let runtime = format!("Burn's {name} backend");
    [name.to_string(), adapter, "processor".into(), runtime, "-".into(), "-".into()]
}

fn row(adapter: &Adapter, opened: &Result<Facts>) -> TableRow {
    let (name, kind) = (adapter.name().to_string(), adapter.kind.to_string());
    match opened {
        Ok(facts) => {
            let atomics = if facts.float_atomics { "yes" } else { "no" }.to_owned();
            [
                name,
                facts.name.clone(),
                kind,
                facts.runtime.clone(),
                BinaryBytes(facts.buffer_limit).to_string(),
                atomics,
            ]
        }
        Err(error) => {
            let dash = || "-".to_owned();
            [name, error.to_string(), kind, adapter.runtime.feature().into(), dash(), dash()]
        }
    }
}

/// Formats a table with columns as wide as their widest cell and two spaces between them.
fn table(rows: &[TableRow]) -> Vec<String> {
    let head: TableRow = COLUMNS.map(String::from);
    let rows: Vec<&TableRow> = [&head].into_iter().chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or_default();
    let widths: [usize; COLUMNS.len()] = std::array::from_fn(width);
    let line = |row: &&TableRow| {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

/// Remarks below the table: the device of `auto` among adapters that open, and the runtimes that are built in.
fn remarks(adapters: &[Adapter], none_found: bool) -> Result<Vec<String>> {
    let built = Runtime::built();
    let other: Vec<Runtime> = Runtime::ALL.into_iter().filter(|runtime| !built.contains(runtime)).collect();
    let mut lines = vec![match choose(DeviceName::Auto, adapters)? {
        Some(adapter) => format!("`--device auto` takes {}.", adapter.name()),
        None => format!("`--device auto` takes the CPU, flex: {}.", device::why_cpu(adapters)),
    }];
    let features =
        |runtimes: &[Runtime]| runtimes.iter().map(|runtime| runtime.feature()).collect::<Vec<_>>().join(", ");
    lines.push(match built.is_empty() {
        true => "GPU runtimes in this program: none.".into(),
        false => format!("GPU runtimes in this program: {}.", features(&built)),
    });
    if !other.is_empty() {
        lines.push(format!("Others can be built in, as cargo features: {}.", features(&other)));
    }
    if none_found && !built.is_empty() {
        let advice = choose(DeviceName::Gpu, adapters).expect_err("there are no adapters").to_string();
        lines.push(advice);
    }
    Ok(lines)
}

#[cfg(test)]
mod tests;
