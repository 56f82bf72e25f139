//! Photographs that are decoded while others are trained on.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::at_size;
use crate::capture::{CaptureError, Photo, Photograph};

/// So many at most are on their way or waiting. On a fast GPU a step takes less time than decoding; several threads then keep up.
pub const MOST: usize = 8;

/// A photograph at a size of the run, or why there is none.
type Decoded = Result<Arc<Photo>, CaptureError>;

/// Those on their way, by number and the size that they are for.
pub struct Ahead {
    begun: BTreeSet<(usize, usize)>,
    there: BTreeMap<(usize, usize), Decoded>,
    sender: Sender<((usize, usize), Decoded)>,
    receiver: Receiver<((usize, usize), Decoded)>,
}

impl Default for Ahead {
    fn default() -> Self {
        let (sender, receiver) = channel();
        Self { begun: BTreeSet::new(), there: BTreeMap::new(), sender, receiver }
    }
}

impl Ahead {
    /// Begins to decode a photograph, if that is not under way.
    pub fn begin(&mut self, view: usize, photograph: &Photograph, divisor: usize) {
        // What was for another size is of no use any more.
        self.there.retain(|(_, of), _| *of == divisor);
        if self.begun.len() >= MOST || !self.begun.insert((view, divisor)) {
            return;
        }
        let (photograph, sender) = (photograph.clone(), self.sender.clone());
        rayon::spawn(move || {
            // Nobody may be left to take it.
            let _ = sender.send(((view, divisor), decoded(&photograph, divisor)));
        });
    }

    /// Its pixels; waits for them if they are on their way, and decodes them here if they are not.
    ///
    /// # Errors
    /// If it cannot be decoded.
    pub fn take(&mut self, view: usize, photograph: &Photograph, divisor: usize) -> Decoded {
        let key = (view, divisor);
        if !self.begun.contains(&key) {
            return decoded(photograph, divisor);
        }
        loop {
            if let Some(found) = self.there.remove(&key) {
                self.begun.remove(&key);
                return found;
            }
            match self.receiver.recv() {
                Ok((other, found)) => _ = self.there.insert(other, found),
                // There is a sender as long as there is a receiver.
                Err(_) => return decoded(photograph, divisor),
            }
            let wanted = |(_, of): &(usize, usize)| *of == divisor;
            self.begun.retain(|other| wanted(other) || !self.there.contains_key(other));
            self.there.retain(|other, _| wanted(other));
        }
    }
}

fn decoded(photograph: &Photograph, divisor: usize) -> Decoded {
    Ok(at_size(photograph.pixels()?, divisor))
}
