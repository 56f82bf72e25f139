//! The photographs of a run, at the size that it has come to and prepared for the loss.

use burn::tensor::{Bool, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_op::{Camera, Intrinsics};

use crate::capture::Photo;
use crate::capture::packed::Packed;
use crate::effects::masks;
use crate::loss::Truth;

/// Pictures are not reduced to fewer pixels than this along a side: the window of SSIM has eleven.
pub(super) const SMALLEST_SIDE: usize = 32;

/// A photograph to train on.
struct View {
    photo: Photo,
    /// The photograph at the run's present size, unless that is its own.
    reduced: Option<Photo>,
    /// What `reduced` and the next two are for.
    divisor: usize,
    camera: Camera,
    truth: Option<Truth>,
    /// The same on the device, where prepared ones do not all fit.
    packed: Option<Packed>,
    /// `[1, H, W]`: which pixels a mask leaves out. A byte per pixel on a CPU and four on a GPU, not counted as cache.
    excluded: Option<Tensor<3, Bool>>,
}

impl View {
    /// At the run's present size.
    fn shown(&self) -> &Photo {
        self.reduced.as_ref().unwrap_or(&self.photo)
    }
}

/// All of them.
pub(super) struct Views {
    views: Vec<View>,
    background: [f32; 3],
    device: Device,
    /// Bytes for photographs on the device, and those that are left of them.
    cache: usize,
    cache_left: usize,
    /// Whether photographs are packed. On a CPU that would only copy them.
    packs: bool,
    divisor: usize,
    /// While the cost of masks is measured.
    ignores_masks: bool,
}

/// Bytes of a prepared value: the photograph and two of its windowed moments.
const PREPARED: usize = 3 * size_of::<f32>();

impl Views {
    pub fn new(photos: Vec<Photo>, background: [f32; 3], cache_mib: usize, device: &Device) -> Self {
        let view = |photo: Photo| {
            let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, device);
            View { photo, reduced: None, divisor: 1, camera, truth: None, packed: None, excluded: None }
        };
        let cache = cache_mib << 20;
        Self {
            views: photos.into_iter().map(view).collect(),
            background,
            device: device.clone(),
            cache,
            cache_left: cache,
            packs: splat_op::is_gpu(device),
            divisor: 1,
            ignores_masks: false,
        }
    }

    pub fn len(&self) -> usize {
        self.views.len()
    }

    pub fn name(&self, view: usize) -> &str {
        &self.views[view].photo.name
    }

    /// The camera of a view, as it was last prepared, and its pose as it was given.
    pub fn camera_of(&self, view: usize) -> (&Intrinsics, &DAffine3) {
        let photo = self.views[view].shown();
        (&photo.intrinsics, &photo.cam_from_world)
    }

    /// From now on sides are divided by `divisor`.
    pub fn reduce(&mut self, divisor: usize) {
        if divisor == self.divisor {
            return;
        }
        self.divisor = divisor;
        self.cache_left = self.cache;
        for view in &mut self.views {
            (view.truth, view.packed, view.excluded) = (None, None, None);
        }
    }

    /// Until told otherwise, every pixel counts.
    pub fn ignore_masks(&mut self, ignore: bool) {
        self.ignores_masks = ignore;
    }

    /// Bytes of the photographs' masks on a CPU; none where no photograph has one.
    pub fn masked_bytes(&self) -> Option<usize> {
        let masks = self.views.iter().filter_map(|view| view.photo.mask.as_ref());
        masks.map(Vec::len).reduce(|a, b| a + b)
    }

    /// `[1, H, W]`: the pixels of a view, as it was last prepared, that do not count; none where all do. Kept for its next use
    /// while there is room.
    pub fn excluded(&mut self, view: usize) -> Option<Tensor<3, Bool>> {
        if self.ignores_masks {
            return None;
        }
        let kept = &mut self.views[view];
        if kept.excluded.is_some() {
            return kept.excluded.clone();
        }
        let size = [1, kept.shown().intrinsics.height, kept.shown().intrinsics.width];
        let excluded: Vec<bool> = kept.shown().mask.as_ref()?.iter().map(|counts| !counts).collect();
        let bytes = excluded.len() * if self.packs { size_of::<u32>() } else { 1 };
        let excluded = Tensor::from_data(TensorData::new(excluded, size), &self.device);
        if bytes <= self.cache_left {
            self.cache_left -= bytes;
            kept.excluded = Some(excluded.clone());
        }
        Some(excluded)
    }

    /// Brings a view to the run's present size.
    fn resize(&mut self, view: usize) {
        let view = &mut self.views[view];
        if view.divisor != self.divisor {
            view.divisor = self.divisor;
            let size = reduced_size(&view.photo.intrinsics, self.divisor);
            view.reduced = size.map(|[width, height]| view.photo.resized(width, height));
            view.camera = Camera::new(view.shown().intrinsics, &view.shown().cam_from_world, &self.device);
        }
    }

    /// A view's camera and its photograph, black where its mask leaves pixels out, which is kept for its next use while
    /// there is room: prepared; or packed, on a GPU where prepared ones would not all fit. One with transparent parts is prepared
    /// anew over `drawn`, if there is such a background for this step.
    pub fn prepare(&mut self, view: usize, drawn: Option<[f32; 3]>) -> (Camera, Truth) {
        let packs = self.packs && self.prepared_bytes() > self.cache;
        self.resize(view);
        let excluded = self.excluded(view);
        let clear = |picture: Tensor<3>| match &excluded {
            Some(excluded) => masks::cleared(picture, excluded),
            None => picture,
        };
        let view = &mut self.views[view];
        if let Some(background) = drawn.filter(|_| view.shown().alpha.is_some()) {
            let bytes = view.shown().rgb.len() / 3 * Packed::PIXEL;
            if self.packs && view.packed.is_none() && bytes <= self.cache_left {
                self.cache_left -= bytes;
                view.packed = Some(Packed::new(view.shown(), &self.device));
            }
            let truth = match &view.packed {
                Some(packed) => packed.rgb_over(background),
                None => view.shown().rgb_over(background, &self.device),
            };
            return (view.camera.clone(), Truth::new(clear(truth)));
        }
        if let Some(truth) = &view.truth {
            return (view.camera.clone(), truth.clone());
        }
        let values = view.shown().rgb.len();
        let mut fits = |bytes| {
            let fits = bytes <= self.cache_left;
            self.cache_left -= if fits { bytes } else { 0 };
            fits
        };
        if packs {
            let packed = view.packed.clone().unwrap_or_else(|| Packed::new(view.shown(), &self.device));
            if view.packed.is_none() && fits(values / 3 * Packed::PIXEL) {
                view.packed = Some(packed.clone());
            }
            return (view.camera.clone(), Truth::new(clear(packed.rgb_over(self.background))));
        }
        let prepared = Truth::new(clear(view.shown().rgb_over(self.background, &self.device)));
        view.truth = fits(PREPARED * values).then(|| prepared.clone());
        (view.camera.clone(), prepared)
    }

    /// What all photographs take prepared, at the run's present size.
    fn prepared_bytes(&self) -> usize {
        let pixels = |camera: &Intrinsics| {
            let [width, height] = reduced_size(camera, self.divisor).unwrap_or([camera.width, camera.height]);
            width * height
        };
        self.views.iter().map(|view| 3 * PREPARED * pixels(&view.photo.intrinsics)).sum()
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

    /// How many are kept packed.
    fn kept_packed(&self) -> usize {
        self.views.iter().filter(|view| view.packed.is_some()).count()
    }

    /// Leaves so many bytes for more of them.
    pub fn leave_room(&mut self, bytes: usize) {
        self.cache_left = bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::values_of;
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
            let (camera, truth) = views.prepare(0, None);
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
    fn photographs_that_do_not_fit_prepared_are_packed() {
        let shown = |views: &mut Views| -> Vec<f32> {
            let pictures = (0..views.len()).flat_map(|view| values_of(views.prepare(view, None).1.image()));
            pictures.collect()
        };
        let all = |cache: usize, packs: bool| {
            let mut views = Views::new(photos([0.2; 3]), [0.2; 3], 0, &Device::flex());
            (views.cache, views.cache_left, views.packs) = (cache, cache, packs);
            let first = shown(&mut views);
            let left = views.cache_left;
            assert_eq!(shown(&mut views), first, "a kept photograph is another");
            assert_eq!(views.cache_left, left, "a photograph is counted twice");
            (first, views.kept(), views.kept_packed())
        };
        let count = photos([0.2; 3]).len();
        let (prepared, packed) = (count * 3 * PREPARED * WIDTH * HEIGHT, Packed::PIXEL * WIDTH * HEIGHT);
        let (expected, kept, kept_packed) = all(prepared, true);
        assert_eq!((kept, kept_packed), (count, 0));
        for (cache, packs, kept) in
            [(prepared - 1, true, (0, count)), (2 * packed + 1, true, (0, 2)), (packed, false, (0, 0))]
        {
            let (found, prepared, packed) = all(cache, packs);
            assert_eq!((prepared, packed), kept, "{cache} bytes");
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() <= f32::EPSILON), "{cache} bytes");
        }
    }

    #[test]
    fn room_is_given_back_when_the_size_changes() {
        let mut views = Views::new(photos([0.0; 3]), [0.0; 3], 1, &Device::flex());
        let room = views.cache_left;
        views.prepare(0, None);
        assert!(views.cache_left < room && views.views[0].truth.is_some());
        views.reduce(2);
        assert!(views.cache_left == room && views.views[0].truth.is_none());
    }
}
