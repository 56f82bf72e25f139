//! The rows of sums that the backward pass over layers leaves and the gather kernel turns into gradients.

use std::ops::Range;

use super::trace::FEWER_PLACES;
use crate::gpu::{Buffer, Gpu, split};
use crate::intersect::launch::DeviceIntersections;
use crate::limits::Need;

/// Rows of some Gaussians.
pub(crate) struct Rows {
    /// Ranks of the Gaussians in the order by depth; the Gaussians of the scene if each has a row.
    pub ranks: Range<usize>,
    /// Their intersections.
    pub intersections: Range<usize>,
    /// A row per intersection, or a row per Gaussian of the scene.
    pub sums: Buffer<f32>,
}

impl Rows {
    /// Allocates rows of `columns` sums, one per intersection, in as many buffers as the device's largest makes necessary. Each has all
    /// rows of its Gaussians, so the order of sums does not depend on the device. Waits for the device if one buffer is too small.
    pub fn of_intersections(gpu: &Gpu, lists: &DeviceIntersections, columns: usize) -> Vec<Self> {
        let room = (gpu.buffer_limit / (4 * columns as u64)) as usize;
        let rows = |ranks: Range<usize>, intersections: Range<usize>| {
            let len = intersections.len() * columns;
            Need { what: "the rows of a Gaussian's gradients", bytes: 4 * len as u64, hint: FEWER_PLACES }
                .assert_fits(gpu.buffer_limit);
            Self { ranks, intersections, sums: Buffer::with_headroom(gpu, len) }
        };
        if lists.intersections <= room {
            return vec![rows(0..lists.visible, 0..lists.intersections)];
        }
        let starts = lists.first_intersection.read(gpu);
        let start = |rank: usize| if rank < lists.visible { starts[rank] as usize } else { lists.intersections };
        let parts = split(lists.visible, room, start);
        parts.into_iter().map(|ranks| rows(ranks.clone(), start(ranks.start)..start(ranks.end))).collect()
    }
}
