//! The saved state of a run, from which it can continue: arrays and facts, by name.
//!
//! Each part of a run puts its entries into a [`State`] and takes the same entries out again. Parts are nested like folders, so
//! each part chooses its names freely. [`State::finish`] reports an entry that was not taken, because it would be lost.

mod file;

use std::collections::BTreeMap;
use std::mem;

use burn::tensor::kind::Basic;
use burn::tensor::{DType, Device, Element, Int, Tensor, TensorData};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

pub use self::file::FileError;

/// An entry of a state that is missing, wrong or left over.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StateError {
    /// The entry is missing.
    #[error("there is no `{name}`, which this version requires; start a new run")]
    Missing {
        /// Name of the entry.
        name: String,
    },
    /// An array does not have the expected shape.
    #[error("`{name}` has the shape {found:?}, expected {expected}; start a new run")]
    Shape {
        /// Name of the entry.
        name: String,
        /// Shape in the state.
        found: Vec<usize>,
        /// Expected shape.
        expected: String,
    },
    /// A fact has another type, or cannot be represented as JSON.
    #[error("`{name}` does not have the form that this version requires: {source}; start a new run")]
    Fact {
        /// Name of the entry.
        name: String,
        /// The reason.
        source: serde_json::Error,
    },
    /// An entry was not taken.
    #[error("`{name}` is unknown to this version; continue with the version that wrote it, or start a new run")]
    Unknown {
        /// Name of the entry.
        name: String,
    },
}

/// An array, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Values,
}

/// The elements of an array.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Values {
    F32(Vec<f32>),
    /// Words of 32 bits.
    I32(Vec<i32>),
}

impl Values {
    pub(crate) fn bytes(&self) -> &[u8] {
        match self {
            Self::F32(values) => bytemuck::cast_slice(values),
            Self::I32(words) => bytemuck::cast_slice(words),
        }
    }
}

/// Arrays of f32 or of words, and facts, each with a unique name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    pub(crate) arrays: BTreeMap<String, Array>,
    /// Facts by name, as JSON.
    pub(crate) facts: BTreeMap<String, String>,
    /// Path of the part that is saved or loaded: empty, or ends with a slash.
    within: String,
}

impl State {
    /// Saves a tensor of f32; reading it waits for the device.
    pub fn put<const D: usize>(&mut self, name: &str, tensor: Tensor<D>) {
        let shape = tensor.dims().to_vec();
        let values = Values::F32(elements(&tensor.cast(DType::F32)));
        self.arrays.insert(self.full(name), Array { shape, values });
    }

    /// Saves a tensor of i32, bit for bit; reading it waits for the device.
    pub fn put_words(&mut self, name: &str, tensor: Tensor<2, Int>) {
        let shape = tensor.dims().to_vec();
        self.arrays.insert(self.full(name), Array { shape, values: Values::I32(elements(&tensor)) });
    }

    /// Removes and returns the tensor of that name, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is no such tensor, or it has another number of dimensions.
    pub fn take<const D: usize>(&mut self, name: &str, device: &Device) -> Result<Tensor<D>, StateError> {
        let missing = || StateError::Missing { name: self.full(name) };
        let Array { shape, values } = self.arrays.remove(&self.full(name)).ok_or_else(missing)?;
        let Values::F32(values) = values else { return Err(missing()) };
        let shape = <[usize; D]>::try_from(shape)
            .map_err(|found| self.shape_error(name, found, &format!("{D} dimensions")))?;
        Ok(Tensor::from_data(TensorData::new(values, shape), device))
    }

    /// Removes and returns the tensor of that name and shape, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is no such tensor, or it has another shape.
    pub fn take_shaped<const D: usize>(
        &mut self,
        name: &str,
        expected: [usize; D],
        device: &Device,
    ) -> Result<Tensor<D>, StateError> {
        let tensor = self.take(name, device)?;
        match tensor.dims() {
            found if found == expected => Ok(tensor),
            found => Err(self.shape_error(name, found.to_vec(), &format!("{expected:?}"))),
        }
    }

    /// Removes and returns the words of that name and shape, on `device`.
    ///
    /// # Errors
    /// If there are no such words, or they have another shape.
    pub fn take_words(
        &mut self,
        name: &str,
        expected: [usize; 2],
        device: &Device,
    ) -> Result<Tensor<2, Int>, StateError> {
        match self.arrays.remove(&self.full(name)) {
            Some(Array { shape, values: Values::I32(words) }) if shape == expected => {
                Ok(Tensor::from_data(TensorData::new(words, expected), (device, DType::I32)))
            }
            Some(Array { shape, values: Values::I32(_) }) => {
                Err(self.shape_error(name, shape, &format!("{expected:?}")))
            }
            _ => Err(StateError::Missing { name: self.full(name) }),
        }
    }

