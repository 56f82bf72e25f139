//! Which Gaussians share a chunk: neighbours along a Morton curve.
//!
//! A chunk's ranges reach from its smallest to its largest value, so one Gaussian far away takes the precision of 255 others. The
//! order of Gaussians is free: outliers come last, and the chunk before them is filled with Gaussians of opacity 0, so that no
//! chunk holds both. A scene without outliers is written without any filling.

use super::CHUNK;
use crate::cleanup::Bulk;
use crate::density::morton_order;
use crate::formats::DC;
use crate::gaussians::GaussianRows;

/// Largest number of groups. Each but the last costs up to 255 Gaussians that fill its last chunk.
const GROUPS: usize = 4;

/// Room around the bulk of the colours, in multiples of its width, or of the difference of black and white if that is larger. A
/// colour at its end makes those of its chunk five times as coarse.
const COLOUR_ROOM: f64 = 2.0;

/// Logit of the opacity of a Gaussian that fills a chunk: level 0 of 255, which readers take for 0.
const HIDDEN_LOGIT: f32 = -30.0;

/// Splits rows into groups, each without its outliers, which are in the groups after it.
fn groups(rows: &GaussianRows, of: Vec<u32>) -> Vec<Vec<u32>> {
    let mut groups = Vec::new();
    let mut rest = of;
    while !rest.is_empty() {
        let centres = Bulk::of(rest.iter().map(|&row| &rows.means[row as usize])).expect("there are rows");
        let colours = Bulk::of(rest.iter().map(|&row| &rows.sh_dc[row as usize])).expect("there are rows");
        let room = COLOUR_ROOM * colours.width.max(1.0 / DC);
        let ordinary = |row: usize| centres.holds(&rows.means[row]) && colours.holds_with(room, &rows.sh_dc[row]);
        let last = groups.len() + 1 == GROUPS;
        let (own, outliers): (Vec<u32>, Vec<u32>) = rest.into_iter().partition(|&row| last || ordinary(row as usize));
        if own.is_empty() {
            // No row is ordinary in every respect.
            groups.push(outliers);
            break;
        }
        groups.push(own);
        rest = outliers;
    }
    groups
}

/// Appends the rows `of` a scene to `filled`, group by group, and fills the chunks between.
pub(in crate::formats) fn fill_chunks(filled: &mut GaussianRows, rows: &GaussianRows, of: Vec<u32>) {
    for group in groups(rows, of) {
        if !filled.len().is_multiple_of(CHUNK) {
            // Copies widen no range.
            let mut hidden = GaussianRows { sh_degree: filled.sh_degree, ..GaussianRows::default() };
            hidden.push(filled, filled.len() - 1);
            hidden.logit_opacities[0] = HIDDEN_LOGIT;
            (filled.len()..filled.len().next_multiple_of(CHUNK)).for_each(|_| filled.push(&hidden, 0));
        }
        let means: Vec<[f32; 3]> = group.iter().map(|&row| rows.means[row as usize]).collect();
        morton_order(&means).into_iter().for_each(|place| filled.push(rows, group[place as usize] as usize));
    }
}
