//! The table of dials. One more is one more entry here: it can then be measured, written down, chosen and trained with.

use splat_op::{Accumulation, Culling, Exponential, Order, Projection, RenderOptions, Storage};

/// What a dial's values are judged against. The two are never mixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judge {
    /// A numerical dial, which approximates the function that the model choices define: the exact render in f64 under the
    /// same choices.
    Exact,
    /// A model choice, which defines the function: photographs.
    Photographs,
}

/// One position of a dial.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// As files and command lines have it.
    pub name: &'static str,
    /// Turns the dial to it.
    pub set: fn(RenderOptions) -> RenderOptions,
    /// Root mean square error of colours in 0..1 above which this is no approximation but broken. Nothing is said of model
    /// choices: 0.
    pub rms_bound: f64,
}

/// A dial of [`RenderOptions`].
#[derive(Clone, Copy, Debug)]
pub struct Dial {
    /// As files and command lines have it: the name of the field.
    pub name: &'static str,
    /// What it does, in half a sentence.
    pub what: &'static str,
    /// What its values are judged against.
    pub judge: Judge,
    /// Whether every value must give the same picture to the last bit: then only time may change, and gradients in their last
    /// digits.
    pub same_picture: bool,
    /// Whether it does nothing on a CPU.
    pub gpu_only: bool,
    /// Whether it is for cameras without a lens alone.
    pub pinhole_only: bool,
    /// The values that are measured, the most accurate first.
    pub values: &'static [Value],
    /// Of a numerical dial: turns it to where it approximates nothing, for the exact render in f64, however long that takes. A
    /// model choice is left as it is.
    pub exact: fn(RenderOptions) -> RenderOptions,
}

/// Alphas that the exact render leaves out: a hundred thousand of them change a picture by less than f32 can tell.
const ALPHA_OF_THE_EXACT: f64 = 1e-12;

const fn value(name: &'static str, rms_bound: f64, set: fn(RenderOptions) -> RenderOptions) -> Value {
    Value { name, set, rms_bound }
}

/// Values of a model choice.
const fn choice(name: &'static str, set: fn(RenderOptions) -> RenderOptions) -> Value {
    value(name, 0.0, set)
}

/// What f32 itself may cost, with every dial at its most accurate.
pub(super) const ROUNDING_RMS: f64 = 1e-3;

