//! The rays of the pixels of a camera with a lens, on the host, in f64, and how much the lens bends between them.

use std::collections::VecDeque;
use std::f64::consts::FRAC_PI_2;
use std::sync::{Arc, Mutex, PoisonError};

use glam::DVec2;

use super::lens::FAR;
#[cfg(feature = "cube")]
use crate::gpu::{Buffer, Client, Gpu};
use crate::{CameraModel, Intrinsics, tasks};

/// Slope of a pixel without a ray.
const NO_RAY: f64 = 1e30;

/// Slopes from here on are those of pixels without a ray.
pub(crate) const LEAST_NO_RAY: f64 = 1e29;

/// Number of pictures whose rays are kept.
const KEPT: usize = 4;

/// Radius, relative to the farthest ray of the picture, up to which [`PictureRays::bend_px`] holds: of slopes, and of the angles of a
/// fisheye.
const BEYOND: [f64; 2] = [1.25, 1.5];

/// The rays of a picture that was taken through a lens.
pub(crate) struct PictureRays {
    /// `[H, W]`: slopes `(x/z, y/z)` of the ray through each pixel's centre. Pixels without a ray have slopes of 1e30: no direction
    /// in the lens's domain and in front of the camera projects to them.
    pub slopes: Vec<[f64; 2]>,
    /// Smallest and largest slopes of rays.
    pub low: [f64; 2],
    pub high: [f64; 2],
    /// Largest distance of a ray from the axis, as a slope.
    pub farthest: f64,
    /// Upper bound of the second derivative of the planar map of [`CameraModel`], px, up to the distance `bend_radius` from the
    /// axis, a slope.
    pub bend_px: f64,
    pub bend_radius: f64,
    /// Upper bound of the first derivative of a fisheye's planar map, px.
    pub stretch_px: f64,
    /// The slopes on the devices that rendered the picture.
    #[cfg(feature = "cube")]
    on_devices: Mutex<Vec<(Client, Buffer<f32>)>>,
}

impl PictureRays {
    /// Returns the rays of the picture, or `None` for a pinhole, whose rays are those of its pixels' positions. The rays of the last
    /// pictures are kept, because captures render the same camera again and again.
    pub fn of(camera: &Intrinsics) -> Option<Arc<Self>> {
        static RECENT: Mutex<VecDeque<(Intrinsics, Arc<PictureRays>)>> = Mutex::new(VecDeque::new());
        if camera.model == CameraModel::Pinhole {
            return None;
        }
        let recent = || RECENT.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = recent().iter().find(|(of, _)| of == camera).map(|(_, rays)| rays.clone());
        Some(kept.unwrap_or_else(|| {
            let rays = Arc::new(Self::new(camera));
            let mut recent = recent();
            recent.truncate(KEPT - 1);
            recent.push_front((*camera, rays.clone()));
            rays
        }))
    }

    /// Returns the slopes on a device, `[H, W, 2]`, where they stay as long as the rays are kept.
    #[cfg(feature = "cube")]
    pub fn on(&self, gpu: &Gpu) -> Buffer<f32> {
        let mut kept = self.on_devices.lock().unwrap_or_else(PoisonError::into_inner);
        let device = gpu.client.service_id();
        if let Some((_, slopes)) = kept.iter().find(|(client, _)| client.service_id() == device) {
            return slopes.clone();
        }
        let slopes: Vec<f32> = self.slopes.as_flattened().iter().map(|slope| *slope as f32).collect();
        let slopes = Buffer::from_slice(gpu, &slopes);
        kept.push((gpu.client.clone(), slopes.clone()));
        slopes
    }

    fn new(camera: &Intrinsics) -> Self {
        let (lens, fisheye) = (camera.coefficients(), camera.model.is_fisheye());
        let domain = camera.max_radius().min(if fisheye { FRAC_PI_2 } else { FAR });
        let mut slopes = vec![[NO_RAY; 2]; camera.width * camera.height];
        tasks::for_each(slopes.chunks_mut(camera.width), |y, row| {
            let mut near = DVec2::ZERO;
            for (x, slope) in row.iter_mut().enumerate() {
                let d = camera.focal_from_px(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                let Some(found) = lens.inverse_within(d, domain, near) else { continue };
                near = found;
                let angle = found.length();
                let s = if fisheye && angle > 0.0 { found * (angle.tan() / angle) } else { found };
                if s.length() < FAR {
                    *slope = s.to_array();
                }
            }
        });
        let (mut low, mut high, mut farthest) = (DVec2::ZERO, DVec2::ZERO, 0.0_f64);
        for s in slopes.iter().filter(|slope| slope[0] < LEAST_NO_RAY) {
            let s = DVec2::from_array(*s);
            (low, high, farthest) = (low.min(s), high.max(s), farthest.max(s.length()));
        }
        let [of_slopes, of_angles] = BEYOND;
        let limit = if fisheye { of_angles * farthest.atan() } else { of_slopes * farthest }.min(domain);
        let focal = camera.fx.max(camera.fy);
        let [stretch, bend] = lens.steepest(limit).map(|value| focal * value);
        Self {
            slopes,
            low: low.to_array(),
            high: high.to_array(),
            farthest,
            bend_px: bend,
            bend_radius: if fisheye { limit.tan() } else { limit },
            stretch_px: if fisheye { stretch } else { 0.0 },
            #[cfg(feature = "cube")]
            on_devices: Mutex::default(),
        }
    }
}
