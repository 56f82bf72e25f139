//! Photographs of a run: kept decoded, or decoded on each use.

use std::ops::Deref;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use glam::DAffine3;
use splat_op::Intrinsics;

use super::{CaptureError, Photo, Result};

/// Decodes a photograph again, in the same way.
type Decode = dyn Fn() -> Result<Photo> + Send + Sync;

/// What is known of a photograph before it is decoded.
#[derive(Clone, Debug)]
pub struct PhotographFacts {
    /// The view's name.
    pub name: String,
    /// Size and projection.
    pub intrinsics: Intrinsics,
    /// The view's pose.
    pub cam_from_world: DAffine3,
    /// Whether it has transparent parts.
    pub has_alpha: bool,
    /// Whether a mask excludes any of its pixels.
    pub has_mask: bool,
}

/// One photograph and the source of its pixels. It has the fields of its [`PhotographFacts`].
#[derive(Clone)]
pub struct Photograph {
    facts: PhotographFacts,
    read: Arc<Decode>,
    /// Bytes that more pixels may take, in common with other photographs.
    room: Arc<AtomicUsize>,
    kept: Arc<OnceLock<Arc<Photo>>>,
}

impl Deref for Photograph {
    type Target = PhotographFacts;

    fn deref(&self) -> &PhotographFacts {
        &self.facts
    }
}

impl From<&Photo> for PhotographFacts {
    fn from(photo: &Photo) -> Self {
        Self {
            name: photo.name.clone(),
            intrinsics: photo.intrinsics,
            cam_from_world: photo.cam_from_world,
            has_alpha: photo.alpha.is_some(),
            has_mask: photo.mask.is_some(),
        }
    }
}

impl From<Photo> for Photograph {
    fn from(photo: Photo) -> Self {
        let (facts, photo) = (PhotographFacts::from(&photo), Arc::new(photo));
        let again = Arc::clone(&photo);
        let read = Arc::new(move || Ok(Photo::clone(&again)));
        Self { facts, read, room: Arc::default(), kept: Arc::new(OnceLock::from(photo)) }
    }
}

impl Photograph {
    /// A photograph that `read` decodes on its first use. Its pixels are kept if they fit into `room`, bytes, which photographs
    /// share. Others are decoded again on each use.
    pub fn read_later(
        facts: PhotographFacts,
        room: &Arc<AtomicUsize>,
        read: impl Fn() -> Result<Photo> + Send + Sync + 'static,
    ) -> Self {
        Self { facts, read: Arc::new(read), room: Arc::clone(room), kept: Arc::default() }
    }

    /// Whether its pixels stay in memory.
    pub fn is_kept(&self) -> bool {
        self.kept.get().is_some()
    }

    /// The photograph with its pixels, decoded if they were not kept.
    ///
    /// # Errors
    /// If the picture is missing or has changed.
    pub fn pixels(&self) -> Result<Arc<Photo>> {
        if let Some(photo) = self.kept.get() {
            return Ok(Arc::clone(photo));
        }
        let photo = (self.read)()?;
        let size = |camera: &Intrinsics| [camera.width, camera.height];
        if (size(&photo.intrinsics), photo.alpha.is_some(), photo.mask.is_some())
            != (size(&self.intrinsics), self.has_alpha, self.has_mask)
        {
            return Err(CaptureError::Changed { name: self.name.clone() });
        }
        let photo = Arc::new(photo);
        self.keep(&photo);
        Ok(photo)
    }

    /// Keeps the decoded pixels of a photograph that is [read later](Self::read_later), if there is room.
    pub fn keep(&self, photo: &Arc<Photo>) {
        let bytes = self.bytes();
        let fits = self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes));
        if fits.is_ok() && self.kept.set(Arc::clone(photo)).is_err() {
            // Another thread has kept it meanwhile.
            self.room.fetch_add(bytes, Ordering::Relaxed);
        }
    }

    /// Bytes of its decoded pixels.
    pub fn bytes(&self) -> usize {
        let per_pixel = 3 + usize::from(self.has_alpha) + usize::from(self.has_mask);
        self.intrinsics.width * self.intrinsics.height * per_pixel
    }
}

#[cfg(test)]
mod tests;