/// All dials. Values of numerical ones go from accurate to coarse.
///
/// The bounds: what is skipped below `alpha_min` has at most that weight a layer, and some ten such layers show in a pixel.
/// What lies behind `transmittance_min` has that weight over `1 − alpha_max`, because the layer that would pass the threshold
/// is left out with what is behind it; where that ratio reaches one, anything may be left out, and pixels of opaque surfaces
/// are. `alpha_max` lets `1 − alpha_max` of what is behind through.
pub const DIALS: &[Dial] = &[
    Dial {
        name: "alpha_min",
        what: "contributions with a smaller alpha are skipped",
        judge: Judge::Exact,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            value("2^-26", 1e-4, |o| RenderOptions { alpha_min: RenderOptions::exact().alpha_min, ..o }),
            value("1/4096", 0.003, |o| RenderOptions { alpha_min: 1.0 / 4096.0, ..o }),
            value("1/1024", 0.01, |o| RenderOptions { alpha_min: 1.0 / 1024.0, ..o }),
            value("1/255", 0.04, |o| RenderOptions { alpha_min: 1.0 / 255.0, ..o }),
            value("2/255", 0.08, |o| RenderOptions { alpha_min: 2.0 / 255.0, ..o }),
            value("4/255", 0.16, |o| RenderOptions { alpha_min: 4.0 / 255.0, ..o }),
            value("8/255", 0.32, |o| RenderOptions { alpha_min: 8.0 / 255.0, ..o }),
        ],
        exact: |o| RenderOptions { alpha_min: ALPHA_OF_THE_EXACT, ..o },
    },
    Dial {
        name: "transmittance_min",
        what: "what lies behind a smaller transmittance is left out, and the layer that would pass it too",
        judge: Judge::Exact,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            value("0", 0.0, |o| RenderOptions { transmittance_min: 0.0, ..o }),
            value("1e-5", 1e-3, |o| RenderOptions { transmittance_min: 1e-5, ..o }),
            value("1e-4", 0.01, |o| RenderOptions { transmittance_min: 1e-4, ..o }),
            value("1e-3", 0.1, |o| RenderOptions { transmittance_min: 1e-3, ..o }),
            value("1e-2", 0.5, |o| RenderOptions { transmittance_min: 1e-2, ..o }),
        ],
        exact: |o| RenderOptions { transmittance_min: 0.0, ..o },
    },
    Dial {
        name: "alpha_max",
        what: "no layer hides more of what is behind it",
        judge: Judge::Exact,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            // With a threshold of the transmittance this leaves out opaque layers, hence the bound.
            value("1", 0.5, |o| RenderOptions { alpha_max: 1.0, ..o }),
            value("0.999", 0.1, |o| RenderOptions { alpha_max: 0.999, ..o }),
            value("0.99", 0.02, |o| RenderOptions { alpha_max: 0.99, ..o }),
        ],
        exact: |o| RenderOptions { alpha_max: 1.0, ..o },
    },
    Dial {
        name: "accumulation",
        what: "how the gradients of a Gaussian's hits are added",
        judge: Judge::Exact,
        same_picture: true,
        gpu_only: true,
        pinhole_only: false,
        values: &[
            value("ordered", 0.0, |o| o.with_accumulation(Accumulation::Ordered)),
            value("atomic", 0.0, |o| o.with_accumulation(Accumulation::Atomic)),
        ],
        exact: |o| o.with_accumulation(Accumulation::Ordered),
    },
    Dial {
        name: "culling",
        what: "which tiles list a Gaussian",
        judge: Judge::Exact,
        same_picture: true,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            value("ellipse", 0.0, |o| o.with_culling(Culling::Ellipse)),
            value("opacity-box", 0.0, |o| o.with_culling(Culling::OpacityBox)),
            value("bounding-box", 0.0, |o| o.with_culling(Culling::BoundingBox)),
        ],
        exact: |o| o.with_culling(Culling::Ellipse),
    },
    Dial {
        name: "exponential",
        what: "how exp is computed",
        judge: Judge::Exact,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            value("library", 0.0, |o| o.with_exponential(Exponential::Library)),
            value("polynomial", 0.0, |o| o.with_exponential(Exponential::Polynomial)),
            value("standard", 0.0, |o| o.with_exponential(Exponential::Standard)),
        ],
        exact: |o| o.with_exponential(Exponential::Library),
    },
    Dial {
        name: "coefficients",
        what: "how coefficients of the harmonics are stored where colours are computed from them",
        judge: Judge::Exact,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            value("full", 0.0, |o| o.with_coefficients(Storage::Full)),
            value("half", 2e-3, |o| o.with_coefficients(Storage::Half)),
        ],
        exact: |o| o.with_coefficients(Storage::Full),
    },
    Dial {
        name: "projection",
        what: "what a pixel sees of a Gaussian: its ellipse, or the greatest value along the ray",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: true,
        values: &[
            choice("exact", |o| o.with_projection(Projection::Exact)),
            choice("affine", |o| o.with_projection(Projection::Affine)),
        ],
        exact: |o| o,
    },
    Dial {
        name: "order",
        what: "what is sorted by depth: Gaussians, or the contributions to each pixel",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: true,
        values: &[
            choice("per-pixel", |o| o.with_order(Order::PerPixel)),
            choice("centre", |o| o.with_order(Order::Centre)),
        ],
        exact: |o| o,
    },
    Dial {
        name: "sh_degree",
        what: "harmonics above this degree are left out",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            choice("all", |o| o.with_sh_degree(None)),
            choice("2", |o| o.with_sh_degree(Some(2))),
            choice("1", |o| o.with_sh_degree(Some(1))),
            choice("0", |o| o.with_sh_degree(Some(0))),
        ],
        exact: |o| o,
    },
    Dial {
        name: "blur",
        what: "variance added to every ellipse, px²",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            choice("0.1", |o| RenderOptions { blur: 0.1, ..o }),
            choice("0.3", |o| RenderOptions { blur: 0.3, ..o }),
            choice("0.5", |o| RenderOptions { blur: 0.5, ..o }),
        ],
        exact: |o| o,
    },
    Dial {
        name: "antialias",
        what: "opacities are compensated for the blur",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[choice("on", |o| o.with_antialias(true)), choice("off", |o| o.with_antialias(false))],
        exact: |o| o,
    },
    Dial {
        name: "jacobian_margin",
        what: "how far outside the picture, as a share of half its size, the projection's derivative is taken",
        judge: Judge::Photographs,
        same_picture: false,
        gpu_only: false,
        pinhole_only: false,
        values: &[
            choice("0.15", |o| RenderOptions { jacobian_margin: 0.15, ..o }),
            choice("0.3", |o| RenderOptions { jacobian_margin: 0.3, ..o }),
            choice("1", |o| RenderOptions { jacobian_margin: 1.0, ..o }),
        ],
        exact: |o| o,
    },
];

