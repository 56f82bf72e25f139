//! Photographs of a run: kept decoded, or decoded on each use.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use glam::DAffine3;
use splat_op::Intrinsics;

use super::{CaptureError, Photo};

/// Decodes a photograph again, in the same way.
type Read = dyn Fn() -> Result<Photo, CaptureError> + Send + Sync;

/// Pixels that are decoded on their first use.
struct Pixels {
    read: Box<Read>,
    /// Bytes that more pixels may take, in common with other photographs.
    room: Arc<AtomicUsize>,
    kept: OnceLock<Arc<Photo>>,
}

/// What is known of a photograph that is not decoded yet.
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

/// One photograph and the source of its pixels.
#[derive(Clone)]
pub struct Photograph {
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
    pixels: Arc<Pixels>,
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
        let read = Box::new(move || Ok(Photo::clone(&again)));
        Self::with(facts, Pixels { read, room: Arc::default(), kept: OnceLock::from(photo) })
    }
}

impl Photograph {
    /// A photograph whose pixels are released: `read` decodes it again on each use.
    pub fn read_again(photo: &Photo, read: impl Fn() -> Result<Photo, CaptureError> + Send + Sync + 'static) -> Self {
        Self::read_later(photo.into(), &Arc::default(), read)
    }

    /// A photograph that `read` decodes on its first use. Its pixels are kept if they fit into `room`, bytes, which photographs
    /// share. Others are decoded again on each use.
    pub fn read_later(
        facts: PhotographFacts,
        room: &Arc<AtomicUsize>,
        read: impl Fn() -> Result<Photo, CaptureError> + Send + Sync + 'static,
    ) -> Self {
        Self::with(facts, Pixels { read: Box::new(read), room: Arc::clone(room), kept: OnceLock::new() })
    }

    fn with(facts: PhotographFacts, pixels: Pixels) -> Self {
        let PhotographFacts { name, intrinsics, cam_from_world, has_alpha, has_mask } = facts;
        Self { name, intrinsics, cam_from_world, has_alpha, has_mask, pixels: Arc::new(pixels) }
    }

    /// Whether its pixels stay in memory.
    pub fn is_kept(&self) -> bool {
        self.pixels.kept.get().is_some()
    }

    /// The photograph with its pixels, decoded if they were not kept.
    ///
    /// # Errors
    /// If the picture is missing or has changed.
    pub fn pixels(&self) -> Result<Arc<Photo>, CaptureError> {
        if let Some(photo) = self.pixels.kept.get() {
            return Ok(Arc::clone(photo));
        }
        let photo = (self.pixels.read)()?;
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
        let (bytes, Pixels { room, kept, .. }) = (self.bytes(), &*self.pixels);
        let fits = room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes));
        if fits.is_ok() && kept.set(Arc::clone(photo)).is_err() {
            // Another thread has kept it meanwhile.
            room.fetch_add(bytes, Ordering::Relaxed);
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
