//! A Gaussian at a pixel. The kernels of both passes share this code, so that both see the same layers.

use cubecl::prelude::*;

use super::{D_MIN, WHITENED_MAX};
use crate::camera::LEAST_NO_RAY;
use crate::gpu::math::{Vec2, Vec3, finite, within};
use crate::intersect::forward::TileLists;
use crate::project::forward::PackedEllipse;
use crate::rasterize::layer::{KernelShape, RasterFrame, TilePixel};
use crate::ray_space::{LENS_FRAME, LensFrameKernel as LensFrame, RAY_SPACE};

/// The buffers that a launch reads.
#[derive(CubeType, CubeLaunch)]
pub(super) struct RayInputs {
    pub projected: Box<[f32]>,
    pub ray_rows: Box<[f32]>,
    pub features: Box<[f32]>,
    pub background: Box<[f32]>,
    /// `[H, W, 2]`: slopes of the pixels' rays, if the camera has a lens.
    pub rays: ComptimeOption<Box<[f32]>>,
    pub lists: TileLists,
}

/// Image size, tiles of a launch, and render options.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayFrame {
    pub frame: RasterFrame,
    /// The launch covers the tiles `first_tile..end_tile`.
    pub first_tile: u32,
    pub end_tile: u32,
    #[cube(comptime)]
    pub shape: KernelShape,
}

/// A pixel and, if the camera has a lens, the slopes of its ray.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayPixel {
    pub pixel: TilePixel,
    pub ray: ComptimeOption<Vec2>,
}

#[cube]
impl RayPixel {
    /// Reads the ray of a pixel. One outside the picture has an arbitrary ray.
    pub fn of(pixel: TilePixel, inputs: &RayInputs) -> RayPixel {
        #[comptime]
        match &inputs.rays {
            ComptimeOption::Some(rays) => {
                let at = select(pixel.inside, 2 * pixel.index, 0usize);
                let ray = Vec2::new(rays[at], rays[at + 1]);
                RayPixel { pixel, ray: ComptimeOption::new_Some(ray) }
            }
            ComptimeOption::None => RayPixel { pixel, ray: ComptimeOption::new_None() },
        }
    }
}

/// A Gaussian as pixels evaluate it: its whitening, its depth slope, its centre relative to the origin of the whitened
/// coordinates, and the columns of a lens.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayGaussian {
    /// Origin of the whitened coordinates, px.
    pub base_x: f32,
    pub base_y: f32,
    pub sigma_u: f32,
    pub shear: f32,
    pub sigma_v: f32,
    pub opacity: f32,
    pub depth: f32,
    pub depth_slope_u: f32,
    pub depth_slope_v: f32,
    pub thickness: f32,
    pub alpha: f32,
    pub beta: f32,
    pub gamma: f32,
    frame: ComptimeOption<LensFrame>,
}

/// Number of values of a [`RayGaussian`], with a lens or without.
pub(super) const fn shared_len(bends: bool) -> usize {
    13 + if bends { LENS_FRAME } else { 0 }
}

/// Whitened coordinates.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Whitened {
    u: f32,
    v: f32,
}

#[cube]
fn whiten(dx: f32, dy: f32, sigma_u: f32, shear: f32, sigma_v: f32) -> Whitened {
    let widest = comptime!(WHITENED_MAX as f32);
    // Divided by each pixel: the rounding of a reciprocal would be the same in all of them.
    let u = within(dx / sigma_u, -widest, widest);
    let v = within((dy - shear * dx) / sigma_v, -widest, widest);
    Whitened { u, v }
}

