//! Adam's moments, in 32, 16 or 8 bits each.

use std::fmt;
use std::str::FromStr;

use burn::tensor::kind::Basic;
use burn::tensor::{DType, Device, Int, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::adam::packed::Packing;

use crate::gaussians::joined;
use crate::state::{State, StateError};

/// Bits of each of Adam's moments. Fewer take less memory and make steps less exact (see [`splat_op::adam::packed`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum MomentBits {
    /// Floats of 32 bits.
    #[default]
    ThirtyTwo,
    /// 16 bits.
    Sixteen,
    /// 8 bits.
    Eight,
}

impl MomentBits {
    /// All values, the most exact first.
    pub const ALL: [Self; 3] = [Self::ThirtyTwo, Self::Sixteen, Self::Eight];

    /// Bytes of both moments of a row of `width` numbers.
    pub fn bytes(self, width: usize) -> usize {
        size_of::<f32>() * self.packing().map_or(2 * width, |packing| packing.words_per_row(width))
    }

    fn packing(self) -> Option<Packing> {
        match self {
            Self::ThirtyTwo => None,
            Self::Sixteen => Some(Packing::Sixteen),
            Self::Eight => Some(Packing::Eight),
        }
    }
}

impl From<MomentBits> for u8 {
    fn from(bits: MomentBits) -> Self {
        match bits {
            MomentBits::ThirtyTwo => 32,
            MomentBits::Sixteen => 16,
            MomentBits::Eight => 8,
        }
    }
}

impl TryFrom<u8> for MomentBits {
    type Error = String;

    fn try_from(bits: u8) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|all| u8::from(*all) == bits);
        found.ok_or_else(|| format!("moments of {bits} bits, expected 32, 16 or 8"))
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
        text.parse::<u8>().map_err(|_| format!("`{text}`, expected 32, 16 or 8"))?.try_into()
    }
}

/// Running sums over the gradients of one parameter, without autodiff.
///
/// They are the paper's `m` and `v` divided by `1 − β₁` and `1 − β₂`, which saves two passes over memory per step; scalar
/// factors compensate for it. Zero means "no history", and rows may be moved, copied or zeroed with the parameter's.
#[derive(Clone, Debug)]
pub struct Moments<const D: usize>(pub(crate) Stored<D>);

/// How moments are stored.
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
    /// Codes in words, row by row of the parameter.
    Packed {
        /// `[N, words]`, i32.
        words: Tensor<2, Int>,
        packing: Packing,
    },
}

impl<const D: usize> Moments<D> {
    /// Moments without history, in 32 bits, for a parameter of the shape of `param`.
    pub fn new(param: &Tensor<D>) -> Self {
        Self::with_bits(param, MomentBits::ThirtyTwo)
    }

    /// Moments without history for a parameter of the shape of `param`. Fewer bits than 32 are for parameters in f32.
    pub fn with_bits(param: &Tensor<D>, bits: MomentBits) -> Self {
        let Some(packing) = bits.packing() else {
            let m = param.clone().inner().zeros_like();
            return Self::full(m.zeros_like(), m);
        };
        let shape = words_shape(param.dims(), packing);
        Self(Stored::Packed { words: Tensor::zeros(shape, (&param.device().inner(), DType::I32)), packing })
    }

    /// Moments without history and with as many bits, for another parameter.
    pub(crate) fn anew(&self, param: &Tensor<D>) -> Self {
        Self::with_bits(param, self.bits())
    }

    pub(crate) fn full(m: Tensor<D>, v: Tensor<D>) -> Self {
        Self(Stored::Full { m, v })
    }

    /// Bits of each moment.
    pub fn bits(&self) -> MomentBits {
        match self.0 {
            Stored::Full { .. } => MomentBits::ThirtyTwo,
            Stored::Packed { packing: Packing::Sixteen, .. } => MomentBits::Sixteen,
            Stored::Packed { packing: Packing::Eight, .. } => MomentBits::Eight,
        }
    }

    /// Moves the sums out, so that no other reference exists.
    pub(crate) fn take(&mut self) -> Self {
        fn emptied<const R: usize, K: Basic>(tensor: &mut Tensor<R, K>) -> Tensor<R, K> {
            let empty = Tensor::empty([0; R], (&tensor.device(), tensor.dtype()));
            std::mem::replace(tensor, empty)
        }
        Self(match &mut self.0 {
            Stored::Full { m, v } => Stored::Full { m: emptied(m), v: emptied(v) },
            Stored::Packed { words, packing } => Stored::Packed { words: emptied(words), packing: *packing },
        })
    }

    /// Changes the tensors in place: `full` both sums, or `packed` the words.
    fn map(
        &mut self,
        full: impl Fn(Tensor<D>) -> Tensor<D>,
        packed: impl FnOnce(Tensor<2, Int>, Packing) -> Tensor<2, Int>,
    ) {
        match &mut self.0 {
            Stored::Full { m, v } => {
                m.inplace(&full);
                v.inplace(&full);
            }
            Stored::Packed { words, packing } => words.inplace(|words| packed(words, *packing)),
        }
    }

