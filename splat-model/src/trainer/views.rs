//! The photographs of a run, at its current picture size and prepared for the loss.

mod ahead;

use std::sync::Arc;

use burn::tensor::{Bool, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_op::{Camera, Intrinsics};

use self::ahead::Ahead;
use crate::capture::packed::PackedPhoto;
use crate::capture::{Photo, Photograph, Result};
use crate::effects::masks;
use crate::loss::Truth;

/// Smallest side of reduced pictures, px. The window of SSIM has eleven.
pub(super) const SMALLEST_SIDE: usize = 32;

struct TrainingView {
    photograph: Photograph,
    /// The camera at the run's current size, and its given pose.
    camera: Camera,
    /// Decoded pixels: permanent if the photograph is kept, otherwise for one step.
    photo: Option<Arc<Photo>>,
    truth: Option<Truth>,
    /// Packed pixels on the device, if not all prepared photographs fit.
    packed: Option<PackedPhoto>,
    /// `[1, H, W]`: the pixels that a mask excludes. A byte per pixel on a CPU and four on a GPU, not counted in the cache.
    excluded: Option<Tensor<3, Bool>>,
}

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

    /// The camera of a view at the current size.
    pub fn camera(&self, view: usize) -> &Camera {
        &self.views[view].camera
    }

    pub fn pose(&self, view: usize) -> &DAffine3 {
        &self.views[view].photograph.cam_from_world
    }

    /// Sets the divisor of the sides.
    pub fn reduce(&mut self, divisor: usize) {
        if divisor == self.divisor {
            return;
        }
        (self.divisor, self.cache_left) = (divisor, self.cache);
        for view in &mut self.views {
            let full = view.photograph.intrinsics;
            let reduced = reduced_size(&full, divisor);
            view.camera.intrinsics = reduced.map_or(full, |[width, height]| full.resized(width, height));
            (view.photo, view.truth, view.packed, view.excluded) = (None, None, None, None);
        }
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

    /// A photograph's pixels at the run's current size. Pixels that are not kept are released at the request for another photograph.
    fn pixels(&mut self, view: usize) -> Result<Arc<Photo>> {
        if let Some(photo) = &self.views[view].photo {
            return Ok(Arc::clone(photo));
        }
        let divisor = self.divisor;
        let of = &mut self.views[view];
        // A photograph may be kept from its first decoding on, which may be under way.
        let photo = match of.photograph.is_kept() && !self.ahead.has_begun(view, divisor) {
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

    /// `[1, H, W]`: the excluded pixels of a view. `None` if no pixel is excluded. Cached. An error if the photograph
    /// must be decoded again and cannot be.
    pub fn excluded(&mut self, view: usize) -> Result<Option<Tensor<3, Bool>>> {
        if !self.views[view].photograph.has_mask {
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
        if self.reserve(bytes) {
            self.views[view].excluded = Some(excluded.clone());
        }
        Ok(Some(excluded))
    }

    /// A view's camera and its photograph, which is black where its mask excludes pixels. The photograph is cached while there is room:
    /// prepared, or packed on a GPU where not all prepared ones fit. A photograph with transparent parts is prepared again over `drawn`, if
    /// this step has a drawn background. An error if the photograph must be decoded again and cannot be.
    pub fn prepare(&mut self, view: usize, drawn: Option<[f32; 3]>) -> Result<(Camera, Truth)> {
        let of = &self.views[view];
        let (camera, drawn) = (of.camera.clone(), drawn.filter(|_| of.photograph.has_alpha));
        if let (None, Some(truth)) = (drawn, &of.truth) {
            return Ok((camera, truth.clone()));
        }
        let excluded = self.excluded(view)?;
        // Photographs over a fixed background are packed only where not all of them fit prepared.
        let packs = drawn.is_none()
            && self.packs
            && self.views.iter().map(|view| prepared_bytes(&view.camera)).sum::<usize>() > self.cache;
        let background = drawn.unwrap_or(self.background);
        let packed = if packs || drawn.is_some() { self.packed(view)? } else { None };
        let picture = match packed {
            Some(packed) => packed.rgb_over(background),
            None if packs => PackedPhoto::new(&*self.pixels(view)?, &self.device).rgb_over(background),
            None => self.pixels(view)?.rgb_over(background, &self.device),
        };
        let truth = Truth::new(masks::cleared(picture, excluded.as_ref()));
        if drawn.is_none() && !packs && self.reserve(prepared_bytes(&camera)) {
            self.views[view].truth = Some(truth.clone());
        }
        Ok((camera, truth))
    }

    /// The photograph in four bytes per pixel, if it is cached in that form or can be from now on.
    fn packed(&mut self, view: usize) -> Result<Option<PackedPhoto>> {
        let Intrinsics { width, height, .. } = self.views[view].camera.intrinsics;
        let is_new = self.packs && self.views[view].packed.is_none();
        if is_new && self.reserve(PackedPhoto::PIXEL * width * height) {
            self.views[view].packed = Some(PackedPhoto::new(&*self.pixels(view)?, &self.device));
        }
        Ok(self.views[view].packed.clone())
    }

    /// Whether `bytes` more fit into the cache. Reserves them if so.
    fn reserve(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.cache_left;
        self.cache_left -= if fits { bytes } else { 0 };
        fits
    }
}

/// Size of the prepared photograph of a camera, bytes.
fn prepared_bytes(camera: &Camera) -> usize {
    3 * PREPARED * camera.intrinsics.width * camera.intrinsics.height
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
mod tests;
