//! Names and options of groups of parameters, and what is wrong with them.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The groups that every scene has, in this order, which are also the fields of [`RawSplats`](splat_op::RawSplats).
pub const BASE_GROUPS: [&str; 5] = ["means", "rotations", "log_scales", "logit_opacities", "sh"];

/// Place of the spherical harmonics in [`BASE_GROUPS`].
pub(crate) const SH: usize = 4;

/// How the numbers of a group become the values that are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Activation {
    /// The numbers themselves.
    #[default]
    Identity,
    /// `exp(x)`: positive values.
    Exp,
    /// `1 / (1 + exp(−x))`: values between 0 and 1.
    Sigmoid,
    /// `x / |x|`: rows of length 1. A row of zeros stays.
    Normalise,
}

/// The values of a row that density control adds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NewRows {
    /// Those of the row that it comes from.
    #[default]
    Copied,
    /// This number throughout.
    Filled(f32),
}

options! {
    /// How a group is trained. Groups of [`BASE_GROUPS`] are trained by [`LearningRates`](crate::optim::LearningRates) and density control
    /// instead, and ignore these options.
    #[derive(Copy)]
    pub struct GroupOptions {
        /// Learning rate at the first step: 0, which keeps the group as it is.
        pub rate: f64 = 0.0,
        /// Share of the rate that remains at the last step: 1. The rate falls exponentially.
        pub final_share: f64 = 1.0,
        /// How the numbers become values: unchanged.
        pub activation: Activation = Activation::Identity,
        /// The values of new rows: copies.
        pub new_rows: NewRows = NewRows::Copied,
        /// The value that all rows get, with moments of zero, whenever density control resets opacities: none.
        pub reset: Option<f32> = None,
    }
}

impl GroupOptions {
    /// Checks that all numbers can be used and saved.
    ///
    /// # Errors
    /// For the first that cannot.
    pub fn check(&self, name: &str) -> Result<(), RowsError> {
        let refuse = |option: &str, found: f64, expected: &str| {
            Err(RowsError(format!("`{option}` of the group `{name}` is {found}, expected {expected}")))
        };
        if !(self.rate >= 0.0 && self.rate.is_finite()) {
            return refuse("rate", self.rate, "a finite number that is not negative");
        }
        if !(self.final_share > 0.0 && self.final_share.is_finite()) {
            return refuse("final_share", self.final_share, "a finite number above 0");
        }
        match (self.new_rows, self.reset) {
            (NewRows::Filled(value), _) if !value.is_finite() => refuse("new_rows", value.into(), "a finite number"),
            (_, Some(value)) if !value.is_finite() => refuse("reset", value.into(), "a finite number"),
            _ => Ok(()),
        }
    }
}

/// Names of properties of every scene file, and of their parts before a number.
const RESERVED: [&str; 11] = ["x", "y", "z", "nx", "ny", "nz", "opacity", "f_dc", "f_rest", "scale", "rot"];

/// Refuses names that files cannot hold.
pub(crate) fn check_name(name: &str) -> Result<(), RowsError> {
    let bad = |c: char| c.is_whitespace() || c.is_control() || c == '/';
    let stem = name.rsplit_once('_').filter(|(_, i)| i.parse::<usize>().is_ok()).map_or(name, |(stem, _)| stem);
    match name.is_empty() || name.contains(bad) || RESERVED.contains(&name) || RESERVED.contains(&stem) {
        true => Err(RowsError(format!(
            "a group named {name:?}, expected a name without white space, control characters and slashes that is not one of a scene file's \
             own properties, such as `x` and `scale_0`"
        ))),
        false => Ok(()),
    }
}

/// Rows or groups that do not fit together, or a group that cannot be used: what was found, and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct RowsError(pub(crate) String);

impl RowsError {
    /// The error for a field or group of another length than `count` Gaussians have.
    pub(crate) fn length(field: &str, found: usize, expected: usize, count: usize, sh_degree: usize) -> Self {
        Self(format!(
            "`{field}` holds {found} numbers, expected {expected} for {count} Gaussians of degree {sh_degree}"
        ))
    }

    /// The error for two groups of one name.
    pub(super) fn taken(name: &str) -> Self {
        Self(format!("two groups are named `{name}`, expected one of each name"))
    }

    /// The error for a group without numbers.
    pub(super) fn empty(name: &str) -> Self {
        Self(format!("the group `{name}` has rows of 0 numbers, expected at least 1"))
    }
}
