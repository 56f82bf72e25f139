//! Failures as sentences: what was found, and what helps.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Error, Result, anyhow, ensure};
use splat_model::capture::unposed::{PhotographFolder, Unposed, different};

use super::stage::Ended;

/// Fewest photographs from which anything is reconstructed: two give no second opinion on any point.
const MIN_PHOTOGRAPHS: usize = 3;

/// Features below which a photograph hardly connects to others. COLMAP wants 15 matches between two photographs, and a tenth to a
/// third of the features match in neighbours.
const FEW_FEATURES: u64 = 100;

/// What makes photographs connect.
const OVERLAP: &str = "each photograph should show two thirds of what the next one shows, from a step to the side, sharp, with the same zoom \
                       (docs/YOUR_PHOTOGRAPHS.md)";

/// Pictures of kinds that are not read, by kind; `None` without any.
pub fn others(folder: &PhotographFolder) -> Option<String> {
    let others: Vec<String> = folder.other.iter().map(|(kind, count)| format!("{count} .{kind}")).collect();
    (!others.is_empty()).then(|| others.join(", "))
}

/// Refuses a folder with too few photographs.
pub fn check_number(folder: &PhotographFolder) -> Result<()> {
    let others = others(folder).map(|others| format!(" and {others} files, which have to be converted to JPEG first"));
    let others = others.unwrap_or_default();
    let found = folder.names.len();
    ensure!(
        found >= MIN_PHOTOGRAPHS,
        "{} holds {found} JPEG and PNG photographs{others}, expected at least {MIN_PHOTOGRAPHS}, better 50 to 200: {OVERLAP}",
        folder.root.display()
    );
    Ok(())
}

/// Refuses photographs that are copies of each other.
pub fn check_different(photographs: &[Unposed], folder: &Path) -> Result<()> {
    let found = different(photographs);
    ensure!(
        found >= MIN_PHOTOGRAPHS,
        "the {} photographs in {} are copies of {found}: depth needs at least {MIN_PHOTOGRAPHS} from different places; {OVERLAP}",
        photographs.len(),
        folder.display()
    );
    Ok(())
}

pub fn ended(program: &str, doing: &str, ended: &Ended, log: &Path) -> Error {
    let log = log.display();
    let last = ended.last_line();
    // SIGKILL, which on Linux is mostly the end of memory.
    if ended.signal() == Some(9) {
        return anyhow!(
            "{program} was killed while it was {doing}, as systems do when memory runs out: close other programs or use smaller \
             photographs, then run the same command, which goes on from the last finished stage. All that it printed is in {log}"
        );
    }
    match ended.signal() {
        Some(signal) => anyhow!(
            "{program} crashed (signal {signal}) while it was {doing}. It last said: {last}. All that it printed is in {log}; try the same \
             command again, or another version of {program}"
        ),
        None => anyhow!(
            "{program} failed ({}) while it was {doing}. It last said: {last}. All that it printed is in {log}",
            ended.status
        ),
    }
}

/// The error of a reconstruction without a model.
pub fn no_model(photographs: usize, features: &BTreeMap<String, u64>, log: &Path) -> Error {
    let mut counts: Vec<u64> = features.values().copied().collect();
    counts.sort_unstable();
    let median = counts.get(counts.len() / 2).copied().unwrap_or_default();
    let few = counts.iter().filter(|&&count| count < FEW_FEATURES).count();
    let why = match few * 2 > photographs {
        true => format!(
            "{few} of them have fewer than {FEW_FEATURES} features (median {median}), so they show too little that is sharp and distinct: \
             bare walls, glass, darkness or blur. Photograph it with more light and with things that have texture beside it"
        ),
        false => format!(
            "they have enough features (median {median}), but no two of them show enough of the same points from different sides: {OVERLAP}"
        ),
    };
    anyhow!(
        "COLMAP found no cameras for the {photographs} photographs: {why}. All that it printed is in {}",
        log.display()
    )
}

/// Describes a reconstruction that did not place all photographs, `None` if it did.
pub fn not_placed(photographs: usize, missing: &[String], models: usize) -> Option<String> {
    let some: Vec<&str> = missing.iter().take(5).map(String::as_str).collect();
    let more = if missing.len() > some.len() { ", …" } else { "" };
    let placed = photographs - missing.len();
    let names = format!("{}{more}", some.join(", "));
    let why = match models > 1 {
        true => {
            format!("the photographs fall into {models} parts that COLMAP could not connect, and the largest is used")
        }
        false => "the others show too few points that these show".into(),
    };
    (!missing.is_empty()).then(|| {
        let half = if 2 * placed < photographs { "less than half: " } else { "" };
        format!(
            "{half}{placed} of {photographs} photographs were placed, because {why}. Not used: {names}. What helps: photographs between the parts; \
             {OVERLAP}"
        )
    })
}

#[cfg(test)]
mod tests;
