//! Decoding of photographs on other threads, ahead of the step that needs them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::at_size;
use crate::capture::{CaptureError, Photo, Photograph};

/// Largest number of photographs in decoding or waiting. On a fast GPU a step takes less time than decoding, and several
/// threads keep up.
pub const MOST: usize = 8;

/// A photograph at a size of the run, or why there is none.
type Decoded = Result<Arc<Photo>, CaptureError>;

/// Index of a photograph, and the divisor of its sides.
type Key = (usize, usize);

/// Photographs whose decoding has begun.
pub struct Ahead {
    /// The result. `None` while decoding.
    begun: BTreeMap<Key, Option<Decoded>>,
    sender: Sender<(Key, Decoded)>,
    receiver: Receiver<(Key, Decoded)>,
}

impl Default for Ahead {
    fn default() -> Self {
        let (sender, receiver) = channel();
        Self { begun: BTreeMap::new(), sender, receiver }
    }
}

impl Ahead {
    /// Begins to decode a photograph, unless that is under way.
    pub fn begin(&mut self, view: usize, photograph: &Photograph, divisor: usize) {
        while let Ok(arrived) = self.receiver.try_recv() {
            self.arrive(arrived);
        }
        // Finished photographs of another size are discarded. Unfinished ones keep their place until they arrive.
        self.begun.retain(|(_, of), found| *of == divisor || found.is_none());
        if self.begun.len() >= MOST || self.begun.contains_key(&(view, divisor)) {
            return;
        }
        self.begun.insert((view, divisor), None);
        let (photograph, sender) = (photograph.clone(), self.sender.clone());
        rayon::spawn(move || {
            // The receiver may be gone.
            let _ = sender.send(((view, divisor), decoded(&photograph, divisor)));
        });
    }

    /// Returns the photograph: waits for it if it is being decoded, and decodes it here otherwise.
    ///
    /// # Errors
    /// If it cannot be decoded.
    pub fn take(&mut self, view: usize, photograph: &Photograph, divisor: usize) -> Decoded {
        while let Some(found) = self.begun.remove(&(view, divisor)) {
            if let Some(found) = found {
                return found;
            }
            self.begun.insert((view, divisor), None);
            // Receiving cannot fail while this struct holds a sender.
            let Ok(arrived) = self.receiver.recv() else { break };
            self.arrive(arrived);
        }
        decoded(photograph, divisor)
    }

    fn arrive(&mut self, (key, found): (Key, Decoded)) {
        self.begun.insert(key, Some(found));
    }
}

fn decoded(photograph: &Photograph, divisor: usize) -> Decoded {
    Ok(at_size(photograph.pixels()?, divisor))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trainer::testing::ring;

    #[test]
    fn another_size_takes_the_places_of_what_was_there_for_the_last() {
        let photos = ring(MOST + 1);
        let photographs: Vec<Photograph> = photos.into_iter().map(Photograph::from).collect();
        let mut ahead = Ahead::default();
        (0..MOST).for_each(|view| ahead.begin(view, &photographs[view], 1));
        // All have arrived, and none is taken.
        while ahead.begun.values().any(Option::is_none) {
            let arrived = ahead.receiver.recv().unwrap();
            ahead.arrive(arrived);
        }
        ahead.begin(MOST, &photographs[MOST], 1);
        assert!(!ahead.begun.contains_key(&(MOST, 1)), "more than {MOST} at a time");
        (0..MOST).for_each(|view| ahead.begin(view, &photographs[view], 2));
        assert!(ahead.begun.keys().eq((0..MOST).map(|view| (view, 2)).collect::<Vec<_>>().iter()));
        for view in 0..MOST {
            ahead.take(view, &photographs[view], 2).unwrap();
        }
        assert!(ahead.begun.is_empty());
    }
}
