//! Photographs that are decoded while others are trained on.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::at_size;
use crate::capture::{CaptureError, Photo, Photograph};

/// So many at most are on their way or waiting. On a fast GPU a step takes less time than decoding; several threads then keep up.
pub const MOST: usize = 8;

/// A photograph at a size of the run, or why there is none.
type Decoded = Result<Arc<Photo>, CaptureError>;

/// A photograph's number, and the divisor of the run's sides that it is for.
type Key = (usize, usize);

/// Those that were begun.
pub struct Ahead {
    /// None while it is on its way.
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
    /// Begins to decode a photograph, if that is not under way.
    pub fn begin(&mut self, view: usize, photograph: &Photograph, divisor: usize) {
        while let Ok(arrived) = self.receiver.try_recv() {
            self.arrive(arrived);
        }
        // What is there for another size is of no use any more, and what is on its way takes its place until it has come.
        self.begun.retain(|(_, of), found| *of == divisor || found.is_none());
        if self.begun.len() >= MOST || self.begun.contains_key(&(view, divisor)) {
            return;
        }
        self.begun.insert((view, divisor), None);
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
        while let Some(found) = self.begun.remove(&(view, divisor)) {
            if let Some(found) = found {
                return found;
            }
            self.begun.insert((view, divisor), None);
            // There is a sender as long as there is a receiver.
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
        // All have come, and none is taken.
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
