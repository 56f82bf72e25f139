//! The photographs of a run, at the size that it has come to and prepared for the loss.

use burn::tensor::Device;
use splat_op::{Camera, Intrinsics};

use crate::capture::Photo;
use crate::loss::Truth;

/// Pictures are not reduced to fewer pixels than this along a side: the window of SSIM has eleven.
const SMALLEST_SIDE: usize = 32;

/// A photograph to train on.
struct View {
    photo: Photo,
    /// The photograph at the run's present size, unless that is its own.
    reduced: Option<Photo>,
    /// What `reduced` and the next two are for.
    divisor: usize,
    camera: Camera,
    truth: Option<Truth>,
}

/// All of them.
pub(super) struct Views {
    views: Vec<View>,
    background: [f32; 3],
    device: Device,
    /// Bytes for prepared photographs, and those that are left of them.
    cache: usize,
    cache_left: usize,
    divisor: usize,
}

impl Views {
    pub fn new(photos: Vec<Photo>, background: [f32; 3], cache_mib: usize, device: &Device) -> Self {
        let view = |photo: Photo| {
            let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, device);
            View { photo, reduced: None, divisor: 1, camera, truth: None }
        };
        let cache = cache_mib << 20;
        Self {
            views: photos.into_iter().map(view).collect(),
            background,
            device: device.clone(),
            cache,
            cache_left: cache,
            divisor: 1,
        }
    }

    pub fn len(&self) -> usize {
        self.views.len()
    }

    pub fn name(&self, view: usize) -> &str {
        &self.views[view].photo.name
    }

    /// From now on sides are divided by `divisor`.
    pub fn reduce(&mut self, divisor: usize) {
        if divisor == self.divisor {
            return;
        }
        self.divisor = divisor;
        self.cache_left = self.cache;
        self.views.iter_mut().for_each(|view| view.truth = None);
    }

    /// A view's camera and its photograph, which is kept prepared for its next use while there is room.
    pub fn prepare(&mut self, view: usize) -> (Camera, Truth) {
        let View { photo, reduced, divisor, camera, truth } = &mut self.views[view];
        if *divisor != self.divisor {
            *divisor = self.divisor;
            *reduced =
                reduced_size(&photo.intrinsics, self.divisor).map(|[width, height]| photo.resized(width, height));
            let shown = reduced.as_ref().unwrap_or(photo);
            *camera = Camera::new(shown.intrinsics, &shown.cam_from_world, &self.device);
        }
        if let Some(truth) = truth {
            return (camera.clone(), truth.clone());
        }
        let shown = reduced.as_ref().unwrap_or(photo);
        let prepared = Truth::new(shown.rgb_over(self.background, &self.device));
        // The photograph and two of its windowed moments.
        let bytes = 3 * size_of::<f32>() * shown.rgb.len();
        if bytes <= self.cache_left {
            self.cache_left -= bytes;
            *truth = Some(prepared.clone());
        }
        (camera.clone(), prepared)
    }
}

/// Width and height of a picture with its sides divided, as far as that goes; `None` for its own size.
fn reduced_size(full: &Intrinsics, divisor: usize) -> Option<[usize; 2]> {
    let shorter = full.width.min(full.height);
    let divisor = std::iter::successors(Some(divisor), |&d| Some(d / 2))
        .find(|&d| d <= 1 || shorter / d >= SMALLEST_SIDE)
        .filter(|&d| d > 1)?;
    Some([full.width, full.height].map(|side| side.div_ceil(divisor)))
}

#[cfg(test)]
impl Views {
    /// How many photographs are kept prepared.
    pub fn kept(&self) -> usize {
        self.views.iter().filter(|view| view.truth.is_some()).count()
    }

    /// Leaves so many bytes for more of them.
    pub fn leave_room(&mut self, bytes: usize) {
        self.cache_left = bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trainer::testing::{HEIGHT, WIDTH, photos};

    #[test]
    fn pictures_are_not_reduced_to_nothing() {
        let size = |width, height, divisor| reduced_size(&Intrinsics::centred(width, height, 50.0), divisor);
        assert_eq!(size(270, 480, 1), None);
        assert_eq!(size(270, 480, 2), Some([135, 240]));
        assert_eq!(size(271, 481, 2), Some([136, 241]));
        assert_eq!(size(270, 480, 16), Some([34, 60]));
        assert_eq!(size(100, 480, 16), Some([50, 240]));
        assert_eq!(size(63, 480, 2), None);
    }

    #[test]
    fn a_view_follows_the_size_of_the_run() {
        let mut photos = photos([0.0; 3]);
        for photo in &mut photos {
            *photo = photo.resized(8 * WIDTH, 8 * HEIGHT);
        }
        let [full_width, full_height] = [8 * WIDTH, 8 * HEIGHT];
        let mut views = Views::new(photos, [0.0; 3], 64, &Device::flex());
        let size = |views: &mut Views| {
            let (camera, truth) = views.prepare(0);
            let [height, width, _] = truth.image().dims();
            assert_eq!([camera.intrinsics.width, camera.intrinsics.height], [width, height]);
            (width, height, camera.intrinsics.fx)
        };
        let (width, height, focal) = size(&mut views);
        assert_eq!([width, height], [full_width, full_height]);
        views.reduce(2);
        let half = size(&mut views);
        assert_eq!(half, (full_width / 2, full_height / 2, focal / 2.0));
        assert_eq!(size(&mut views), half, "the prepared photograph is another");
        views.reduce(1);
        assert_eq!(size(&mut views), (width, height, focal));
    }

    #[test]
    fn room_is_given_back_when_the_size_changes() {
        let mut views = Views::new(photos([0.0; 3]), [0.0; 3], 1, &Device::flex());
        let room = views.cache_left;
        views.prepare(0);
        assert!(views.cache_left < room && views.views[0].truth.is_some());
        views.reduce(2);
        assert!(views.cache_left == room && views.views[0].truth.is_none());
    }
}
