//! The cases, by group. A group is a file here; to add one, add it to [`GROUPS`].

mod needles;

use crate::case::Case;

/// Cases of one kind of hardness.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    /// Short, for choosing it.
    pub name: &'static str,
    /// As the table heads it.
    pub title: &'static str,
    /// Builds the cases.
    pub cases: fn() -> Vec<Case>,
}

/// All groups, in the order of the table.
pub const GROUPS: &[Group] = &[Group { name: "needles", title: "Needles and discs", cases: needles::cases }];

/// Every case, with its group.
pub fn battery() -> Vec<(&'static Group, Vec<Case>)> {
    GROUPS.iter().map(|group| (group, (group.cases)())).collect()
}
