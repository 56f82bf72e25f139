//! Values of a kernel as a [`Number`]. A formula that a kernel shares with its CPU twin is an ordinary generic function. Run on these
//! numbers, while the kernel is compiled, it writes its operations into the kernel.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use cubecl::prelude::*;

use super::math::{Vec3Expand, finite};
use crate::linalg::Number;

/// A value of the kernel that is being compiled.
#[derive(Clone, Copy)]
pub(crate) struct KernelNumber<'a> {
    scope: &'a Scope,
    pub value: NativeExpand<f32>,
}

/// A truth value of the kernel that is being compiled.
#[derive(Clone, Copy)]
pub(crate) struct KernelMask<'a> {
    scope: &'a Scope,
    pub value: NativeExpand<bool>,
}

impl<'a> KernelNumber<'a> {
    /// Reads a value.
    pub fn of(scope: &'a Scope, value: NativeExpand<f32>) -> Self {
        Self { scope, value: value.__expand_deref_method(scope) }
    }

    /// Reads a vector.
    pub fn vector(scope: &'a Scope, v: Vec3Expand) -> [Self; 3] {
        [Self::of(scope, v.x), Self::of(scope, v.y), Self::of(scope, v.z)]
    }

    /// Reads a row.
    pub fn row(scope: &'a Scope, row: &SequenceExpand<f32>) -> Vec<Self> {
        row.iter_cloned().map(|value| Self::of(scope, value)).collect()
    }

    /// Returns numbers as a row.
    pub fn sequence<const C: usize>(row: [Self; C]) -> SequenceExpand<f32> {
        let scope = row[0].scope;
        let mut out = Sequence::<f32>::__expand_new(scope);
        for number in row {
            out.__expand_push_method(scope, number.value);
        }
        out
    }
}

impl<'a> KernelMask<'a> {
    /// Reads a truth value.
    pub fn of(scope: &'a Scope, value: NativeExpand<bool>) -> Self {
        Self { scope, value: value.__expand_deref_method(scope) }
    }
}

/// Returns numbers as a vector of the kernel.
pub(crate) fn vec3([x, y, z]: [KernelNumber; 3]) -> Vec3Expand {
    Vec3Expand { x: x.value, y: y.value, z: z.value }
}

macro_rules! operators {
    ($($trait:ident :: $name:ident($($other:ident)?) for $kind:ident = $expand:ident),*) => {$(
        impl $trait for $kind<'_> {
            type Output = Self;

            fn $name(self $(, $other: Self)?) -> Self {
                Self { scope: self.scope, value: self.value.$expand(self.scope $(, $other.value)?) }
            }
        }
    )*};
}

operators!(
    Add::add(other) for KernelNumber = __expand_add_method,
    Sub::sub(other) for KernelNumber = __expand_sub_method,
    Mul::mul(other) for KernelNumber = __expand_mul_method,
    Div::div(other) for KernelNumber = __expand_div_method,
    Neg::neg() for KernelNumber = __expand_neg_method,
    BitAnd::bitand(other) for KernelMask = __expand_and_method,
    BitOr::bitor(other) for KernelMask = __expand_or_method,
    Not::not() for KernelMask = __expand_not_method
);

macro_rules! operators_with_constants {
    ($($trait:ident :: $name:ident),*) => {$(
        impl $trait<f64> for KernelNumber<'_> {
            type Output = Self;

            fn $name(self, other: f64) -> Self {
                $trait::$name(self, self.constant(other))
            }
        }
    )*};
}

operators_with_constants!(Add::add, Sub::sub, Mul::mul, Div::div);

macro_rules! functions {
    ($($name:ident = $expand:ident),*) => {$(
        fn $name(self) -> Self {
            Self { scope: self.scope, value: self.value.$expand(self.scope) }
        }
    )*};
}

macro_rules! comparisons {
    ($($name:ident = $expand:ident),*) => {$(
        fn $name(self, other: Self) -> Self::Mask {
            KernelMask { scope: self.scope, value: self.value.$expand(self.scope, &other.value) }
        }
    )*};
}

impl<'a> Number for KernelNumber<'a> {
    type Mask = KernelMask<'a>;
    const DOUBLE: bool = false;

    fn constant(self, value: f64) -> Self {
        Self { scope: self.scope, value: NativeExpand::from_lit(self.scope, value as f32) }
    }

    fn mul_add(self, factor: Self, addend: Self) -> Self {
        self * factor + addend
    }

    functions!(sqrt = __expand_sqrt_method, ln = __expand_ln_method, abs = __expand_abs_method);

    fn min(self, other: Self) -> Self {
        Self { scope: self.scope, value: min::expand(self.scope, self.value, other.value) }
    }

    fn max(self, other: Self) -> Self {
        Self { scope: self.scope, value: max::expand(self.scope, self.value, other.value) }
    }

    comparisons!(
        lt = __expand_lt_method,
        le = __expand_le_method,
        gt = __expand_gt_method,
        ge = __expand_ge_method,
        eq = __expand_eq_method
    );

    fn finite(self) -> KernelMask<'a> {
        KernelMask { scope: self.scope, value: finite::expand(self.scope, self.value) }
    }

    fn select(mask: KernelMask<'a>, then: Self, or: Self) -> Self {
        Self { scope: mask.scope, value: select::expand(mask.scope, mask.value, then.value, or.value) }
    }

    fn any(_: KernelMask<'a>) -> bool {
        true
    }

    fn length(v: [Self; 3]) -> Self {
        let scope = v[0].scope;
        Self { scope, value: vec3(v).__expand_length_method(scope) }
    }
}

/// Loads a row of numbers.
#[cube]
pub(crate) fn load_row(from: &[f32], at: usize, #[comptime] columns: usize) -> Sequence<f32> {
    let mut row = Sequence::<f32>::new();
    #[unroll]
    for column in 0..columns {
        row.push(from[at + column]);
    }
    row
}

/// Stores a row of numbers.
#[cube]
pub(crate) fn store_row(row: &Sequence<f32>, to: &mut [f32], at: usize) {
    let columns = comptime!(row.len());
    #[unroll]
    for column in 0..columns {
        to[at + column] = row[column];
    }
}
