//! Which Gaussians share a chunk: neighbours along a Morton curve.
//!
//! A chunk's ranges reach from its smallest to its largest value, so one Gaussian far away takes the precision of 255 others. The
//! order of Gaussians is free: outliers come last, and the chunk before them is filled with Gaussians of opacity 0, so that no
//! chunk holds both. A scene without outliers is written without any filling.

use super::CHUNK;
use crate::cleanup::Bulk;
use crate::density::morton_order;
use crate::gaussians::{DC, GaussianRows};

/// Largest number of groups. Each but the last costs up to 255 Gaussians that fill its last chunk.
const GROUPS: usize = 4;

/// Room around the bulk of the colours, in multiples of its width, or of the difference of black and white if that is larger. A
/// colour at its end makes those of its chunk five times as coarse.
const COLOUR_ROOM: f64 = 2.0;

/// Logit of the opacity of a Gaussian that fills a chunk: level 0 of 255, which readers take for 0. The Gaussian is otherwise a copy of the
/// one before, so that it widens no range.
const HIDDEN_LOGIT: f32 = -30.0;

/// Splits rows into groups, each without its outliers, which are in the groups after it.
fn groups(means: &[[f32; 3]], colours: &[[f32; 3]], of: Vec<u32>) -> Vec<Vec<u32>> {
    let mut groups = Vec::new();
    let mut rest = of;
    while !rest.is_empty() {
        let bulk =
            |values: &[[f32; 3]]| Bulk::of(rest.iter().map(|&row| &values[row as usize])).expect("there are rows");
        let (of_centres, of_colours) = (bulk(means), bulk(colours));
        let room = COLOUR_ROOM * of_colours.width.max(1.0 / DC);
        let ordinary = |row: usize| of_centres.holds(&means[row]) && of_colours.holds_with(room, &colours[row]);
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

/// The order of the rows `of` a scene in a file: group by group. The places without a row fill the last chunk of a group; Gaussians of
/// opacity 0 take them.
pub(in crate::formats) fn arranged(means: &[[f32; 3]], colours: &[[f32; 3]], of: Vec<u32>) -> Vec<Option<u32>> {
    let mut places: Vec<Option<u32>> = Vec::with_capacity(of.len());
    for group in groups(means, colours, of) {
        places.resize(places.len().next_multiple_of(CHUNK), None);
        let own: Vec<[f32; 3]> = group.iter().map(|&row| means[row as usize]).collect();
        places.extend(morton_order(&own).into_iter().map(|place| Some(group[place as usize])));
    }
    places
}

/// Appends the rows of a scene to `filled`, which is empty, in an order of [`arranged`].
pub(in crate::formats) fn fill_chunks(filled: &mut GaussianRows, rows: &GaussianRows, places: &[Option<u32>]) {
    for place in places {
        match place {
            Some(row) => filled.push(rows, *row as usize),
            None => {
                let last = filled.part(filled.len() - 1..filled.len());
                filled.push(&last, 0);
                *filled.logit_opacities.last_mut().expect("a row was pushed") = HIDDEN_LOGIT;
            }
        }
    }
}
