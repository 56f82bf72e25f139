//! The cases, by group. Each group is a file here. A new group is added to [`GROUPS`].

mod cameras;
mod colour;
mod counts;
mod depth;
mod far;
mod loss;
mod near;
mod needles;
mod opacity;
pub mod poison;
mod rays;
mod rotations;
mod sizes;
mod storage;
mod training;

use crate::case::HardCase;

/// Cases that are hard in one way.
#[derive(Clone, Copy, Debug)]
pub struct CaseGroup {
    /// Short name, for choosing the group.
    pub name: &'static str,
    /// Heading in the table.
    pub title: &'static str,
    /// Builds the cases.
    pub cases: fn() -> Vec<HardCase>,
}

/// All groups, in the order of the table.
pub const GROUPS: &[CaseGroup] = &[
    CaseGroup { name: "needles", title: "Needles and discs", cases: needles::cases },
    CaseGroup { name: "sizes", title: "Sizes", cases: sizes::cases },
    CaseGroup { name: "near", title: "The near plane and the border of the view", cases: near::cases },
    CaseGroup { name: "opacity", title: "Opacity and transmittance", cases: opacity::cases },
    CaseGroup { name: "depth", title: "Depth", cases: depth::cases },
    CaseGroup { name: "rotations", title: "Rotations", cases: rotations::cases },
    CaseGroup { name: "cameras", title: "Cameras", cases: cameras::cases },
    CaseGroup { name: "colour", title: "Colour", cases: colour::cases },
    CaseGroup { name: "rays", title: "Ray-max projection", cases: rays::cases },
    CaseGroup { name: "far", title: "Far from the origin, and very small", cases: far::cases },
    CaseGroup { name: "poison", title: "Poison", cases: poison::cases },
    CaseGroup { name: "counts", title: "Numbers of Gaussians", cases: counts::cases },
    CaseGroup { name: "storage", title: "Storage with fewer bits", cases: storage::cases },
    CaseGroup { name: "loss", title: "Loss and optimiser", cases: loss::cases },
    CaseGroup { name: "training", title: "Training", cases: training::cases },
];

/// Returns every case, by group.
pub fn battery() -> Vec<(&'static CaseGroup, Vec<HardCase>)> {
    GROUPS.iter().map(|group| (group, (group.cases)())).collect()
}