/// Returns the columns of a lens, if there is one.
#[cube]
fn frame_of(inputs: &RayInputs, gaussian: usize) -> ComptimeOption<LensFrame> {
    #[comptime]
    match &inputs.rays {
        ComptimeOption::Some(_rays) => ComptimeOption::new_Some(LensFrame::load(&inputs.ray_rows, gaussian)),
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

/// Returns the columns of a lens that begin at `at` of a shared list, if there is one.
#[cube]
fn stored_frame(from: &Shared<[f32]>, at: usize, inputs: &RayInputs) -> ComptimeOption<LensFrame> {
    #[comptime]
    match &inputs.rays {
        ComptimeOption::Some(_rays) => ComptimeOption::new_Some(LensFrame {
            centre: Vec2::new(from[at], from[at + 1]),
            x: Vec2::new(from[at + 2], from[at + 3]),
            y: Vec2::new(from[at + 4], from[at + 5]),
        }),
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

/// Returns the point of the picture next to a centre, px, with a lens the centre itself.
#[cube]
fn base_of(x: f32, y: f32, inputs: &RayInputs, view: &RayFrame) -> (f32, f32) {
    let mut base_x = x;
    let mut base_y = y;
    if comptime!(inputs.rays.is_none()) {
        base_x = within(x, 0.0, f32::cast_from(view.frame.width));
        base_y = within(y, 0.0, f32::cast_from(view.frame.height));
    }
    (base_x, base_y)
}

/// A Gaussian evaluated at a pixel, with the names of the module's documentation. Alpha is zero where the Gaussian is not
/// visible, or has no alpha or depth that is a number.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayLayer {
    pub u: f32,
    pub v: f32,
    /// `s/D`; `a`, `b` and `c`.
    pub along: f32,
    pub apart_u: f32,
    pub apart_v: f32,
    pub apart_s: f32,
    pub phi: f32,
    /// `λ z`, scene units.
    pub depth: f32,
    pub alpha: f32,
    /// Whether alpha is below its limit.
    pub free: bool,
}

#[cube]
impl RayGaussian {
    pub fn load(inputs: &RayInputs, gaussian: usize, view: &RayFrame) -> RayGaussian {
        let at = gaussian * comptime!(RAY_SPACE + if inputs.rays.is_some() { LENS_FRAME } else { 0 });
        let row = &inputs.ray_rows;
        let e = PackedEllipse::load(&inputs.projected, gaussian);
        let (base_x, base_y) = base_of(e.x, e.y, inputs, view);
        let (depth_slope_u, depth_slope_v) = (row[at], row[at + 1]);
        let (sigma_u, shear, sigma_v) = (row[at + 6], row[at + 7], row[at + 8]);
        let centre = whiten(row[at + 4], row[at + 5], sigma_u, shear, sigma_v);
        RayGaussian {
            base_x,
            base_y,
            sigma_u,
            shear,
            sigma_v,
            // Clamping takes NaN for a number.
            opacity: select(Vec3::new(e.x, e.y, e.shear).is_finite(), e.opacity, 0.0),
            depth: e.depth,
            depth_slope_u,
            depth_slope_v,
            thickness: row[at + 2],
            alpha: centre.u,
            beta: centre.v,
            gamma: row[at + 3] - (depth_slope_u * centre.u + depth_slope_v * centre.v),
            frame: frame_of(inputs, gaussian),
        }
    }

    /// Stores a Gaussian as entry `index` of a shared list.
    pub fn store(&self, to: &mut Shared<[f32]>, index: usize, inputs: &RayInputs) {
        let at = index * comptime!(shared_len(inputs.rays.is_some()));
        to[at] = self.base_x;
        to[at + 1] = self.base_y;
        to[at + 2] = self.sigma_u;
        to[at + 3] = self.shear;
        to[at + 4] = self.sigma_v;
        to[at + 5] = self.opacity;
        to[at + 6] = self.depth;
        to[at + 7] = self.depth_slope_u;
        to[at + 8] = self.depth_slope_v;
        to[at + 9] = self.thickness;
        to[at + 10] = self.alpha;
        to[at + 11] = self.beta;
        to[at + 12] = self.gamma;
        #[comptime]
        match self.frame {
            ComptimeOption::Some(frame) => {
                to[at + 13] = frame.centre.x;
                to[at + 14] = frame.centre.y;
                to[at + 15] = frame.x.x;
                to[at + 16] = frame.x.y;
                to[at + 17] = frame.y.x;
                to[at + 18] = frame.y.y;
            }
            ComptimeOption::None => {}
        }
    }

    /// The inverse of [`Self::store`].
    pub fn stored(from: &Shared<[f32]>, index: usize, inputs: &RayInputs) -> RayGaussian {
        let at = index * comptime!(shared_len(inputs.rays.is_some()));
        RayGaussian {
            base_x: from[at],
            base_y: from[at + 1],
            sigma_u: from[at + 2],
            shear: from[at + 3],
            sigma_v: from[at + 4],
            opacity: from[at + 5],
            depth: from[at + 6],
            depth_slope_u: from[at + 7],
            depth_slope_v: from[at + 8],
            thickness: from[at + 9],
            alpha: from[at + 10],
            beta: from[at + 11],
            gamma: from[at + 12],
            frame: stored_frame(from, at + 13, inputs),
        }
    }

    fn whitened(&self, dx: f32, dy: f32) -> Whitened {
        whiten(dx, dy, self.sigma_u, self.shear, self.sigma_v)
    }

    /// Returns the negative gradient of a position, px, from that of its whitened coordinates.
    pub fn per_px(&self, u: f32, v: f32) -> (f32, f32) {
        let per_v = v / self.sigma_v;
        (u / self.sigma_u - self.shear * per_v, per_v)
    }

    /// Returns the whitened coordinates of a pixel's ray, and whether there is a ray. For a pinhole the pixel's own coordinates are
    /// those of its ray.
    fn ray(&self, pixel: &RayPixel, own: Whitened) -> (Whitened, bool) {
        #[comptime]
        match self.frame {
            ComptimeOption::Some(frame) => {
                let ray = pixel.ray.unwrap();
                let t = Vec2::new(ray.x - frame.centre.x, ray.y - frame.centre.y);
                let sees = ray.x.abs() < comptime!(LEAST_NO_RAY as f32);
                (self.whitened(frame.x.dot(t), frame.y.dot(t)), sees)
            }
            ComptimeOption::None => (own, true.runtime()),
        }
    }

    pub fn at(&self, at: &RayPixel, view: &RayFrame) -> RayLayer {
        let farthest = comptime!((WHITENED_MAX * WHITENED_MAX) as f32);
        let pixel = at.pixel;
        let own = self.whitened(pixel.x - self.base_x, (pixel.top + pixel.row) - self.base_y);
        let (ray, sees) = self.ray(at, own);
        let (u, v) = (ray.u, ray.v);
        let square = u * u + v * v;
        let s = within(1.0 - (self.depth_slope_u * u + self.depth_slope_v * v), -farthest, farthest);
        let thick = self.thickness * self.thickness;
        let d = s * s + thick * square;
        let sound = d > comptime!(D_MIN as f32);
        let inverse = select(sound, 1.0 / select(sound, d, 1.0), 0.0);
        // With the centre as the origin, `α` and `β` are zero and `γ` is one.
        let mut product = s;
        let mut lambda = s * inverse;
        let mut apart_u = lambda * u;
        let mut apart_v = lambda * v;
        let mut apart_s = inverse * square;
        let mut exponent = 0.5 * square * inverse;
        // The same for all pixels.
        if self.alpha != 0.0 || self.beta != 0.0 || self.gamma != 1.0 {
            let dot = self.alpha * u + self.beta * v;
            product = self.gamma * s + thick * dot;
            lambda = product * inverse;
            apart_u = lambda * u - self.alpha;
            apart_v = lambda * v - self.beta;
            apart_s = inverse * (self.gamma * square - s * dot);
            exponent = 0.5 * (apart_u * apart_u + apart_v * apart_v + thick * apart_s * apart_s);
        }
        let seen = sees && product > 0.0 && sound;
        let whole = self.opacity * (-exponent).exp();
        let alpha = min(whole, view.frame.alpha_max);
        let depth = lambda * self.depth;
        // `min` and comparisons may let NaN pass.
        let known = finite(whole) && finite(depth);
        RayLayer {
            u,
            v,
            along: s * inverse,
            apart_u,
            apart_v,
            apart_s,
            phi: thick * inverse,
            depth,
            alpha: select(known && seen && alpha >= view.frame.alpha_min, alpha, 0.0),
            free: whole < view.frame.alpha_max,
        }
    }
}
