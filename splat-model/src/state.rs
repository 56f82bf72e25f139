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

/// An entry of a state that is missing, wrong or left over: its name, what was expected, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct StateError(String);

impl StateError {
    fn missing(name: &str) -> Self {
        Self(format!("there is no `{name}`, which this version requires; start a new run"))
    }

    /// The error for a fact of another type, or one that JSON cannot represent.
    pub(crate) fn fact(name: &str, reason: &serde_json::Error) -> Self {
        Self(format!("`{name}` does not have the form that this version requires: {reason}; start a new run"))
    }
}

/// Arrays of f32 or of words of 32 bits, and facts, each with a unique name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    pub(crate) arrays: BTreeMap<String, TensorData>,
    /// Facts by name, as JSON.
    pub(crate) facts: BTreeMap<String, String>,
    /// Path of the part that is saved or loaded: empty, or ends with a slash.
    within: String,
}

impl State {
    /// Saves a tensor of f32; reading it waits for the device.
    pub fn put<const D: usize>(&mut self, name: &str, tensor: Tensor<D>) {
        let data = TensorData::new(elements::<D, _, f32>(&tensor.clone().cast(DType::F32)), tensor.dims());
        self.arrays.insert(self.full(name), data);
    }

    /// Saves a tensor of i32, bit for bit; reading it waits for the device.
    pub fn put_words(&mut self, name: &str, tensor: Tensor<2, Int>) {
        self.arrays.insert(self.full(name), TensorData::new(elements::<2, _, i32>(&tensor), tensor.dims()));
    }

    /// Removes and returns the tensor of that name, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is no such tensor, or it has another number of dimensions.
    pub fn take<const D: usize>(&mut self, name: &str, device: &Device) -> Result<Tensor<D>, StateError> {
        let data = self.data(name, DType::F32)?;
        match data.rank() {
            rank if rank == D => Ok(Tensor::from_data(data, (device, DType::F32))),
            _ => Err(self.shape_error(name, data.shape().to_vec(), &format!("{D} dimensions"))),
        }
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
        let data = self.data(name, DType::I32)?;
        match data.shape().to_vec() {
            found if found == expected => Ok(Tensor::from_data(data, (device, DType::I32))),
            found => Err(self.shape_error(name, found, &format!("{expected:?}"))),
        }
    }

    fn data(&mut self, name: &str, of: DType) -> Result<TensorData, StateError> {
        let name = self.full(name);
        self.arrays.remove(&name).filter(|data| data.dtype() == of).ok_or_else(|| StateError::missing(&name))
    }

    pub(crate) fn shape_error(&self, name: &str, found: Vec<usize>, expected: &str) -> StateError {
        StateError(format!("`{}` has the shape {found:?}, expected {expected}; start a new run", self.full(name)))
    }

    /// Saves a fact.
    ///
    /// # Errors
    /// If it cannot be represented as JSON.
    pub fn tell(&mut self, name: &str, fact: &impl Serialize) -> Result<(), StateError> {
        let text = serde_json::to_string(fact).map_err(|reason| StateError::fact(&self.full(name), &reason))?;
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
            Some(text) => serde_json::from_str(&text).map_err(|reason| StateError::fact(&name, &reason)),
            None => Err(StateError::missing(&name)),
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
    /// If an entry has not.
    pub fn finish(&self) -> Result<(), StateError> {
        match self.names().find(|name| name.starts_with(&self.within)) {
            Some(name) => Err(StateError(format!(
                "`{name}` is unknown to this version; continue with the version that wrote it, or start a new run"
            ))),
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
mod tests;
