//! The scalars of a step, and the band in which the first rate applies.

/// Number of values of a verdict.
pub const VERDICT: usize = 2;

/// Highest bit of a verdict's second number, which all further gradients share.
pub const LAST_BIT: usize = 30;

/// Learning rates of a parameter with rows of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Rate of the first [`Self::width`] numbers of each row.
    pub first: f64,
    /// Rate of all other numbers.
    pub others: f64,
    /// Numbers of a row that have the first rate.
    pub width: usize,
}

impl From<f64> for Rates {
    /// Uses one rate for all numbers.
    fn from(rate: f64) -> Self {
        Self { first: rate, others: rate, width: 0 }
    }
}

impl Rates {
    /// Multiplies both rates by `factor`.
    pub fn times(self, factor: f64) -> Self {
        Self { first: self.first * factor, others: self.others * factor, ..self }
    }

    /// Returns the band in which the first rate applies, in a parameter of shape `dims` with a row for each index of the first
    /// dimension. `None` if there is only one rate.
    pub fn band(&self, dims: &[usize]) -> Option<Band> {
        let period = dims.get(1..).unwrap_or_default().iter().product::<usize>();
        let width = self.width.min(period);
        (self.first != self.others && width > 0).then_some(Band { period, width })
    }
}

/// The first `width` of every `period` numbers, row-major. Neither is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Band {
    /// Distance between the starts of two bands, in numbers.
    pub period: usize,
    /// Length of a band, in numbers.
    pub width: usize,
}

/// The scalars of one step; see [`adam`](crate::adam).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors {
    /// Decay β₁ of the first moment.
    pub beta1: f64,
    /// Decay β₂ of the second moment.
    pub beta2: f64,
    /// Learning rates, including both bias corrections.
    pub rate: Rates,
    /// Term added to the square root of the second moment, above 0.
    pub floor: f64,
    /// Largest absolute value to which gradients are clamped.
    pub largest: f64,
}

/// Gradients in a launch of the check for finite values.
pub(super) const WATCHED: usize = 5;