impl Dial {
    /// The dial of that name.
    pub fn named(name: &str) -> Option<&'static Self> {
        DIALS.iter().find(|dial| dial.name == name)
    }

    /// Its value of that name.
    pub fn value(&self, name: &str) -> Option<&'static Value> {
        self.values.iter().find(|value| value.name == name)
    }

    /// Where it stands in `options`, if at one of its values.
    pub fn value_in(&self, options: &RenderOptions) -> Option<&'static Value> {
        self.values.iter().find(|value| (value.set)(*options) == *options)
    }

    /// `options` with every numerical dial where it approximates nothing: what the exact render in f64 takes.
    pub fn all_exact(options: RenderOptions) -> RenderOptions {
        DIALS.iter().filter(|dial| dial.judge == Judge::Exact).fold(options, |options, dial| (dial.exact)(options))
    }

    /// Root mean square error of colours above which a render with `options` is broken: the sum over the numerical dials, as
    /// errors add up at worst, and what f32 may cost. A dial that stands elsewhere than at one of its values allows nothing.
    pub fn rms_bound(options: &RenderOptions) -> f64 {
        let bound = |dial: &Dial| dial.value_in(options).map_or(0.0, |value| value.rms_bound);
        ROUNDING_RMS + DIALS.iter().map(bound).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_names_and_values_differ() {
        let dials: BTreeSet<&str> = DIALS.iter().map(|dial| dial.name).collect();
        assert_eq!(dials.len(), DIALS.len());
        for dial in DIALS {
            let base = RenderOptions::standard();
            let names: BTreeSet<&str> = dial.values.iter().map(|value| value.name).collect();
            assert!(names.len() == dial.values.len() && names.len() > 1, "{}", dial.name);
            for value in dial.values {
                let set = (value.set)(base);
                assert_eq!(dial.value_in(&set).map(|found| found.name), Some(value.name), "{}", dial.name);
                assert!(value.rms_bound == 0.0 || dial.judge == Judge::Exact, "{}", dial.name);
            }
        }
    }

    #[test]
    fn a_dial_moves_nothing_but_itself() {
        let base = RenderOptions::standard();
        for dial in DIALS {
            for moved in dial.values.iter().map(|value| (value.set)(base)).chain([(dial.exact)(base)]) {
                for other in DIALS.iter().filter(|other| other.name != dial.name) {
                    let (before, after) = (other.value_in(&base), other.value_in(&moved));
                    assert_eq!(before.map(|v| v.name), after.map(|v| v.name), "{} moves {}", dial.name, other.name);
                }
            }
        }
    }

    #[test]
    fn every_dial_of_the_standard_has_a_name_for_it() {
        for dial in DIALS {
            assert!(dial.value_in(&RenderOptions::standard()).is_some(), "{}", dial.name);
        }
    }

    #[test]
    fn the_exact_render_approximates_nothing() {
        let exact = Dial::all_exact(RenderOptions::fast());
        assert_eq!((exact.alpha_min, exact.transmittance_min, exact.alpha_max), (1e-12, 0.0, 1.0));
        assert_eq!((exact.blur, exact.near), (RenderOptions::fast().blur, RenderOptions::fast().near));
    }

    #[test]
    fn bounds_add_up() {
        let found = Dial::rms_bound(&RenderOptions::standard());
        assert!((found - (ROUNDING_RMS + 0.04 + 0.01 + 0.02)).abs() < 1e-12, "{found}");
    }
}
