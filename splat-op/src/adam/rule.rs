//! The scalars of a step, and the band in which the first rate applies.

/// Number of values of a verdict.
pub const VERDICT: usize = 2;

/// Learning rates of a parameter `[N, K, …]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Rate of index 0 of the second dimension.
    pub first: f64,
    /// Rate of all other indices, and of parameters of one dimension.
    pub others: f64,
}

impl From<f64> for Rates {
    /// Uses one rate for all indices.
    fn from(rate: f64) -> Self {
        Self { first: rate, others: rate }
    }
}

impl Rates {
    /// Multiplies both rates by `factor`.
    pub fn times(self, factor: f64) -> Self {
        Self { first: self.first * factor, others: self.others * factor }
    }

    /// Returns the band in which the first rate applies, index 0 of the second dimension, in a parameter of shape `dims`.
    /// `None` if there is only one rate.
    pub fn band(&self, dims: &[usize]) -> Option<Band> {
        let width = dims.get(2..).unwrap_or_default().iter().product::<usize>();
        let period = dims.get(1).map_or(0, |rows| rows * width);
        (self.first != self.others && period > 0).then_some(Band { period, width })
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