    pub(crate) fn shape_error(&self, name: &str, found: Vec<usize>, expected: &str) -> StateError {
        StateError::Shape { name: self.full(name), found, expected: expected.into() }
    }

    /// Saves a fact.
    ///
    /// # Errors
    /// If it cannot be represented as JSON.
    pub fn tell(&mut self, name: &str, fact: &impl Serialize) -> Result<(), StateError> {
        let text = serde_json::to_string(fact).map_err(|source| StateError::Fact { name: self.full(name), source })?;
        self.facts.insert(self.full(name), text);
        Ok(())
    }

    /// Removes and returns the fact of that name.
    ///
    /// # Errors
    /// If there is no such fact, or it has another type.
    pub fn told<T: DeserializeOwned>(&mut self, name: &str) -> Result<T, StateError> {
        let name = self.full(name);
        match self.facts.remove(&name) {
            Some(text) => serde_json::from_str(&text).map_err(|source| StateError::Fact { name, source }),
            None => Err(StateError::Missing { name }),
        }
    }

    /// Whether there is an array, a fact or a part of that name.
    pub fn has(&self, name: &str) -> bool {
        let (name, below) = (self.full(name), format!("{}/", self.full(name)));
        self.names().any(|key| *key == name || key.starts_with(&below))
    }

    fn names(&self) -> impl Iterator<Item = &String> {
        self.arrays.keys().chain(self.facts.keys())
    }

    /// Saves or loads a part: what `part` does with entries is done below that name.
    pub fn in_part<T>(&mut self, name: &str, part: impl FnOnce(&mut Self) -> T) -> T {
        let inner = format!("{}/", self.full(name));
        let outer = mem::replace(&mut self.within, inner);
        let done = part(self);
        self.within = outer;
        done
    }

    /// What `load` takes out of the part of that name, which must be every entry.
    pub(crate) fn load_part<T>(
        &mut self,
        name: &str,
        load: impl FnOnce(&mut Self) -> Result<T, StateError>,
    ) -> Result<T, StateError> {
        self.in_part(name, |part| {
            let loaded = load(part)?;
            part.finish().map(|()| loaded)
        })
    }

    /// Saves all entries of another state below a name.
    pub fn put_part(&mut self, name: &str, part: Self) {
        let full = |key: String| format!("{}/{key}", self.full(name));
        let arrays: Vec<_> = part.arrays.into_iter().map(|(key, array)| (full(key), array)).collect();
        let facts: Vec<_> = part.facts.into_iter().map(|(key, fact)| (full(key), fact)).collect();
        self.arrays.extend(arrays);
        self.facts.extend(facts);
    }

    /// Removes and returns all entries below that name, under their names within the part.
    pub fn take_part(&mut self, name: &str) -> Self {
        fn taken<T>(entries: &mut BTreeMap<String, T>, below: &str) -> BTreeMap<String, T> {
            let part = entries.extract_if(.., |key, _| key.starts_with(below));
            part.map(|(key, value)| (key[below.len()..].to_owned(), value)).collect()
        }
        let below = format!("{}/", self.full(name));
        let (arrays, facts) = (taken(&mut self.arrays, &below), taken(&mut self.facts, &below));
        Self { arrays, facts, within: String::new() }
    }

    /// Checks that every entry has been taken; within a part, every entry of the part.
    ///
    /// # Errors
    /// [`StateError::Unknown`] if an entry has not.
    pub fn finish(&self) -> Result<(), StateError> {
        match self.names().find(|name| name.starts_with(&self.within)) {
            Some(name) => Err(StateError::Unknown { name: name.clone() }),
            None => Ok(()),
        }
    }

    /// The name of an entry within the whole state.
    fn full(&self, name: &str) -> String {
        format!("{}{name}", self.within)
    }
}

/// Numbers that are copied at a time.
const AT_ONCE: usize = 1 << 20;

