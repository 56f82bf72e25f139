//! The intersection of Gaussians and tiles as an operation. Not differentiable.

use super::cpu::intersect_cpu;
#[cfg(feature = "cube")]
use super::launch::{launch_expected_intersect, launch_intersect};
use super::{Cut, Kept, tile_grid};
use crate::backend::*;
use crate::rasterize::RasterizeSpec;

/// Fills the cell and returns the number of intersections per tile, `[tiles along y, tiles along x]`, from packed ellipses and,
/// optionally, the mask of the tiles that list any.
#[derive(Clone, Debug)]
pub(crate) struct Intersect {
    pub spec: RasterizeSpec,
    pub lists: Kept,
}

impl Operation for Intersect {
    fn outputs(&self, _: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let [tiles_x, tiles_y] = tile_grid(self.spec.intrinsics.width, self.spec.intrinsics.height);
        vec![Some(Spec::ints([tiles_y, tiles_x]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let mask = args.has(1).then(|| args.ints(1));
        let cut = Cut { mask: mask.as_deref(), ..Cut::of(&self.spec.options) };
        let lists = intersect_cpu(&args.floats::<F>(0), &self.spec.intrinsics, cut);
        let counts = lists.tile_start.windows(2).map(|w| (w[1] - w[0]) as i32).collect();
        self.lists.keep(lists);
        vec![HostOutput::ints(counts)]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let mask = args.optional(1);
        let cut = Cut { mask: mask.as_ref(), ..Cut::of(&self.spec.options) };
        let launch = if self.spec.options.counts_first() { launch_intersect } else { launch_expected_intersect };
        let lists = launch(&args.gpu(), &args.buffer(0), &self.spec.intrinsics, cut);
        let counts = lists.counts.handle.clone();
        self.lists.keep(lists);
        vec![Some(counts)]
    }
}
