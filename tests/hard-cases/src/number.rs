//! The number types of the textbook formulas: f32, as in most implementations, f64, and [`Wide`], in which the
//! same formulas are the reference.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A floating-point number of any width.
pub trait Number:
    Copy
    + Debug
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The nearest value.
    fn of(value: f64) -> Self;
    fn f64(self) -> f64;
    fn sqrt(self) -> Self;
    fn exp(self) -> Self;
}

macro_rules! number {
    ($float:ty) => {
        impl Number for $float {
            fn of(value: f64) -> Self {
                value as $float
            }
            fn f64(self) -> f64 {
                f64::from(self)
            }
            fn sqrt(self) -> Self {
                <$float>::sqrt(self)
            }
            fn exp(self) -> Self {
                <$float>::exp(self)
            }
        }
    };
}
number!(f32);
number!(f64);

/// A sum of two f64, the second below half an ulp of the first: about 106 bits, with the range of an f64 (Dekker
/// 1971; sequences of operations from Hida, Li and Bailey 2001, "Algorithms for quad-double precision").
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Wide {
    high: f64,
    low: f64,
}

impl Wide {
    /// ln 2.
    const LN_2: Self = Self { high: std::f64::consts::LN_2, low: 2.319_046_813_846_299_6e-17 };

    /// `a + b` without error, for `|a| >= |b|`.
    fn of_ordered(a: f64, b: f64) -> Self {
        let high = a + b;
        // A value that is not finite has no rounding error, and `inf - inf` would produce one.
        Self { high, low: if high.is_finite() { b - (high - a) } else { 0.0 } }
    }

    /// `a + b` without error.
    fn of_sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let b_seen = high - a;
        let low = (a - (high - b_seen)) + (b - b_seen);
        Self { high, low: if high.is_finite() { low } else { 0.0 } }
    }

    /// `a b` without error, unless it underflows.
    fn of_product(a: f64, b: f64) -> Self {
        let high = a * b;
        Self { high, low: if high.is_finite() { a.mul_add(b, -high) } else { 0.0 } }
    }

    /// Product with a power of two.
    fn scaled(self, factor: f64) -> Self {
        Self { high: self.high * factor, low: self.low * factor }
    }
}

impl Add for Wide {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let sum = Self::of_sum(self.high, other.high);
        let rest = Self::of_sum(self.low, other.low);
        let sum = Self::of_ordered(sum.high, sum.low + rest.high);
        Self::of_ordered(sum.high, sum.low + rest.low)
    }
}

impl Neg for Wide {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Sub for Wide {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Wide {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = Self::of_product(self.high, other.high);
        Self::of_ordered(product.high, product.low + (self.high * other.low + self.low * other.high))
    }
}

impl Div for Wide {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        if !first.is_finite() || first == 0.0 {
            return Self { high: first, low: 0.0 };
        }
        // Long division: each digit is a quotient of leading parts.
        let rest = self - other * Self::of(first);
        let second = rest.high / other.high;
        let rest = rest - other * Self::of(second);
        let third = rest.high / other.high;
        Self::of_ordered(first, second) + Self::of(third)
    }
}

impl Number for Wide {
    fn of(value: f64) -> Self {
        Self { high: value, low: 0.0 }
    }

    fn f64(self) -> f64 {
        self.high + self.low
    }

    fn sqrt(self) -> Self {
        if !(self.high > 0.0) {
            return Self::of(self.high.sqrt());
        }
        // One step of Newton's method from the f64 root doubles its digits.
        let root = self.high.sqrt();
        let rest = self - Self::of_product(root, root);
        Self::of_ordered(root, rest.high / (2.0 * root))
    }

    fn exp(self) -> Self {
        if self.high.is_nan() || self.high > 709.0 {
            return Self::of(self.high.exp());
        }
        if self.high < -708.0 {
            return Self::of(0.0);
        }
        // x = n ln 2 + 512 r; the series gives e^r - 1, which is squared nine times as (1 + p)² - 1 = 2p + p², so that the
        // addition of one costs no digits.
        const HALVINGS: i32 = 9;
        let n = (self.high / std::f64::consts::LN_2).round();
        let r = (self - Self::LN_2 * Self::of(n)).scaled(0.5_f64.powi(HALVINGS));
        // |r| < 7e-4: the tenth term is below 1e-38.
        let mut series = Self::of(1.0);
        for k in (2..=10).rev() {
            series = Self::of(1.0) + r * series / Self::of(f64::from(k));
        }
        let mut p = r * series;
        for _ in 0..HALVINGS {
            p = p.scaled(2.0) + p * p;
        }
        (p + Self::of(1.0)).scaled(2.0_f64.powi(n as i32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: Wide, expected: Wide, tolerance: f64) {
        let error = ((found - expected) / expected).f64().abs();
        assert!(error <= tolerance, "{found:?}, expected {expected:?}: {error:e}");
    }

    #[test]
    fn thirty_digits_are_kept() {
        // (1 + 2⁻⁹⁰) − 1 is zero in f64.
        let small = 2.0_f64.powi(-90);
        assert_eq!((Wide::of(1.0) + Wide::of(small) - Wide::of(1.0)).f64(), small);
        let third = Wide::of(1.0) / Wide::of(3.0);
        close(third * Wide::of(3.0), Wide::of(1.0), 1e-31);
        let root = Wide::of(2.0).sqrt();
        close(root * root, Wide::of(2.0), 1e-31);
        // (a + b)(a − b) = a² − b² holds to the last digits.
        let (a, b) = (Wide::of(1e8) + Wide::of(1e-9), Wide::of(1e8) - third);
        close((a + b) * (a - b), a * a - b * b, 1e-21);
    }

    #[test]
    fn the_exponential_is_a_homomorphism_and_agrees_with_f64() {
        for x in [-600.0, -87.3, -3.7, -1e-9, 0.0, 1e-20, 0.3, 5.5, 50.0] {
            let (found, expected) = (Wide::of(x).exp(), x.exp());
            assert!((found.f64() / expected - 1.0).abs() <= 4e-16, "{x}: {found:?}, {expected}");
            let third = Wide::of(x) / Wide::of(3.0);
            close(third.exp() * third.exp() * third.exp(), found, 1e-28);
        }
        assert_eq!(Wide::of(-1e300).exp().f64(), 0.0);
        // e to 32 digits (OEIS A001113).
        let e = Wide { high: std::f64::consts::E, low: 1.445_646_891_729_250_2e-16 };
        close(Wide::of(1.0).exp(), e, 1e-30);
    }
}
