//! Adam's moments, in 32 or 8 bits each.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use burn::tensor::kind::Basic;
use burn::tensor::{DType, Device, Int, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::adam::packed::words_per_row;

use crate::state::{State, StateError};

/// Bits of each of Adam's moments. Fewer take less memory and make steps less exact (see [`splat_op::adam::packed`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum MomentBits {
    /// Floats of 32 bits.
    #[default]
    ThirtyTwo = 32,
    /// 8 bits.
    Eight = 8,
}

impl MomentBits {
    /// All values, the most exact first.
    pub const ALL: [Self; 2] = [Self::ThirtyTwo, Self::Eight];

    /// Bytes of both moments of a row of `width` numbers.
    pub fn bytes(self, width: usize) -> usize {
        let words = match self {
            Self::ThirtyTwo => 2 * width,
            Self::Eight => words_per_row(width),
        };
        size_of::<f32>() * words
    }
}

impl From<MomentBits> for u8 {
    fn from(bits: MomentBits) -> Self {
        bits as Self
    }
}

impl TryFrom<u8> for MomentBits {
    type Error = String;

    fn try_from(bits: u8) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|all| u8::from(*all) == bits);
        found.ok_or_else(|| format!("moments of {bits} bits, expected 32 or 8"))
    }
}

impl fmt::Display for MomentBits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        u8::from(*self).fmt(f)
    }
}

impl FromStr for MomentBits {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<u8>().map_err(|_| format!("`{text}`, expected 32 or 8"))?.try_into()
    }
}

/// Running sums over the gradients of one parameter, without autodiff.
///
/// They are the paper's `m` and `v` divided by `1 − β₁` and `1 − β₂`, which saves two passes over memory per step; scalar
/// factors compensate for it. Zero means "no history", and rows may be moved, copied or zeroed with the parameter's.
#[derive(Clone, Debug)]
pub struct Moments<const D: usize>(Option<Stored<D>>);

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "handles of tensors, a few for a scene")]
pub(crate) enum Stored<const D: usize> {
    /// Two tensors of the parameter's shape.
    Full {
        /// `Σ β₁ᵏ g`
        m: Tensor<D>,
        /// `Σ β₂ᵏ g²`
        v: Tensor<D>,
    },
    /// `[N, words]`, i32: codes in words, row by row of the parameter.
    Packed(Tensor<2, Int>),
}

impl<const D: usize> Moments<D> {
    /// Moments without history, in 32 bits, for a parameter of the shape of `param`.
    pub fn new(param: &Tensor<D>) -> Self {
        Self::with_bits(param, MomentBits::ThirtyTwo)
    }

    /// Moments without history for a parameter of the shape of `param`. Fewer bits than 32 are for parameters in f32.
    pub fn with_bits(param: &Tensor<D>, bits: MomentBits) -> Self {
        if bits == MomentBits::ThirtyTwo {
            let m = param.clone().inner().zeros_like();
            return Self::full(m.zeros_like(), m);
        }
        Self::packed(Tensor::zeros(words_shape(param.dims()), (&param.device().inner(), DType::I32)))
    }

    pub(crate) fn full(m: Tensor<D>, v: Tensor<D>) -> Self {
        Self(Some(Stored::Full { m, v }))
    }

    pub(crate) fn packed(words: Tensor<2, Int>) -> Self {
        Self(Some(Stored::Packed(words)))
    }

    pub(crate) fn stored(&self) -> &Stored<D> {
        self.0.as_ref().expect("whoever takes moments puts others in their place")
    }

    /// Moves the sums out, so that no other reference exists. Moments of the next step take their place.
    pub(crate) fn take(&mut self) -> Stored<D> {
        self.0.take().expect("whoever takes moments puts others in their place")
    }

    /// Bits of each moment.
    pub fn bits(&self) -> MomentBits {
        match self.stored() {
            Stored::Full { .. } => MomentBits::ThirtyTwo,
            Stored::Packed(_) => MomentBits::Eight,
        }
    }

    /// The moments of the rows `source`, `[M]`, which are counted through all blocks. Those from row `kept` on have no history.
    pub(crate) fn gathered(blocks: &[Stored<D>], source: &Tensor<1, Int>, kept: usize) -> Self {
        let (mut m, mut v, mut words) = (Vec::new(), Vec::new(), Vec::new());
        for block in blocks {
            match block {
                Stored::Full { m: first, v: second } => {
                    m.push(first.clone());
                    v.push(second.clone());
                }
                Stored::Packed(of_block) => words.push(of_block.clone()),
            }
        }
        match words.is_empty() {
            true => Self::full(continued(&m, source, kept), continued(&v, source, kept)),
            false => Self::packed(continued(&words, source, kept)),
        }
    }

