//! What the parts of a run have to keep so that it can go on later: arrays and facts, by name.
//!
//! A part puts what it has into a [`State`] and takes the same out again; its names are its own, because parts are put into each
//! other as folders are. What is not taken is noticed ([`State::finish`]): it would be lost.

mod file;

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor, TensorData};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

pub use self::file::FileError;
use crate::gaussians::values_of;

/// What a state lacks or has too much of.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StateError {
    /// There is no such entry.
    #[error("there is no `{name}`, which this version needs; start the run anew")]
    Missing {
        /// Of the entry.
        name: String,
    },
    /// An array has another shape than what it is for.
    #[error("`{name}` has the shape {found:?}, expected {expected:?}; start the run anew")]
    Shape {
        /// Of the entry.
        name: String,
        /// In the state.
        found: Vec<usize>,
        /// Where it goes.
        expected: Vec<usize>,
    },
    /// Arrays do not belong to each other.
    #[error("`{name}` has the shape {found:?}, which does not fit to the rest; start the run anew")]
    Fit {
        /// Of the entry.
        name: String,
        /// In the state.
        found: Vec<usize>,
    },
    /// A fact is not what it should be, or cannot be written down.
    #[error("`{name}` is not what this version means by it: {source}; start the run anew")]
    Fact {
        /// Of the entry.
        name: String,
        /// What is wrong.
        source: serde_json::Error,
    },
    /// Something is left that nobody asked for.
    #[error("`{name}` means nothing to this version; continue with the version that wrote it, or start the run anew")]
    Unknown {
        /// Of the entry.
        name: String,
    },
}

/// Numbers in the order of their rows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
}

/// Arrays of f32 and facts, each with a name that no other has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    pub(crate) arrays: BTreeMap<String, Array>,
    /// As JSON.
    pub(crate) facts: BTreeMap<String, String>,
    /// What this is a part of, for messages: empty, or ends with a slash.
    within: String,
}

impl State {
    /// Keeps a tensor of f32; reading it waits for the device.
    pub fn put<const D: usize>(&mut self, name: &str, tensor: Tensor<D>) {
        let shape = tensor.dims().to_vec();
        self.arrays.insert(name.to_owned(), Array { shape, values: values_of(tensor) });
    }

    /// The tensor of that name, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is none, or it has another number of dimensions.
    pub fn take<const D: usize>(&mut self, name: &str, device: &Device) -> Result<Tensor<D>, StateError> {
        let Array { shape, values } = self.arrays.remove(name).ok_or_else(|| self.missing(name))?;
        match <[usize; D]>::try_from(shape) {
            Ok(shape) => Ok(Tensor::from_data(TensorData::new(values, shape), device)),
            Err(found) => Err(StateError::Shape { name: self.full(name), found, expected: vec![0; D] }),
        }
    }

    /// The same where the shape is known.
    ///
    /// # Errors
    /// If there is none, or it has another shape.
    pub fn take_shaped<const D: usize>(
        &mut self,
        name: &str,
        expected: [usize; D],
        device: &Device,
    ) -> Result<Tensor<D>, StateError> {
        match self.arrays.get(name) {
            Some(array) if array.shape != expected => Err(StateError::Shape {
                name: self.full(name),
                found: array.shape.clone(),
                expected: expected.to_vec(),
            }),
            _ => self.take(name, device),
        }
    }

    /// Keeps a fact.
    ///
    /// # Errors
    /// If it has no form in JSON.
    pub fn tell(&mut self, name: &str, fact: &impl Serialize) -> Result<(), StateError> {
        let text = serde_json::to_string(fact).map_err(|source| StateError::Fact { name: self.full(name), source })?;
        self.facts.insert(name.to_owned(), text);
        Ok(())
    }

    /// The fact of that name.
    ///
    /// # Errors
    /// If there is none, or it is of another kind.
    pub fn told<T: DeserializeOwned>(&mut self, name: &str) -> Result<T, StateError> {
        let text = self.facts.remove(name).ok_or_else(|| self.missing(name))?;
        serde_json::from_str(&text).map_err(|source| StateError::Fact { name: self.full(name), source })
    }

    /// Whether there is an array or a fact of that name, or a part.
    pub fn has(&self, name: &str) -> bool {
        let below = format!("{name}/");
        let is_it = |key: &&String| *key == name || key.starts_with(&below);
        self.arrays.keys().any(|key| is_it(&key)) || self.facts.keys().any(|key| is_it(&key))
    }

    /// Bytes of the arrays.
    pub(crate) fn bytes(&self) -> usize {
        self.arrays.values().map(|array| array.values.len() * size_of::<f32>()).sum()
    }

    /// Keeps all of a part's entries below a name.
    pub fn put_part(&mut self, name: &str, part: Self) {
        self.arrays.extend(part.arrays.into_iter().map(|(key, array)| (format!("{name}/{key}"), array)));
        self.facts.extend(part.facts.into_iter().map(|(key, fact)| (format!("{name}/{key}"), fact)));
    }

    /// All entries below that name, under the names that the part gave them.
    pub fn take_part(&mut self, name: &str) -> Self {
        let within = format!("{}{name}/", self.within);
        Self { arrays: split_off(&mut self.arrays, name), facts: split_off(&mut self.facts, name), within }
    }

    /// Says that everything has been taken.
    ///
    /// # Errors
    /// If something has not.
    pub fn finish(self) -> Result<(), StateError> {
        match self.arrays.keys().chain(self.facts.keys()).next() {
            Some(name) => Err(StateError::Unknown { name: self.full(name) }),
            None => Ok(()),
        }
    }

    /// A name as the whole state has it.
    fn full(&self, name: &str) -> String {
        format!("{}{name}", self.within)
    }

    fn missing(&self, name: &str) -> StateError {
        StateError::Missing { name: self.full(name) }
    }
}

/// Removes the entries below `name` and gives them without it.
fn split_off<T>(entries: &mut BTreeMap<String, T>, name: &str) -> BTreeMap<String, T> {
    let below = format!("{name}/");
    let (part, others) = std::mem::take(entries).into_iter().partition(|(key, _)| key.starts_with(&below));
    *entries = others;
    let part: BTreeMap<String, T> = part;
    part.into_iter().map(|(key, value)| (key[below.len()..].to_owned(), value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(part.take_part("y").told::<f32>("z").unwrap(), 1.0);
        assert!(part.told::<f32>("none").unwrap_err().to_string().contains("`a/none`"));
        part.finish().unwrap();
        assert!(!state.has("a"));
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
