//! The kernels of Adam's step and of the check for finite values.

use cubecl::prelude::*;

use super::rule::Band;
use crate::gpu::math::own_values_finite;

/// The scalars of one step.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct StepFactors {
    pub beta1: f32,
    pub beta2: f32,
    pub rate: f32,
    /// Rate of the numbers in the band.
    pub rate_of_first: f32,
    pub floor: f32,
    pub largest: f32,
}

/// Performs one step in place, unless the verdict names a step. The band is a compile-time value: there is one per degree of the
/// spherical harmonics, and a division by a constant compiles to a multiplication.
#[cube(launch_unchecked)]
pub(super) fn adam_kernel(
    param: &mut [f32],
    m: &mut [f32],
    v: &mut [f32],
    grad: &[f32],
    verdict: ComptimeOption<Box<[u32]>>,
    factors: StepFactors,
    count: u32,
    #[comptime] band: Option<Band>,
) {
    let at = ABSOLUTE_POS;
    let mut runs = at < count as usize;
    #[comptime]
    if let ComptimeOption::Some(verdict) = &verdict {
        runs = runs && verdict[0] == 0;
    }
    if runs {
        let given = grad[at];
        // Comparisons let NaN through; `min` and `max` may not.
        let below = select(given > factors.largest, factors.largest, given);
        let gradient = select(given < -factors.largest, -factors.largest, below);
        let first = m[at] * factors.beta1 + gradient;
        let second = v[at] * factors.beta2 + gradient * gradient;
        m[at] = first;
        v[at] = second;
        let mut rate = factors.rate;
        if comptime!(band.is_some()) {
            let (period, width) = comptime!(band.map_or((1, 0), |band| (band.period as u32, band.width as u32)));
            rate = select(at as u32 % period < width, factors.rate_of_first, factors.rate);
        }
        param[at] -= first / (second.sqrt() + factors.floor) * rate;
    }
}

/// Writes the step to the verdict if any of this unit's values, `stride` apart, is not finite and no earlier step is entered.
/// Units with finite values never write.
#[cube(launch_unchecked)]
pub(super) fn watch_kernel(values: &[f32], verdict: &[Atomic<u32>], count: u32, stride: u32, at_step: u32, mask: u32) {
    if !own_values_finite(values, count, stride) {
        let entered = verdict[0].load();
        if entered == 0 || entered == at_step {
            // Every unit that gets here in this step writes the same values, and no unit of a later step gets here.
            verdict[0].fetch_max(at_step);
            verdict[1].fetch_or(mask);
        }
    }
}