    /// Keeps the rows `keep`, `[K]`, and appends `added` rows without history.
    pub(crate) fn edit(&mut self, keep: &Tensor<1, Int>, added: usize) {
        self.map(|sums| edited(sums, keep, added), |words, _| edited(words, keep, added));
    }

    /// Some rows, on a device.
    pub(crate) fn rows(&self, first: usize, count: usize, device: &Device) -> Self {
        fn of<const R: usize, K: Basic>(
            all: &Tensor<R, K>,
            first: usize,
            count: usize,
            device: &Device,
        ) -> Tensor<R, K> {
            let all = all.clone();
            let part = if count == all.dims()[0] { all } else { all.narrow(0, first, count) };
            part.to_device(device)
        }
        Self(match &self.0 {
            Stored::Full { m, v } => Stored::Full { m: of(m, first, count, device), v: of(v, first, count, device) },
            Stored::Packed { words, packing } => {
                Stored::Packed { words: of(words, first, count, device), packing: *packing }
            }
        })
    }

    /// Saves the moments.
    pub fn save(&self, to: &mut State) {
        match &self.0 {
            Stored::Full { m, v } => {
                to.put("m", m.clone());
                to.put("v", v.clone());
            }
            Stored::Packed { words, .. } => to.put_words(&format!("moments{}", self.bits()), words.clone()),
        }
    }

    /// Loads the moments of a parameter of this shape, in 32 bits.
    ///
    /// # Errors
    /// If they are missing or of another shape.
    pub fn load(from: &mut State, shape: [usize; D], device: &Device) -> Result<Self, StateError> {
        Self::load_with_bits(from, shape, MomentBits::ThirtyTwo, device)
    }

    /// Loads the moments of a parameter of this shape.
    ///
    /// # Errors
    /// If they are missing, of another shape, or have another number of bits.
    pub fn load_with_bits(
        from: &mut State,
        shape: [usize; D],
        bits: MomentBits,
        device: &Device,
    ) -> Result<Self, StateError> {
        let Some(packing) = bits.packing() else {
            let [m, v] = ["m", "v"].map(|name| from.take_shaped(name, shape, device));
            return Ok(Self::full(m?, v?));
        };
        let words = from.take_words(&format!("moments{bits}"), words_shape(shape, packing), device)?;
        Ok(Self(Stored::Packed { words, packing }))
    }
}

impl Moments<3> {
    /// Extends each row to `coefficients` coefficients, the new ones without history.
    pub(crate) fn grow(&mut self, coefficients: usize, channels: usize) {
        self.map(
            |sums| grown(sums, coefficients),
            // Codes beyond the end of a row are zero.
            |words, packing| grown(words, packing.words_per_row(coefficients * channels)),
        );
    }

    /// The moments of several blocks of rows as one.
    pub(crate) fn join(blocks: Vec<Self>) -> Self {
        let (mut of_m, mut of_v, mut of_words) = (Vec::new(), Vec::new(), Vec::new());
        let mut found = None;
        for Self(block) in blocks {
            match block {
                Stored::Full { m, v } => {
                    of_m.push(m);
                    of_v.push(v);
                }
                Stored::Packed { words, packing } => {
                    of_words.push(words);
                    found = Some(packing);
                }
            }
        }
        match found {
            Some(packing) => Self(Stored::Packed { words: joined(of_words), packing }),
            None => Self::full(joined(of_m), joined(of_v)),
        }
    }
}

/// The shape of the words of a parameter.
fn words_shape<const D: usize>(shape: [usize; D], packing: Packing) -> [usize; 2] {
    [shape[0], packing.words_per_row(shape[1..].iter().product())]
}

/// The rows `keep`, `[K]`, followed by `added` rows of zeros.
fn edited<const R: usize, K: Basic>(old: Tensor<R, K>, keep: &Tensor<1, Int>, added: usize) -> Tensor<R, K> {
    let mut shape = old.dims();
    shape[0] = added;
    let zeros = Tensor::zeros(shape, (&old.device(), old.dtype()));
    Tensor::cat(vec![old.select(0, keep.clone()), zeros], 0)
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
impl<const D: usize> Moments<D> {
    /// The tensors as numbers, for comparisons: both sums, or the words and nothing.
    pub(crate) fn numbers(&self) -> [Vec<f32>; 2] {
        use crate::gaussians::values_of;
        match &self.0 {
            Stored::Full { m, v } => [values_of(m.clone()), values_of(v.clone())],
            Stored::Packed { words, .. } => {
                let words = words.clone().into_data().try_into_vec::<i32>().expect("words are i32");
                // Numbers that compare as their bits do.
                let halves = |shift: u32| words.iter().map(|word| (*word as u32 >> shift & 0xffff) as f32).collect();
                [halves(0), halves(16)]
            }
        }
    }
}

#[cfg(test)]
mod tests;
