//! The photographs of a run, at the size that it has come to and prepared for the loss.

mod ahead;

use std::sync::Arc;

use burn::tensor::{Bool, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_op::{Camera, Intrinsics};

use self::ahead::Ahead;
use crate::capture::packed::Packed;
use crate::capture::{CaptureError, Photo, Photograph};
use crate::effects::masks;
use crate::loss::Truth;

/// Pictures are not reduced to fewer pixels than this along a side: the window of SSIM has eleven.
pub(super) const SMALLEST_SIDE: usize = 32;

/// A photograph to train on.
struct View {
    photograph: Photograph,
    /// Width and height of a picture that is smaller than the photograph, at the run's present size.
    reduced: Option<[usize; 2]>,
    /// What `reduced` and all below are for.
    divisor: usize,
    intrinsics: Intrinsics,
    camera: Camera,
    /// Its pixels: for good where these are kept, for one step where they are not.
    photo: Option<Arc<Photo>>,
    truth: Option<Truth>,
    /// The same on the device, where prepared ones do not all fit.
    packed: Option<Packed>,
    /// `[1, H, W]`: which pixels a mask leaves out. A byte per pixel on a CPU and four on a GPU, not counted as cache.
    excluded: Option<Tensor<3, Bool>>,
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
    /// Pixels on their way, of photographs that are not kept.
    ahead: Ahead,
    /// The photograph whose pixels are here for one step.
    visiting: Option<usize>,
}

/// Bytes of a prepared value: the photograph and two of its windowed moments.
const PREPARED: usize = 3 * size_of::<f32>();

impl Views {
    pub fn new(photographs: Vec<Photograph>, background: [f32; 3], cache_mib: usize, device: &Device) -> Self {
        let view = |photograph: Photograph| View {
            reduced: None,
            divisor: 1,
            intrinsics: photograph.intrinsics,
            camera: Camera::new(photograph.intrinsics, &photograph.cam_from_world, device),
            photo: None,
            truth: None,
            packed: None,
            excluded: None,
            photograph,
        };
        let cache = cache_mib << 20;
        Self {
            views: photographs.into_iter().map(view).collect(),
            background,
            device: device.clone(),
            cache,
            cache_left: cache,
            packs: splat_op::is_gpu(device),
            divisor: 1,
            ignores_masks: false,
            ahead: Ahead::default(),
            visiting: None,
        }
    }

    pub fn len(&self) -> usize {
        self.views.len()
    }

    pub fn name(&self, view: usize) -> &str {
        &self.views[view].photograph.name
    }

    /// Width and height of a photograph as it was given, px.
    pub fn full_size(&self, view: usize) -> [usize; 2] {
        let camera = &self.views[view].photograph.intrinsics;
        [camera.width, camera.height]
    }

    /// The camera of a view, as it was last prepared, and its pose as it was given.
    pub fn camera_of(&self, view: usize) -> (&Intrinsics, &DAffine3) {
        let view = &self.views[view];
        (&view.intrinsics, &view.photograph.cam_from_world)
    }

    /// From now on sides are divided by `divisor`.
    pub fn reduce(&mut self, divisor: usize) {
        if divisor == self.divisor {
            return;
        }
        self.divisor = divisor;
        self.cache_left = self.cache;
        for view in &mut self.views {
            (view.photo, view.truth, view.packed, view.excluded) = (None, None, None, None);
        }
    }

    /// Until told otherwise, every pixel counts.
    pub fn ignore_masks(&mut self, ignore: bool) {
        self.ignores_masks = ignore;
    }

    /// Bytes of the photographs' masks on a CPU; none where no photograph has one.
    pub fn masked_bytes(&self) -> Option<usize> {
        let masked = self.views.iter().filter(|view| view.photograph.has_mask);
        let pixels = |view: &View| view.photograph.intrinsics.width * view.photograph.intrinsics.height;
        masked.map(pixels).reduce(|a, b| a + b)
    }

    /// Begins to decode those of the photographs that come next whose pixels will be needed and are not kept.
    pub fn expect(&mut self, next: impl IntoIterator<Item = usize>) {
        for view in next.into_iter().take(ahead::MOST) {
            let View { photograph, photo, truth, packed, .. } = &self.views[view];
            let needed = photo.is_none() && truth.is_none() && packed.is_none();
            if needed && !photograph.is_kept() {
                self.ahead.begin(view, photograph, self.divisor);
            }
        }
    }

    /// A photograph's pixels at the run's present size. Those that are not kept are let go when another's are asked for.
    fn pixels(&mut self, view: usize) -> Result<Arc<Photo>, CaptureError> {
        if let Some(photo) = &self.views[view].photo {
            return Ok(Arc::clone(photo));
        }
        let divisor = self.divisor;
        let of = &mut self.views[view];
        let photo = match of.photograph.is_kept() {
            true => at_size(of.photograph.pixels()?, divisor),
            false => self.ahead.take(view, &of.photograph, divisor)?,
        };
        of.photo = Some(Arc::clone(&photo));
        if !of.photograph.is_kept()
            && let Some(left) = self.visiting.replace(view).filter(|left| *left != view)
        {
            self.views[left].photo = None;
        }
        Ok(photo)
    }

    /// `[1, H, W]`: the pixels of a view, as it was last prepared, that do not count; none where all do. Kept for its next use
    /// while there is room.
    ///
    /// # Errors
    /// If the photograph has to be decoded again and cannot be.
    pub fn excluded(&mut self, view: usize) -> Result<Option<Tensor<3, Bool>>, CaptureError> {
        if self.ignores_masks || !self.views[view].photograph.has_mask {
            return Ok(None);
        }
        if let Some(excluded) = &self.views[view].excluded {
            return Ok(Some(excluded.clone()));
        }
        let photo = self.pixels(view)?;
        let Some(mask) = &photo.mask else { return Ok(None) };
        let size = [1, photo.intrinsics.height, photo.intrinsics.width];
        let excluded: Vec<bool> = mask.iter().map(|counts| !counts).collect();
        let bytes = excluded.len() * if self.packs { size_of::<u32>() } else { 1 };
        let excluded = Tensor::from_data(TensorData::new(excluded, size), &self.device);
        if bytes <= self.cache_left {
            self.cache_left -= bytes;
            self.views[view].excluded = Some(excluded.clone());
        }
        Ok(Some(excluded))
    }

    /// Brings a view to the run's present size.
    fn resize(&mut self, view: usize) {
        let view = &mut self.views[view];
        if view.divisor != self.divisor {
            view.divisor = self.divisor;
            let full = view.photograph.intrinsics;
            view.reduced = reduced_size(&full, self.divisor);
            view.intrinsics = view.reduced.map_or(full, |[width, height]| full.resized(width, height));
            view.camera = Camera::new(view.intrinsics, &view.photograph.cam_from_world, &self.device);
        }
    }

    /// A view's camera and its photograph, black where its mask leaves pixels out, which is kept for its next use while
    /// there is room: prepared; or packed, on a GPU where prepared ones would not all fit. One with transparent parts is prepared
    /// anew over `drawn`, if there is such a background for this step.
    ///
    /// # Errors
    /// If the photograph has to be decoded again and cannot be.
    pub fn prepare(&mut self, view: usize, drawn: Option<[f32; 3]>) -> Result<(Camera, Truth), CaptureError> {
        let packs = self.packs && self.prepared_bytes() > self.cache;
        self.resize(view);
        let excluded = self.excluded(view)?;
        let clear = |picture: Tensor<3>| match &excluded {
            Some(excluded) => masks::cleared(picture, excluded),
            None => picture,
        };
        let of = &self.views[view];
        let (camera, values) = (of.camera.clone(), 3 * of.intrinsics.width * of.intrinsics.height);
        let packed_bytes = values / 3 * Packed::PIXEL;
        if let Some(background) = drawn.filter(|_| of.photograph.has_alpha) {
            let truth = match self.packed(view, self.packs, packed_bytes)? {
                Some(packed) => packed.rgb_over(background),
                None => self.pixels(view)?.rgb_over(background, &self.device),
            };
            return Ok((camera, Truth::new(clear(truth))));
        }
        if let Some(truth) = &of.truth {
            return Ok((camera, truth.clone()));
        }
        if packs {
            let packed = match self.packed(view, true, packed_bytes)? {
                Some(packed) => packed,
                None => Packed::new(&*self.pixels(view)?, &self.device),
            };
            return Ok((camera, Truth::new(clear(packed.rgb_over(self.background)))));
        }
        let prepared = Truth::new(clear(self.pixels(view)?.rgb_over(self.background, &self.device)));
        if self.fits(PREPARED * values) {
            self.views[view].truth = Some(prepared.clone());
        }
        Ok((camera, prepared))
    }

    /// The photograph in four bytes per pixel, if it is kept so, or there is room to from now on.
    fn packed(&mut self, view: usize, wanted: bool, bytes: usize) -> Result<Option<Packed>, CaptureError> {
        if self.views[view].packed.is_none() && wanted && bytes <= self.cache_left {
            let packed = Packed::new(&*self.pixels(view)?, &self.device);
            self.cache_left -= bytes;
            self.views[view].packed = Some(packed);
        }
        Ok(self.views[view].packed.clone())
    }

    /// Whether there is room for so many bytes more, which are taken.
    fn fits(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.cache_left;
        self.cache_left -= if fits { bytes } else { 0 };
        fits
    }

    /// What all photographs take prepared, at the run's present size.
    fn prepared_bytes(&self) -> usize {
        let pixels = |camera: &Intrinsics| {
            let [width, height] = reduced_size(camera, self.divisor).unwrap_or([camera.width, camera.height]);
            width * height
        };
        self.views.iter().map(|view| 3 * PREPARED * pixels(&view.photograph.intrinsics)).sum()
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

/// A photograph at the size of a run whose sides are divided so.
fn at_size(photo: Arc<Photo>, divisor: usize) -> Arc<Photo> {
    match reduced_size(&photo.intrinsics, divisor) {
        Some([width, height]) => Arc::new(photo.resized(width, height)),
        None => photo,
    }
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
mod tests;
