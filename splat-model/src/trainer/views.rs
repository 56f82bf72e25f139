//! The photographs of a run, at its current picture size and prepared for the loss.

mod ahead;

use std::sync::Arc;

use burn::tensor::{Bool, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_op::{Camera, Intrinsics};

use self::ahead::Ahead;
use crate::capture::packed::PackedPhoto;
use crate::capture::{CaptureError, Photo, Photograph};
use crate::effects::masks;
use crate::loss::Truth;

/// Smallest side of reduced pictures, px. The window of SSIM has eleven.
pub(super) const SMALLEST_SIDE: usize = 32;

/// A training photograph.
struct TrainingView {
    photograph: Photograph,
    /// Width and height of the reduced picture at the run's current size. `None` at full size.
    reduced: Option<[usize; 2]>,
    /// The divisor for which `reduced` and the fields below are computed.
    divisor: usize,
    intrinsics: Intrinsics,
    camera: Camera,
    /// Decoded pixels: permanent if the photograph is kept, otherwise for one step.
    photo: Option<Arc<Photo>>,
    truth: Option<Truth>,
    /// Packed pixels on the device, if not all prepared photographs fit.
    packed: Option<PackedPhoto>,
    /// `[1, H, W]`: the pixels that a mask excludes. A byte per pixel on a CPU and four on a GPU, not counted in the cache.
    excluded: Option<Tensor<3, Bool>>,
}

/// All photographs of a run.
pub(super) struct Views {
    views: Vec<TrainingView>,
    background: [f32; 3],
    device: Device,
    /// Memory for photographs on the device, total and remaining, bytes.
    cache: usize,
    cache_left: usize,
    /// Whether photographs are packed. On a CPU packing would only copy them.
    packs: bool,
    divisor: usize,
    /// Set while the cost of masks is measured.
    ignores_masks: bool,
    /// Photographs that are decoded ahead, of those that are not kept.
    ahead: Ahead,
    /// The photograph whose pixels are in memory for one step.
    visiting: Option<usize>,
}

/// Size of a prepared value, bytes: the photograph and two of its windowed moments.
const PREPARED: usize = 3 * size_of::<f32>();

impl Views {
    pub fn new(photographs: Vec<Photograph>, background: [f32; 3], cache_mib: usize, device: &Device) -> Self {
        let view = |photograph: Photograph| TrainingView {
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

    /// Full width and height of a photograph, px.
    pub fn full_size(&self, view: usize) -> [usize; 2] {
        let camera = &self.views[view].photograph.intrinsics;
        [camera.width, camera.height]
    }

    /// The camera of a view at its last prepared size, and its given pose.
    pub fn camera_of(&self, view: usize) -> (&Intrinsics, &DAffine3) {
        let view = &self.views[view];
        (&view.intrinsics, &view.photograph.cam_from_world)
    }

    /// Sets the divisor of the sides.
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

    /// Switches masks off or on.
    pub fn ignore_masks(&mut self, ignore: bool) {
        self.ignores_masks = ignore;
    }

    /// Size of the photographs' masks on a CPU, bytes. `None` if no photograph has a mask.
    pub fn masked_bytes(&self) -> Option<usize> {
        let masked = self.views.iter().filter(|view| view.photograph.has_mask);
        let pixels = |view: &TrainingView| view.photograph.intrinsics.width * view.photograph.intrinsics.height;
        masked.map(pixels).reduce(|a, b| a + b)
    }

    /// Begins to decode those of the next photographs whose pixels are needed and not kept.
    pub fn expect(&mut self, next: impl IntoIterator<Item = usize>) {
        for view in next.into_iter().take(ahead::MOST) {
            let TrainingView { photograph, photo, truth, packed, .. } = &self.views[view];
            let needed = photo.is_none() && truth.is_none() && packed.is_none();
            if needed && !photograph.is_kept() {
                self.ahead.begin(view, photograph, self.divisor);
            }
        }
    }

    /// A photograph's pixels at the run's current size. Pixels that are not kept are released at the request for another
    /// photograph.
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

    /// `[1, H, W]`: the excluded pixels of a view at its last prepared size. `None` if no pixel is excluded. Cached.
    ///
    /// # Errors
    /// If the photograph must be decoded again and cannot be.
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

    /// Sets a view to the run's current size.
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

    /// A view's camera and its photograph, which is black where its mask excludes pixels. The photograph is cached while
    /// there is room: prepared, or packed on a GPU where not all prepared ones fit. A photograph with transparent parts is
    /// prepared again over `drawn`, if this step has a drawn background.
    ///
    /// # Errors
    /// If the photograph must be decoded again and cannot be.
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
        let packed_bytes = values / 3 * PackedPhoto::PIXEL;
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
                None => PackedPhoto::new(&*self.pixels(view)?, &self.device),
            };
            return Ok((camera, Truth::new(clear(packed.rgb_over(self.background)))));
        }
        let prepared = Truth::new(clear(self.pixels(view)?.rgb_over(self.background, &self.device)));
        if self.fits(PREPARED * values) {
            self.views[view].truth = Some(prepared.clone());
        }
        Ok((camera, prepared))
    }

    /// The photograph in four bytes per pixel, if it is cached in that form or can be from now on.
    fn packed(&mut self, view: usize, wanted: bool, bytes: usize) -> Result<Option<PackedPhoto>, CaptureError> {
        if self.views[view].packed.is_none() && wanted && bytes <= self.cache_left {
            let packed = PackedPhoto::new(&*self.pixels(view)?, &self.device);
            self.cache_left -= bytes;
            self.views[view].packed = Some(packed);
        }
        Ok(self.views[view].packed.clone())
    }

    /// Whether `bytes` more fit into the cache. Reserves them if so.
    fn fits(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.cache_left;
        self.cache_left -= if fits { bytes } else { 0 };
        fits
    }

    /// Size of all prepared photographs at the run's current size, bytes.
    fn prepared_bytes(&self) -> usize {
        let pixels = |camera: &Intrinsics| {
            let [width, height] = reduced_size(camera, self.divisor).unwrap_or([camera.width, camera.height]);
            width * height
        };
        self.views.iter().map(|view| 3 * PREPARED * pixels(&view.photograph.intrinsics)).sum()
    }
}

/// Width and height of a picture with divided sides, down to the smallest side. `None` at full size.
fn reduced_size(full: &Intrinsics, divisor: usize) -> Option<[usize; 2]> {
    let shorter = full.width.min(full.height);
    let divisor = std::iter::successors(Some(divisor), |&d| Some(d / 2))
        .find(|&d| d <= 1 || shorter / d >= SMALLEST_SIDE)
        .filter(|&d| d > 1)?;
    Some([full.width, full.height].map(|side| side.div_ceil(divisor)))
}

/// A photograph with its sides divided by `divisor`.
fn at_size(photo: Arc<Photo>, divisor: usize) -> Arc<Photo> {
    match reduced_size(&photo.intrinsics, divisor) {
        Some([width, height]) => Arc::new(photo.resized(width, height)),
        None => photo,
    }
}

#[cfg(test)]
impl Views {
    /// Number of prepared photographs in the cache.
    pub fn kept(&self) -> usize {
        self.views.iter().filter(|view| view.truth.is_some()).count()
    }

    /// Number of packed photographs in the cache.
    fn kept_packed(&self) -> usize {
        self.views.iter().filter(|view| view.packed.is_some()).count()
    }

    /// Sets the remaining size of the cache, bytes.
    pub fn leave_room(&mut self, bytes: usize) {
        self.cache_left = bytes;
    }
}

#[cfg(test)]
mod tests;
