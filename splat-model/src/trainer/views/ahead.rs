//! Decoding of photographs on other threads, ahead of the step that needs them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use super::at_size;
use crate::capture::{Photo, Photograph, Result};

/// Largest number of photographs in decoding or waiting. On a fast GPU a step takes less time than decoding, and several threads keep up.
pub const MOST: usize = 8;

/// A photograph at a size of the run, or why there is none.
type Decoded = Result<Arc<Photo>>;

/// Photographs whose decoding has begun, by their index and the divisor of their sides.
#[derive(Default)]
pub struct Ahead(BTreeMap<(usize, usize), Receiver<Decoded>>);

impl Ahead {
    /// Begins to decode a photograph, unless that is under way. Photographs of another size are no longer needed.
    pub fn begin(&mut self, view: usize, photograph: &Photograph, divisor: usize) {
        self.0.retain(|(_, of), _| *of == divisor);
        if self.0.len() >= MOST || self.0.contains_key(&(view, divisor)) {
            return;
        }
        let (sender, receiver) = channel();
        self.0.insert((view, divisor), receiver);
        let photograph = photograph.clone();
        rayon::spawn(move || {
            // The receiver may be gone.
            let _ = sender.send(decoded(&photograph, divisor));
        });
    }

    /// Whether a photograph is being decoded, or waits to be taken.
    pub fn has_begun(&self, view: usize, divisor: usize) -> bool {
        self.0.contains_key(&(view, divisor))
    }

    /// Returns the photograph: waits for it if it is being decoded, and decodes it here otherwise. An error if it cannot be decoded.
    pub fn take(&mut self, view: usize, photograph: &Photograph, divisor: usize) -> Decoded {
        let begun = self.0.remove(&(view, divisor)).and_then(|receiver| receiver.recv().ok());
        begun.unwrap_or_else(|| decoded(photograph, divisor))
    }
}

fn decoded(photograph: &Photograph, divisor: usize) -> Decoded {
    Ok(at_size(photograph.pixels()?, divisor))
}

#[cfg(test)]
mod tests;
