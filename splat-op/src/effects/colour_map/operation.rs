//! The affine colour map as an operation.

use super::Mapped;
use super::cpu::{colour_map_backward_cpu, colour_map_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_colour_map, launch_colour_map_backward};
#[cfg(feature = "cube")]
use crate::backend::cube::{gpu_outputs, optional_outputs};
use crate::backend::host::{float_outputs, slices};
use crate::backend::*;

/// The mapped picture, `[3, H, W]`.
#[derive(Clone, Debug)]
pub(super) struct ColourMap;

impl Operation for ColourMap {
    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([colour_map_cpu(Mapped::from_array(slices(&args.all::<F, 2>())))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_colour_map(&args.gpu(), &Mapped::from_array(args.all()))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (args.all::<F, 2>(), Mapped::from_array(args.needs()));
        float_outputs(colour_map_backward_cpu(Mapped::from_array(slices(&read)), &args.only_grad(), needs).into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (inputs, needs) = (Mapped::from_array(args.all()), Mapped::from_array(args.needs()));
        optional_outputs(launch_colour_map_backward(&args.gpu(), &inputs, &args.only_grad(), needs).into_array())
    }
}