/// Copies all elements of a tensor, row-major. Burn copies data that the tensor keeps twice, so it is asked for a part at a time.
fn elements<const D: usize, K: Basic, E: Element>(tensor: &Tensor<D, K>) -> Vec<E> {
    let count = tensor.shape().num_elements();
    let flat: Tensor<1, K> = tensor.clone().flatten(0, D - 1);
    let mut all = Vec::with_capacity(count);
    for first in (0..count).step_by(AT_ONCE) {
        let part = flat.clone().narrow(0, first, AT_ONCE.min(count - first)).into_data();
        all.extend_from_slice(part.as_slice().expect("the caller names the type of the elements"));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::values_of;

    #[test]
    fn a_tensor_of_several_parts_is_put_whole() {
        let count = 2 * AT_ONCE + 3;
        let words = Tensor::<1, Int>::arange(0..count as i64, &Device::flex()).cast(DType::I32).reshape([count, 1]);
        let mut state = State::default();
        state.put("values", words.clone().float());
        state.put_words("words", words);
        // All of them are below 2²⁴, and so exact.
        assert_eq!(state.arrays["values"].values, Values::F32((0..count).map(|i| i as f32).collect()));
        assert_eq!(state.arrays["words"].values, Values::I32((0..count).map(|i| i as i32).collect()));
    }

    #[test]
    fn what_is_put_is_taken_once() {
        let device = Device::flex();
        let mut state = State::default();
        state.put("means", Tensor::<2>::from_floats([[1.0, -2.5], [f32::MIN_POSITIVE, f32::NAN]], &device));
        state.tell("rate", &0.1_f64.next_up()).unwrap();
        let means: Tensor<2> = state.take_shaped("means", [2, 2], &device).unwrap();
        assert_eq!(values_of(means)[..3], [1.0, -2.5, f32::MIN_POSITIVE]);
        assert_eq!(state.told::<f64>("rate").unwrap(), 0.1_f64.next_up());
        assert!(matches!(state.take::<2>("means", &device), Err(StateError::Missing { name }) if name == "means"));
        state.finish().unwrap();
    }

    #[test]
    fn words_are_taken_bit_for_bit_and_as_nothing_else() {
        let device = Device::flex();
        // As a float, the first would be NaN.
        let words = [0x7fa0_0001, i32::MIN, -1, 0];
        let mut state = State::default();
        state.put_words("words", Tensor::from_data(TensorData::new(words.to_vec(), [2, 2]), (&device, DType::I32)));
        let found = state.clone().take_words("words", [2, 2], &device).unwrap();
        assert_eq!(found.into_data().try_into_vec::<i32>().unwrap(), words);
        assert!(matches!(state.clone().take_words("words", [4, 1], &device), Err(StateError::Shape { .. })));
        assert!(matches!(state.take::<2>("words", &device), Err(StateError::Missing { .. })));
    }

    #[test]
    fn parts_have_names_of_their_own() {
        let device = Device::flex();
        let one = |value: f32| Tensor::<1>::from_floats([value], &device);
        let mut state = State::default();
        for (name, value) in [("a", 1.0), ("ab", 2.0)] {
            let mut part = State::default();
            part.put("x", one(value));
            part.tell("y/z", &value).unwrap();
            state.put_part(name, part);
        }
        assert!(state.has("a") && state.has("a/y") && !state.has("b"));
        let mut part = state.take_part("a");
        assert_eq!(values_of(part.take::<1>("x", &device).unwrap()), [1.0]);
        assert_eq!(part.in_part("y", |part| part.told::<f32>("z")).unwrap(), 1.0);
        part.finish().unwrap();
        assert!(!state.has("a"));
        let lacking = state.in_part("ab", |part| part.told::<f32>("none")).unwrap_err();
        assert!(lacking.to_string().contains("`ab/none`"), "{lacking}");
        let left = state.load_part("ab", |part| part.told::<f32>("y/z")).unwrap_err();
        assert!(matches!(left, StateError::Unknown { name } if name == "ab/x"));
        assert!(matches!(state.finish(), Err(StateError::Unknown { name }) if name == "ab/x"));
    }

    #[test]
    fn other_shapes_and_kinds_are_refused() {
        let device = Device::flex();
        let mut state = State::default();
        state.put("means", Tensor::<2>::zeros([2, 3], &device));
        state.tell("step", &"ten").unwrap();
        assert!(matches!(state.take_shaped::<2>("means", [3, 2], &device), Err(StateError::Shape { .. })));
        assert!(matches!(state.take::<1>("means", &device), Err(StateError::Shape { .. })));
        assert!(matches!(state.told::<usize>("step"), Err(StateError::Fact { .. })));
    }
}
