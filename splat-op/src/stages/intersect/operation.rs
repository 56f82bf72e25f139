//! The intersection of Gaussians and tiles as an operation. Not differentiable.

use super::cpu::intersect_cpu;
#[cfg(feature = "cube")]
use super::launch::{DeviceIntersections, launch_intersect};
use super::{Cut, IntersectionCell, IntersectionLists, StoredIntersections, tile_grid};
use crate::backend::*;
use crate::rasterize::RasterizeSpec;

/// Fills the cell and returns the number of intersections per tile, `[tiles along y, tiles along x]`, from packed ellipses.
#[derive(Clone, Debug)]
pub(crate) struct Intersect {
    pub spec: RasterizeSpec,
    pub cell: IntersectionCell,
}

impl Operation for Intersect {
    fn outputs(&self, _: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let [tiles_x, tiles_y] = tile_grid(self.spec.intrinsics.width, self.spec.intrinsics.height);
        vec![Some(Spec::ints([tiles_y, tiles_x]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let lists = self.cell.on_host(|| lists(&args.floats::<F>(0), &self.spec));
        vec![HostOutput::ints(lists.tile_start.windows(2).map(|w| (w[1] - w[0]) as i32).collect())]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        let lists = self
            .cell
            .on_device(|| launch_intersect(&gpu, &args.buffer(0), &self.spec.intrinsics, Cut::of(&self.spec.options)));
        vec![Some(lists.counts.handle.clone())]
    }
}

/// Computes the lists of packed ellipses.
pub(crate) fn lists<F: Real>(projected: &[F], spec: &RasterizeSpec) -> IntersectionLists {
    intersect_cpu(projected, &spec.intrinsics, Cut::of(&spec.options))
}

impl IntersectionCell {
    /// Returns the lists, computed if there are none.
    pub(crate) fn on_host(&self, compute: impl FnOnce() -> IntersectionLists) -> &IntersectionLists {
        match self.0.get_or_init(|| StoredIntersections::Host(compute())) {
            StoredIntersections::Host(lists) => lists,
            #[cfg(feature = "cube")]
            StoredIntersections::Device(_) => {
                unreachable!("the public functions check that lists and ellipses are on one device")
            }
        }
    }

    /// Returns the lists on a GPU, computed if there are none.
    #[cfg(feature = "cube")]
    pub(crate) fn on_device(&self, compute: impl FnOnce() -> DeviceIntersections) -> &DeviceIntersections {
        match self.0.get_or_init(|| StoredIntersections::Device(Box::new(compute()))) {
            StoredIntersections::Device(lists) => lists,
            StoredIntersections::Host(_) => {
                unreachable!("the public functions check that lists and ellipses are on one device")
            }
        }
    }
}