    pub(crate) fn rows(&self, rows: Range<usize>, device: &Device) -> Self {
        fn of<const R: usize, K: Basic>(all: &Tensor<R, K>, rows: &Range<usize>, device: &Device) -> Tensor<R, K> {
            let all = all.clone();
            let part = if rows.len() == all.dims()[0] { all } else { all.narrow(0, rows.start, rows.len()) };
            part.to_device(device)
        }
        match self.stored() {
            Stored::Full { m, v } => Self::full(of(m, &rows, device), of(v, &rows, device)),
            Stored::Packed(words) => Self::packed(of(words, &rows, device)),
        }
    }

    /// Saves the moments.
    pub fn save(&self, to: &mut State) {
        match self.stored() {
            Stored::Full { m, v } => {
                to.put("m", m.clone());
                to.put("v", v.clone());
            }
            Stored::Packed(words) => to.put(&format!("moments{}", self.bits()), words.clone()),
        }
    }

    /// Loads the moments of a parameter of this shape.
    ///
    /// # Errors
    /// If they are missing, of another shape, or have another number of bits.
    pub fn load(from: &mut State, shape: [usize; D], bits: MomentBits, device: &Device) -> Result<Self, StateError> {
        if bits == MomentBits::ThirtyTwo {
            let [m, v] = ["m", "v"].map(|name| from.take_shaped(name, shape, device));
            return Ok(Self::full(m?, v?));
        }
        Ok(Self::packed(from.take_shaped(&format!("moments{bits}"), words_shape(shape), device)?))
    }
}

impl Moments<2> {
    /// Extends each row to `width` numbers, the new ones without history.
    pub(crate) fn grow(&mut self, width: usize) {
        *self = match self.take() {
            Stored::Full { m, v } => Self::full(grown(m, width), grown(v, width)),
            // Codes beyond the end of a row are zero.
            Stored::Packed(words) => Self::packed(grown(words, words_per_row(width))),
        };
    }
}

fn words_shape<const D: usize>(shape: [usize; D]) -> [usize; 2] {
    [shape[0], words_per_row(shape[1..].iter().product())]
}

/// The first `kept` of the rows `source`, `[M]`, of several blocks, followed by rows of zeros.
fn continued<const R: usize, K: Basic>(blocks: &[Tensor<R, K>], source: &Tensor<1, Int>, kept: usize) -> Tensor<R, K> {
    let mut shape = blocks[0].dims();
    shape[0] = source.dims()[0] - kept;
    if shape[0] == 0 {
        return gathered(blocks, source);
    }
    let zeros = Tensor::zeros(shape, (&blocks[0].device(), blocks[0].dtype()));
    followed(blocks, source, kept, zeros)
}

/// The first `kept` of the rows `source`, `[M]`, of several blocks, followed by `new` rows.
pub(crate) fn followed<const R: usize, K: Basic>(
    blocks: &[Tensor<R, K>],
    source: &Tensor<1, Int>,
    kept: usize,
    new: Tensor<R, K>,
) -> Tensor<R, K> {
    if kept == 0 { new } else { Tensor::cat(vec![gathered(blocks, &source.clone().narrow(0, 0, kept)), new], 0) }
}

/// The rows `source`, `[M]`, of several blocks of rows, which are counted through all blocks.
pub(crate) fn gathered<const R: usize, K: Basic>(blocks: &[Tensor<R, K>], source: &Tensor<1, Int>) -> Tensor<R, K> {
    let mut shape = blocks[0].dims();
    shape[0] = source.dims()[0];
    let width: usize = shape[1..].iter().product();
    // CPU devices copy whole rows of matrices at once.
    let flat = blocks.iter().map(|block| block.clone().reshape([block.dims()[0], width]));
    if blocks.len() == 1 {
        return flat.map(|block| block.select(0, source.clone())).next().expect("there is a block").reshape(shape);
    }
    let mut first = 0;
    let found = flat.map(|block| {
        let count = block.dims()[0] as i64;
        let own = source.clone() - first;
        let beyond = own.clone().lower_elem(0).bool_or(own.clone().greater_equal_elem(count));
        first += count;
        (block.select(0, own.clamp(0, count - 1)), beyond)
    });
    let found = found.reduce(|(found, elsewhere), (more, beyond)| {
        let mask = elsewhere.clone().reshape([shape[0], 1]).expand([shape[0], width]);
        (found.mask_where(mask, more), elsewhere.bool_and(beyond))
    });
    found.expect("there are several blocks").0.reshape(shape)
}

/// The tensor with zeros up to a length of its second dimension.
pub(crate) fn grown<const R: usize, K: Basic>(values: Tensor<R, K>, length: usize) -> Tensor<R, K> {
    let mut shape = values.dims();
    if shape[1] == length {
        return values;
    }
    shape[1] = length - shape[1];
    let zeros = Tensor::zeros(shape, (&values.device(), values.dtype()));
    Tensor::cat(vec![values, zeros], 1)
}

#[cfg(test)]
mod tests;
