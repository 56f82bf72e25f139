//! The affine colour map as an operation.

use super::Mapped;
use super::cpu::{colour_map_backward_cpu, colour_map_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_colour_map, launch_colour_map_backward};
#[cfg(feature = "cube")]
use crate::backend::cube::{bound, bound_some};
use crate::backend::host::{found, slices};
use crate::backend::*;

/// The mapped picture, `[3, H, W]`.
#[derive(Clone, Debug)]
pub(super) struct ColourMap;

impl Operation for ColourMap {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        found([colour_map_cpu(Mapped::from_array(slices(&args.all::<F, 2>())))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<Bound> {
        bound([launch_colour_map(&args.gpu(), &Mapped::from_array(args.all()))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let (read, needs) = (args.all::<F, 2>(), Mapped::from_array(args.needs()));
        found(colour_map_backward_cpu(Mapped::from_array(slices(&read)), &args.only_grad(), needs).into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<Bound> {
        let (inputs, needs) = (Mapped::from_array(args.all()), Mapped::from_array(args.needs()));
        bound_some(launch_colour_map_backward(&args.gpu(), &inputs, &args.only_grad(), needs).into_array())
    }
}
