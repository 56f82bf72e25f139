//! The scalars of a step, and where which rate holds.

/// Numbers of a verdict.
pub const VERDICT: usize = 2;

/// The rates of a parameter `[N, K, …]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of what has index 0 in the second dimension.
    pub first: f64,
    /// Of all else, and of parameters of one dimension.
    pub others: f64,
}

impl From<f64> for Rates {
    /// One rate for all.
    fn from(rate: f64) -> Self {
        Self { first: rate, others: rate }
    }
}

impl Rates {
    /// Both times `factor`.
    pub fn times(self, factor: f64) -> Self {
        Self { first: self.first * factor, others: self.others * factor }
    }

    /// Where the first rate holds in a parameter of the shape `dims`: what has index 0 in its second dimension. `None` if
    /// there is one rate for all.
    pub fn band(&self, dims: &[usize]) -> Option<Band> {
        let width = dims.get(2..).unwrap_or_default().iter().product::<usize>();
        let period = dims.get(1).map_or(0, |rows| rows * width);
        (self.first != self.others && period > 0).then_some(Band { period, width })
    }
}

/// The first `width` of every `period` numbers, row-major. Neither is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Band {
    /// Numbers from one band to the next.
    pub period: usize,
    /// Numbers of one band.
    pub width: usize,
}

/// The scalars of one step; see [`adam`](crate::adam).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors {
    /// Share of the first moment that is kept.
    pub beta1: f64,
    /// Share of the second moment that is kept.
    pub beta2: f64,
    /// The learning rates with both bias corrections.
    pub rate: Rates,
    /// Added to the root of the second moment, above 0.
    pub floor: f64,
    /// The largest absolute value of a gradient that is computed with.
    pub largest: f64,
}
