//! The saved state of a run, from which it can continue: arrays and facts, by name.
//!
//! Each part of a run puts its entries into a [`State`] and takes the same entries out again. Parts are nested like folders, so
//! each part chooses its names freely. [`State::finish`] reports an entry that was not taken, because it would be lost.

mod file;

use std::collections::BTreeMap;
use std::ops::Range;

use burn::tensor::kind::{Basic, Kind};
use burn::tensor::{DType, Device, Element, Tensor, TensorData};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// An entry of a state that is missing, wrong or left over: its name, what was expected, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct StateError(String);

impl StateError {
    /// The error for a fact of another type, or one that JSON cannot represent.
    pub(crate) fn fact(name: &str, reason: &serde_json::Error) -> Self {
        Self(format!("`{name}` does not have the form that this version requires: {reason}; start a new run"))
    }
}

/// Arrays of f32 or i32, and facts, each with a unique name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Arrays and facts by name; a fact is JSON, as bytes.
    pub(crate) entries: BTreeMap<String, TensorData>,
    /// Path of the part in the whole state, for errors: empty, or ends with a slash.
    within: String,
}

impl State {
    /// Saves a tensor: floats as f32, integers as i32. Reading it waits for the device.
    pub fn put<const D: usize, K: Basic>(&mut self, name: &str, tensor: Tensor<D, K>) {
        self.entries.insert(name.to_owned(), data_of(tensor));
    }

    /// Removes and returns the tensor of that name, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is no such tensor, or it has another number of dimensions.
    pub fn take<const D: usize, K: Basic>(&mut self, name: &str, device: &Device) -> Result<Tensor<D, K>, StateError> {
        let data = self.entry(name, stored_as::<K>())?;
        match data.rank() {
            rank if rank == D => Ok(Tensor::from_data(data, (device, stored_as::<K>()))),
            _ => Err(self.shape_error(name, data.shape(), &format!("{D} dimensions"))),
        }
    }

    /// Removes and returns the tensor of that name and shape, on `device`, not tracked.
    ///
    /// # Errors
    /// If there is no such tensor, or it has another shape.
    pub fn take_shaped<const D: usize, K: Basic>(
        &mut self,
        name: &str,
        expected: [usize; D],
        device: &Device,
    ) -> Result<Tensor<D, K>, StateError> {
        let tensor = self.take(name, device)?;
        match tensor.dims() {
            found if found == expected => Ok(tensor),
            found => Err(self.shape_error(name, &found, &format!("{expected:?}"))),
        }
    }

    pub(crate) fn shape_error(&self, name: &str, found: &[usize], expected: &str) -> StateError {
        StateError(format!("`{}{name}` has the shape {found:?}, expected {expected}; start a new run", self.within))
    }

    /// Saves a fact.
    ///
    /// # Errors
    /// If it cannot be represented as JSON.
    pub fn tell(&mut self, name: &str, fact: &impl Serialize) -> Result<(), StateError> {
        let text = serde_json::to_vec(fact).map_err(|reason| StateError::fact(name, &reason))?;
        self.entries.insert(name.to_owned(), TensorData::from(&text[..]));
        Ok(())
    }

    /// Removes and returns the fact of that name.
    ///
    /// # Errors
    /// If there is no such fact, or it has another type.
    pub fn told<T: DeserializeOwned>(&mut self, name: &str) -> Result<T, StateError> {
        let text = self.entry(name, DType::U8)?;
        serde_json::from_slice(text.as_bytes())
            .map_err(|reason| StateError::fact(&format!("{}{name}", self.within), &reason))
    }

    fn entry(&mut self, name: &str, of: DType) -> Result<TensorData, StateError> {
        let found = self.entries.remove(name).filter(|data| data.dtype() == of);
        let name = format!("{}{name}", self.within);
        found.ok_or(StateError(format!("there is no `{name}`, which this version requires; start a new run")))
    }

    /// Whether there is an array, a fact or a part of that name.
    pub fn has(&self, name: &str) -> bool {
        self.entries.contains_key(name) || self.entries.range(below(name)).next().is_some()
    }

    /// Saves a part: what `part` saves is saved below that name.
    pub fn in_part<T>(&mut self, name: &str, part: impl FnOnce(&mut Self) -> T) -> T {
        let mut inner = Self::default();
        let done = part(&mut inner);
        self.put_part(name, inner);
        done
    }

    /// What `load` takes out of the part of that name, which must be every entry.
    pub(crate) fn load_part<T>(
        &mut self,
        name: &str,
        load: impl FnOnce(&mut Self) -> Result<T, StateError>,
    ) -> Result<T, StateError> {
        let mut part = self.take_part(name);
        let loaded = load(&mut part)?;
        part.finish().map(|()| loaded)
    }

    /// Saves all entries of another state below a name.
    pub fn put_part(&mut self, name: &str, part: Self) {
        self.entries.extend(part.entries.into_iter().map(|(key, entry)| (format!("{name}/{key}"), entry)));
    }

    /// Removes and returns all entries below that name, under their names within the part.
    pub fn take_part(&mut self, name: &str) -> Self {
        let part = self.entries.extract_if(below(name), |_, _| true);
        let entries = part.map(|(key, entry)| (key[name.len() + 1..].to_owned(), entry)).collect();
        Self { entries, within: format!("{}{name}/", self.within) }
    }

    /// Checks that every entry has been taken.
    ///
    /// # Errors
    /// If an entry has not.
    pub fn finish(&self) -> Result<(), StateError> {
        let Some(name) = self.entries.keys().next() else { return Ok(()) };
        let name = format!("`{}{name}`", self.within);
        Err(StateError(format!("{name} is unknown; continue with the version that wrote it, or start a new run")))
    }
}

/// All names that begin with `name` and a slash: `0` is the character after the slash.
fn below(name: &str) -> Range<String> {
    format!("{name}/")..format!("{name}0")
}

/// The type in which tensors of a kind are stored.
fn stored_as<K: Basic>() -> DType {
    if K::KIND == Kind::Float { DType::F32 } else { DType::I32 }
}

/// Numbers that are copied at a time.
const AT_ONCE: usize = 1 << 20;

fn data_of<const D: usize, K: Basic>(tensor: Tensor<D, K>) -> TensorData {
    let (shape, flat) = (tensor.dims(), tensor.flatten(0, D - 1));
    match stored_as::<K>() {
        DType::F32 => TensorData::new(elements::<K, f32>(&flat), shape),
        _ => TensorData::new(elements::<K, i32>(&flat), shape),
    }
}

/// Copies all elements. Burn copies data that the tensor keeps twice, so it is asked for a part at a time; and bytes once more to align
/// them, so they are numbers from the start.
fn elements<K: Basic, E: Element>(flat: &Tensor<1, K>) -> Vec<E> {
    let [count] = flat.dims();
    let mut all = Vec::with_capacity(count);
    for first in (0..count).step_by(AT_ONCE) {
        let part = flat.clone().narrow(0, first, AT_ONCE.min(count - first)).into_data();
        all.extend_from_slice(part.convert::<E>().as_slice().expect("it was just converted"));
    }
    all
}

#[cfg(test)]
mod tests;
