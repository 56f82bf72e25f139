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
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::trainer::testing::photos;

    #[test]
    fn what_is_not_kept_is_decoded_each_time() {
        let photo = photos([0.0; 3]).remove(0);
        let count = Arc::new(AtomicUsize::new(0));
        let (again, counted) = (photo.clone(), Arc::clone(&count));
        let read = Photograph::read_again(&photo, move || {
            counted.fetch_add(1, Ordering::Relaxed);
            Ok(again.clone())
        });
        assert_eq!(count.load(Ordering::Relaxed), 0);
        for _ in 0..2 {
            assert_eq!(read.pixels().unwrap().rgb, photo.rgb);
        }
        assert_eq!(count.load(Ordering::Relaxed), 2);
        assert_eq!(read.bytes(), photo.rgb.len());
        let kept = Photograph::from(photo.clone());
        assert!(kept.is_kept() && !read.is_kept());
        assert!(Arc::ptr_eq(&kept.pixels().unwrap(), &kept.pixels().unwrap()));
    }

    #[test]
    fn what_is_read_later_is_kept_while_there_is_room() {
        let photo = photos([0.0; 3]).remove(0);
        let count = Arc::new(AtomicUsize::new(0));
        let room = Arc::new(AtomicUsize::new(photo.rgb.len() + 1));
        let later = || {
            let (again, counted) = (photo.clone(), Arc::clone(&count));
            let Photo { name, intrinsics, cam_from_world, .. } = photo.clone();
            let facts = PhotographFacts { name, intrinsics, cam_from_world, has_alpha: false, has_mask: false };
            Photograph::read_later(facts, &room, move || {
                counted.fetch_add(1, Ordering::Relaxed);
                Ok(again.clone())
            })
        };
        let (first, second) = (later(), later());
        assert!(!first.is_kept() && count.load(Ordering::Relaxed) == 0);
        for (photograph, reads, is_kept) in [(&first, 1, true), (&second, 2, false)] {
            count.store(0, Ordering::Relaxed);
            (0..2).for_each(|_| assert_eq!(photograph.pixels().unwrap().rgb, photo.rgb));
            assert_eq!((count.load(Ordering::Relaxed), photograph.is_kept()), (reads, is_kept));
        }
        assert_eq!(room.load(Ordering::Relaxed), 1);
        let third = later();
        third.keep(&Arc::new(photo.clone()));
        assert!(!third.is_kept(), "there is no room");
        room.store(photo.rgb.len(), Ordering::Relaxed);
        third.keep(&Arc::new(photo.clone()));
        assert!(third.is_kept() && third.pixels().unwrap().rgb == photo.rgb);
    }

    #[test]
    fn a_picture_that_has_changed_is_refused() {
        let photo = photos([0.0; 3]).remove(0);
        let smaller = photo.resized(16, 12);
        let changed = Photograph::read_again(&photo, move || Ok(smaller.clone()));
        let error = changed.pixels().unwrap_err().to_string();
        assert!(error.contains(&photo.name) && error.contains("changed"), "{error}");
        let masked = Photo { mask: Some(vec![true; photo.rgb.len() / 3]), ..photo.clone() };
        let changed = Photograph::read_again(&photo, move || Ok(masked.clone()));
        assert!(changed.pixels().is_err());
    }
}
