//! The table of dials. A dial that is added here can be measured, stored in files, chosen and trained with.

use splat_op::{Accumulation, Projection, RenderOptions};

/// The reference that a dial's values are judged against. The two kinds are never mixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judge {
    /// The exact render in f64 under the same model choices. Numerical dials approximate the function that the model choices define.
    Exact,
    /// Photographs. Model choices define the function.
    Photographs,
}

/// One value of a dial.
#[derive(Clone, Copy, Debug)]
pub struct DialValue {
    /// Name in files and on command lines.
    pub name: &'static str,
    /// Sets the dial to this value.
    pub set: fn(RenderOptions) -> RenderOptions,
    /// Root mean square error of colours in 0..1 above which the render counts as broken. Model choices have no bound: 0.
    pub rms_bound: f64,
}

/// A dial of [`RenderOptions`].
#[derive(Clone, Copy, Debug)]
pub struct Dial {
    /// Name in files and on command lines: the name of the field.
    pub name: &'static str,
    /// The reference that its values are judged against.
    pub judge: Judge,
    /// Whether the dial has no effect on a CPU.
    pub gpu_only: bool,
    /// The values that are measured, the most accurate first.
    pub values: &'static [DialValue],
    /// Sets a numerical dial to the value without approximation, for the exact render in f64, however long that takes. Leaves a
    /// model choice unchanged.
    pub exact: fn(RenderOptions) -> RenderOptions,
}

const fn value(name: &'static str, rms_bound: f64, set: fn(RenderOptions) -> RenderOptions) -> DialValue {
    DialValue { name, set, rms_bound }
}

/// A value of a model choice.
const fn choice(name: &'static str, set: fn(RenderOptions) -> RenderOptions) -> DialValue {
    value(name, 0.0, set)
}

/// A numerical dial of all devices and cameras. Its first value approximates nothing.
const fn numerical(name: &'static str, values: &'static [DialValue]) -> Dial {
    let (judge, exact) = (Judge::Exact, values[0].set);
    Dial { name, judge, gpu_only: false, values, exact }
}

/// A model choice of all devices and cameras.
const fn model(name: &'static str, values: &'static [DialValue]) -> Dial {
    Dial { judge: Judge::Photographs, exact: |o| o, ..numerical(name, values) }
}

/// Root mean square error that f32 itself may cause, with every dial at its most accurate value.
pub(super) const ROUNDING_RMS: f64 = 1e-3;

/// Root mean square error that `alpha_max` may cause, which is no dial: it lets a hundredth of the light behind a layer through.
pub(super) const ALPHA_MAX_RMS: f64 = 0.02;

/// All dials. Values of numerical dials are listed from accurate to coarse.
///
/// Reasons for the bounds: a contribution skipped by `alpha_min` has at most that weight, and about ten such layers show in a pixel. The
/// layers cut off by `transmittance_min` have at most that weight over `1 − alpha_max`, because the layer that would cross the threshold is
/// left out together with the layers behind it; where that ratio reaches one, anything may be left out, and pixels of opaque surfaces are.
pub const DIALS: &[Dial] = &[
    Dial {
        // A hundred thousand contributions below this value change a picture by less than the precision of f32.
        exact: |o| o.with_alpha_min(1e-12),
        ..numerical(
            "alpha_min",
            &[
                value("2^-26", 1e-4, |o| o.with_alpha_min(RenderOptions::exact().alpha_min)),
                value("1/4096", 0.003, |o| o.with_alpha_min(1.0 / 4096.0)),
                value("1/1024", 0.01, |o| o.with_alpha_min(1.0 / 1024.0)),
                value("1/255", 0.04, |o| o.with_alpha_min(1.0 / 255.0)),
                value("2/255", 0.08, |o| o.with_alpha_min(2.0 / 255.0)),
                value("4/255", 0.16, |o| o.with_alpha_min(4.0 / 255.0)),
                value("8/255", 0.32, |o| o.with_alpha_min(8.0 / 255.0)),
            ],
        )
    },
    numerical(
        "transmittance_min",
        &[
            value("0", 0.0, |o| o.with_transmittance_min(0.0)),
            value("1e-5", 1e-3, |o| o.with_transmittance_min(1e-5)),
            value("1e-4", 0.01, |o| o.with_transmittance_min(1e-4)),
            value("1e-3", 0.1, |o| o.with_transmittance_min(1e-3)),
            value("1e-2", 0.5, |o| o.with_transmittance_min(1e-2)),
        ],
    ),
    Dial {
        gpu_only: true,
        ..numerical(
            "accumulation",
            &[
                value("ordered", 0.0, |o| o.with_accumulation(Accumulation::Ordered)),
                value("atomic", 0.0, |o| o.with_accumulation(Accumulation::Atomic)),
            ],
        )
    },
    model(
        "projection",
        &[
            choice("ray-max", |o| o.with_projection(Projection::RayMax)),
            choice("affine", |o| o.with_projection(Projection::Affine)),
        ],
    ),
    model(
        "sh_degree",
        &[
            choice("all", |o| o.with_sh_degree(None)),
            choice("2", |o| o.with_sh_degree(Some(2))),
            choice("1", |o| o.with_sh_degree(Some(1))),
            choice("0", |o| o.with_sh_degree(Some(0))),
        ],
    ),
    model("antialias", &[choice("on", |o| o.with_antialias(true)), choice("off", |o| o.with_antialias(false))]),
];

impl Dial {
    /// The dial of that name.
    pub fn named(name: &str) -> Option<&'static Self> {
        DIALS.iter().find(|dial| dial.name == name)
    }

    /// The dial's value of that name.
    pub fn value(&self, name: &str) -> Option<&'static DialValue> {
        self.values.iter().find(|value| value.name == name)
    }

    /// The dial's value in `options`, if it is one of the listed values.
    pub fn value_in(&self, options: &RenderOptions) -> Option<&'static DialValue> {
        self.values.iter().find(|value| (value.set)(*options) == *options)
    }

    /// `options` with every numerical dial at its value without approximation, for the exact render in f64.
    pub fn all_exact(options: RenderOptions) -> RenderOptions {
        let base = options.with_alpha_max(1.0);
        DIALS.iter().filter(|dial| dial.judge == Judge::Exact).fold(base, |options, dial| (dial.exact)(options))
    }

    /// Root mean square error of colours above which a render with `options` counts as broken: the sum over the numerical
    /// dials, as errors add up in the worst case, plus the error of f32. A dial whose value is not listed adds nothing.
    pub fn rms_bound(options: &RenderOptions) -> f64 {
        let bound = |dial: &Dial| dial.value_in(options).map_or(0.0, |value| value.rms_bound);
        ROUNDING_RMS + ALPHA_MAX_RMS + DIALS.iter().map(bound).sum::<f64>()
    }
}

#[cfg(test)]
mod tests;
