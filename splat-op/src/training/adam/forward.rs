//! The kernels of Adam's step and of the check for finite values.

use cubecl::prelude::*;

use super::rule::{Band, LAST_BIT};
use crate::activate::forward::bounded;
use crate::gpu::{clamped, own_values_finite};

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

/// One parameter of a launch. The band is a compile-time value: there is one per degree of the spherical harmonics, and a division
/// by a constant compiles to a multiplication.
#[derive(CubeType, CubeLaunch)]
pub(super) struct AdamParam {
    param: Box<[f32]>,
    m: Box<[f32]>,
    v: Box<[f32]>,
    grad: Box<[f32]>,
    factors: StepFactors,
    count: u32,
    #[cube(comptime)]
    band: Option<Band>,
}

/// Performs the step of one number in place and returns the number.
#[cube]
fn step(of: &mut AdamParam, at: usize) -> f32 {
    let factors = of.factors;
    let gradient = clamped(of.grad[at], factors.largest);
    let first = of.m[at] * factors.beta1 + gradient;
    let second = of.v[at] * factors.beta2 + gradient * gradient;
    of.m[at] = first;
    of.v[at] = second;
    let mut rate = factors.rate;
    if comptime!(of.band.is_some()) {
        let (period, width) = comptime!(of.band.map_or((1, 0), |band| (band.period as u32, band.width as u32)));
        rate = select(at as u32 % period < width, factors.rate_of_first, factors.rate);
    }
    let moved = of.param[at] - first / (second.sqrt() + factors.floor) * rate;
    of.param[at] = moved;
    moved
}

/// Performs one step of up to three parameters, whose numbers follow one another, unless the verdict names a step. If `marks` is set,
/// sets the mark if a number of the second parameter is not usable afterwards, or if nobody looked.
#[cube(launch_unchecked)]
pub(super) fn adam_kernel(
    mut first: AdamParam,
    mut second: ComptimeOption<AdamParam>,
    mut third: ComptimeOption<AdamParam>,
    verdict: ComptimeOption<Box<[u32]>>,
    mark: &[Atomic<u32>],
    #[comptime] marks: bool,
) {
    let mut runs = true;
    #[comptime]
    if let ComptimeOption::Some(verdict) = &verdict {
        runs = verdict[0] == 0;
    }
    if runs {
        let mut at = ABSOLUTE_POS as u32;
        let mut usable = true;
        let mut done = at < first.count;
        if done {
            step(&mut first, at as usize);
        }
        at -= select(done, 0u32, first.count);
        #[comptime]
        if let ComptimeOption::Some(second) = &mut second {
            if !done && at < second.count {
                usable = bounded(step(second, at as usize));
                done = true;
            }
            at -= select(done, 0u32, second.count);
        }
        #[comptime]
        if let ComptimeOption::Some(third) = &mut third {
            let due = !done && at < third.count;
            if due {
                step(third, at as usize);
            }
        }
        if comptime!(marks) && !usable {
            mark[0].fetch_or(1u32);
        }
    } else if comptime!(marks) && ABSOLUTE_POS == 0 {
        mark[0].fetch_or(1u32);
    }
}

/// A bit if any of this unit's values, `stride` apart, is not finite, else zero.
#[cube]
fn bit_if_wrong(values: &ComptimeOption<Box<[f32]>>, count: u32, stride: u32, #[comptime] bit: u32) -> u32 {
    let mut sound = true;
    #[comptime]
    if let ComptimeOption::Some(values) = values {
        sound = own_values_finite(values, count, stride);
    }
    select(sound, 0u32, comptime!(1u32 << bit.min(LAST_BIT as u32)))
}

/// Numbers of values: of the loss and of each gradient.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct WatchedCounts {
    pub loss: u32,
    pub a: u32,
    pub b: u32,
    pub c: u32,
    pub d: u32,
    pub e: u32,
}

/// Writes the step to the verdict if any of this unit's values, `stride` apart, is not finite and no earlier step is entered.
/// Units with finite values never write. Bits of gradients begin after bit `first`.
#[cube(launch_unchecked)]
pub(super) fn watch_kernel(
    loss: ComptimeOption<Box<[f32]>>,
    a: ComptimeOption<Box<[f32]>>,
    b: ComptimeOption<Box<[f32]>>,
    c: ComptimeOption<Box<[f32]>>,
    d: ComptimeOption<Box<[f32]>>,
    e: ComptimeOption<Box<[f32]>>,
    verdict: &[Atomic<u32>],
    counts: WatchedCounts,
    stride: u32,
    at_step: u32,
    #[comptime] first: u32,
    #[comptime] _given: u32,
) {
    let mut wrong = bit_if_wrong(&loss, counts.loss, stride, 0u32);
    wrong |= bit_if_wrong(&a, counts.a, stride, comptime!(first + 1));
    wrong |= bit_if_wrong(&b, counts.b, stride, comptime!(first + 2));
    wrong |= bit_if_wrong(&c, counts.c, stride, comptime!(first + 3));
    wrong |= bit_if_wrong(&d, counts.d, stride, comptime!(first + 4));
    wrong |= bit_if_wrong(&e, counts.e, stride, comptime!(first + 5));
    if wrong != 0 {
        let entered = verdict[0].load();
        if entered == 0 || entered == at_step {
            // Every unit that gets here in this step writes the same step, and no unit of a later step gets here.
            verdict[0].fetch_max(at_step);
            verdict[1].fetch_or(wrong);
        }
    }
}
