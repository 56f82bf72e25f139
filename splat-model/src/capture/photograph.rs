//! Photographs of a run: kept decoded, or decoded on each use.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use glam::DAffine3;
use splat_op::Intrinsics;

use super::{CaptureError, Photo};

/// Decodes a photograph again, in the same way.
type Read = dyn Fn() -> Result<Photo, CaptureError> + Send + Sync;

#[derive(Clone)]
enum PixelSource {
    Kept(Arc<Photo>),
    Read(Arc<Read>),
    Later(Arc<Later>),
}

/// Pixels that are decoded on their first use.
struct Later {
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
    pixels: PixelSource,
}

impl From<Photo> for Photograph {
    fn from(photo: Photo) -> Self {
        let photo = Arc::new(photo);
        Self::with(&photo, PixelSource::Kept(Arc::clone(&photo)))
    }
}

impl Photograph {
    /// A photograph whose pixels are released: `read` decodes it again on each use.
    pub fn read_again(photo: &Photo, read: impl Fn() -> Result<Photo, CaptureError> + Send + Sync + 'static) -> Self {
        Self::with(photo, PixelSource::Read(Arc::new(read)))
    }

    /// A photograph that `read` decodes on its first use. Its pixels are kept if they fit into `room`, bytes, which photographs
    /// share. Others are decoded again on each use.
    pub fn read_later(
        facts: PhotographFacts,
        room: &Arc<AtomicUsize>,
        read: impl Fn() -> Result<Photo, CaptureError> + Send + Sync + 'static,
    ) -> Self {
        let PhotographFacts { name, intrinsics, cam_from_world, has_alpha, has_mask } = facts;
        let later = Later { read: Box::new(read), room: Arc::clone(room), kept: OnceLock::new() };
        Self { name, intrinsics, cam_from_world, has_alpha, has_mask, pixels: PixelSource::Later(Arc::new(later)) }
    }

    fn with(photo: &Photo, pixels: PixelSource) -> Self {
        Self {
            name: photo.name.clone(),
            intrinsics: photo.intrinsics,
            cam_from_world: photo.cam_from_world,
            has_alpha: photo.alpha.is_some(),
            has_mask: photo.mask.is_some(),
            pixels,
        }
    }

    /// Whether its pixels stay in memory.
    pub fn is_kept(&self) -> bool {
        match &self.pixels {
            PixelSource::Kept(_) => true,
            PixelSource::Read(_) => false,
            PixelSource::Later(later) => later.kept.get().is_some(),
        }
    }

    /// The photograph with its pixels, decoded if they were not kept.
    ///
    /// # Errors
    /// If the picture is missing or has changed.
    pub fn pixels(&self) -> Result<Arc<Photo>, CaptureError> {
        let photo = match &self.pixels {
            PixelSource::Kept(photo) => return Ok(Arc::clone(photo)),
            PixelSource::Read(read) => read()?,
            PixelSource::Later(later) => match later.kept.get() {
                Some(photo) => return Ok(Arc::clone(photo)),
                None => (later.read)()?,
            },
        };
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
        if let PixelSource::Later(later) = &self.pixels {
            let bytes = self.bytes();
            let fits = later.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes));
            if fits.is_ok() && later.kept.set(Arc::clone(photo)).is_err() {
                // Another thread has kept it meanwhile.
                later.room.fetch_add(bytes, Ordering::Relaxed);
            }
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
