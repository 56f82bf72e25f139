//! A Gaussian at a pixel, and the next layers of a pixel. The kernels of both passes share this code, so that both see the same
//! layers.

use cubecl::prelude::*;

use super::{D_MIN, WHITENED_MAX};
use crate::camera::LEAST_NO_RAY;
use crate::depth_slope::{DEPTH_SLOPE, LENS_FRAME, LensFrameKernel as LensFrame};
use crate::gpu::math::{Vec2, Vec3, finite, within};
use crate::intersect::forward::TileLists;
use crate::project::forward::PackedEllipse;
use crate::rasterize::layer::{KernelShape, RasterFrame, TilePixel};

/// Number of layers that a unit finds in one pass through the tile's list and sorts in its registers.
pub(super) const CHUNK: usize = 16;

/// The buffers that a launch reads.
#[derive(CubeType, CubeLaunch)]
pub(super) struct RayInputs {
    pub projected: Box<[f32]>,
    pub depth_slopes: Box<[f32]>,
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
    pub exact: bool,
    #[cube(comptime)]
    pub per_pixel: bool,
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
    /// Reads the ray of a pixel inside the picture.
    pub fn of(pixel: TilePixel, inputs: &RayInputs) -> RayPixel {
        #[comptime]
        match &inputs.rays {
            ComptimeOption::Some(rays) => {
                let ray = Vec2::new(rays[2 * pixel.index], rays[2 * pixel.index + 1]);
                RayPixel { pixel, ray: ComptimeOption::new_Some(ray) }
            }
            ComptimeOption::None => RayPixel { pixel, ray: ComptimeOption::new_None() },
        }
    }
}

/// A Gaussian as pixels evaluate it: its packed ellipse, its depth slope, its centre relative to the origin of the whitened
/// coordinates, and the columns of a lens.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayGaussian {
    pub ellipse: PackedEllipse,
    pub depth_slope_u: f32,
    pub depth_slope_v: f32,
    pub thickness: f32,
    /// Origin, px, and whether the centre lies beyond the picture along each axis.
    pub base_x: f32,
    pub base_y: f32,
    pub beyond_x: bool,
    pub beyond_y: bool,
    pub alpha: f32,
    pub beta: f32,
    pub gamma: f32,
    frame: ComptimeOption<LensFrame>,
}

/// Whitened coordinates.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Whitened {
    u: f32,
    v: f32,
}

#[cube]
fn whiten(e: &PackedEllipse, dx: f32, dy: f32) -> Whitened {
    let widest = comptime!(WHITENED_MAX as f32);
    let u = within(dx / e.sigma_u, -widest, widest);
    let v = within((dy - e.shear * dx) / e.sigma_v, -widest, widest);
    Whitened { u, v }
}

/// Returns the columns of a lens, if there is one.
#[cube]
fn frame_of(inputs: &RayInputs, gaussian: usize) -> ComptimeOption<LensFrame> {
    #[comptime]
    match &inputs.rays {
        ComptimeOption::Some(_rays) => ComptimeOption::new_Some(LensFrame::load(&inputs.depth_slopes, gaussian)),
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

/// A Gaussian evaluated at a pixel, with the names of the module's documentation. Alpha is zero where the Gaussian is not
/// visible, or has no alpha or sort key that is a number.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RayLayer {
    pub u: f32,
    pub v: f32,
    /// `s/D`, and `α − λu`, `β − λv`, `(γ − λs)/thickness²`.
    pub along: f32,
    pub apart_u: f32,
    pub apart_v: f32,
    pub apart_s: f32,
    pub lambda: f32,
    pub phi: f32,
    /// Sort key `λ z`.
    pub key: f32,
    pub alpha: f32,
    /// Whether alpha is below its limit.
    pub free: bool,
}

#[cube]
impl RayGaussian {
    pub fn load(inputs: &RayInputs, gaussian: usize, view: &RayFrame) -> RayGaussian {
        let widest = comptime!(WHITENED_MAX as f32);
        let at = gaussian * comptime!(DEPTH_SLOPE + if inputs.rays.is_some() { LENS_FRAME } else { 0 });
        let mut e = PackedEllipse::load(&inputs.projected, gaussian);
        // Clamping takes NaN for a number.
        e.opacity = select(Vec3::new(e.x, e.y, e.shear).is_finite(), e.opacity, 0.0);
        let (depth_slope_u, depth_slope_v) = (inputs.depth_slopes[at], inputs.depth_slopes[at + 1]);
        let mut base_x = e.x;
        let mut base_y = e.y;
        if comptime!(view.exact && inputs.rays.is_none()) {
            base_x = within(e.x, 0.0, f32::cast_from(view.frame.width));
            base_y = within(e.y, 0.0, f32::cast_from(view.frame.height));
        }
        let (away_x, away_y) = (e.x - base_x, e.y - base_y);
        let alpha = within(away_x / e.sigma_u, -widest, widest);
        let beta = within((away_y - e.shear * away_x) / e.sigma_v, -widest, widest);
        RayGaussian {
            ellipse: e,
            depth_slope_u,
            depth_slope_v,
            thickness: inputs.depth_slopes[at + 2],
            base_x,
            base_y,
            beyond_x: away_x != 0.0,
            beyond_y: away_y != 0.0,
            alpha,
            beta,
            gamma: 1.0 - (depth_slope_u * alpha + depth_slope_v * beta),
            frame: frame_of(inputs, gaussian),
        }
    }

    /// Returns the negative gradient of a position, px, from that of its whitened coordinates.
    pub fn per_px(&self, u: f32, v: f32) -> (f32, f32) {
        let per_v = v / self.ellipse.sigma_v;
        (u / self.ellipse.sigma_u - self.ellipse.shear * per_v, per_v)
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
                (whiten(&self.ellipse, frame.x.dot(t), frame.y.dot(t)), sees)
            }
            ComptimeOption::None => (own, true.runtime()),
        }
    }

    pub fn at(&self, at: &RayPixel, view: &RayFrame) -> RayLayer {
        let farthest = comptime!((WHITENED_MAX * WHITENED_MAX) as f32);
        let (e, pixel) = (self.ellipse, at.pixel);
        let own = whiten(&e, pixel.x - self.base_x, (pixel.top + pixel.row) - self.base_y);
        let (ray, sees) = self.ray(at, own);
        let ray_square = ray.u * ray.u + ray.v * ray.v;
        let (mut u, mut v, mut square) = (ray.u, ray.v, ray_square);
        if comptime!(!view.exact) {
            u = own.u;
            v = own.v;
            square = u * u + v * v;
        }
        let s = within(1.0 - (self.depth_slope_u * ray.u + self.depth_slope_v * ray.v), -farthest, farthest);
        let thick = self.thickness * self.thickness;
        let d = s * s + thick * ray_square;
        let sound = d > comptime!(D_MIN as f32);
        let inverse = select(sound, 1.0 / select(sound, d, 1.0), 0.0);
        let dot = self.alpha * u + self.beta * v;
        let product = self.gamma * s + thick * dot;
        let lambda = product * inverse;
        let (apart_u, apart_v) = (self.alpha - lambda * u, self.beta - lambda * v);
        let apart_s = inverse * (self.gamma * square - s * dot);
        let mut exponent = 0.5 * square;
        let mut seen = sees;
        if comptime!(view.exact) {
            exponent = 0.5 * (apart_u * apart_u + apart_v * apart_v + thick * apart_s * apart_s);
            seen = sees && product > 0.0 && sound;
        }
        let whole = e.opacity * (-exponent).exp();
        let alpha = min(whole, view.frame.alpha_max);
        let key = lambda * e.depth;
        // `min` and comparisons may let NaN pass, and a NaN among the keys has no place in their order.
        let known = finite(whole) && finite(key);
        RayLayer {
            u,
            v,
            along: s * inverse,
            apart_u,
            apart_v,
            apart_s,
            lambda,
            phi: thick * inverse,
            key,
            alpha: select(known && seen && alpha >= view.frame.alpha_min, alpha, 0.0),
            free: whole < view.frame.alpha_max,
        }
    }

    /// Returns the depth of a layer, scene units.
    pub fn depth_of(&self, layer: &RayLayer, view: &RayFrame) -> f32 {
        let mut depth = self.ellipse.depth;
        if comptime!(view.exact) {
            depth = layer.key;
        }
        depth
    }
}

/// Iterates over the layers of a pixel front to back, some at a time.
#[derive(CubeType)]
pub(super) struct Walk {
    /// Sort keys of the current layers, front to back.
    keys: Array<f32>,
    pub gaussians: Array<u32>,
    /// Places in the tile's list.
    pub places: Array<u32>,
    pub alphas: Array<f32>,
    /// Progress: whether the walk has begun, the place of the last layer, and the next place of the list, or with the per-pixel
    /// sort the number of layers found. `last_key` is the key of the last layer.
    come_to: Array<u32>,
    last_key: Array<f32>,
}

/// Whether a layer is in front of another.
#[cube]
fn in_front(key: f32, place: u32, other_key: f32, other: u32) -> bool {
    key < other_key || (key == other_key && place < other)
}

#[cube]
impl Walk {
    pub fn new() -> Walk {
        let mut come_to = Array::<u32>::new(3usize);
        come_to[0] = 0u32;
        come_to[1] = 0u32;
        come_to[2] = 0u32;
        let mut last_key = Array::<f32>::new(1usize);
        last_key[0] = 0.0f32;
        Walk {
            keys: Array::<f32>::new(comptime!(CHUNK)),
            gaussians: Array::<u32>::new(comptime!(CHUNK)),
            places: Array::<u32>::new(comptime!(CHUNK)),
            alphas: Array::<f32>::new(comptime!(CHUNK)),
            come_to,
            last_key,
        }
    }

    fn put(&mut self, at: u32, key: f32, gaussian: u32, place: u32, alpha: f32) {
        self.keys[at as usize] = key;
        self.gaussians[at as usize] = gaussian;
        self.places[at as usize] = place;
        self.alphas[at as usize] = alpha;
    }

    /// Finds the next layers in a list of `places` places that begins at `first`. Returns their number, which is less than
    /// [`CHUNK`] at the end. No list and no keys make the walk endless: it ends at the last place or, with the per-pixel sort, when
    /// it has found as many layers as there are places.
    pub fn advance(&mut self, inputs: &RayInputs, first: u32, places: u32, pixel: &RayPixel, view: &RayFrame) -> u32 {
        let mut count = 0u32;
        // With the per-pixel sort, the next layers may lie anywhere in the list.
        let mut place = 0u32;
        if comptime!(!view.per_pixel) {
            place = self.come_to[2];
        }
        let mut going = self.come_to[2] < places;
        while going {
            let gaussian = inputs.lists.gaussian(first + place);
            let layer = RayGaussian::load(inputs, gaussian as usize, view).at(pixel, view);
            if layer.alpha > 0.0 {
                if comptime!(view.per_pixel) {
                    let begun = self.come_to[0] != 0;
                    let behind = in_front(self.last_key[0], self.come_to[1], layer.key, place);
                    if !begun || behind {
                        count = self.insert(count, layer.key, gaussian, place, layer.alpha);
                    }
                } else {
                    self.put(count, layer.key, gaussian, place, layer.alpha);
                    count += 1;
                }
            }
            place += 1;
            going = place < places;
            if comptime!(!view.per_pixel) {
                going = going && count < comptime!(CHUNK as u32);
            }
        }
        if count > 0 {
            self.come_to[0] = 1u32;
            self.come_to[1] = self.places[(count - 1) as usize];
            self.last_key[0] = self.keys[(count - 1) as usize];
        }
        if comptime!(view.per_pixel) {
            self.come_to[2] += count;
        } else {
            self.come_to[2] = place;
        }
        count
    }

    /// Inserts a layer into `count` sorted layers and returns the new number. If there is no room, the last layer is dropped.
    fn insert(&mut self, count: u32, key: f32, gaussian: u32, place: u32, alpha: f32) -> u32 {
        let full = count == comptime!(CHUNK as u32);
        let mut room = true;
        let mut at = count;
        if full {
            at = count - 1;
            room = in_front(key, place, self.keys[at as usize], self.places[at as usize]);
        }
        if room {
            let mut moving = at > 0;
            while moving {
                let other = at - 1;
                moving = in_front(key, place, self.keys[other as usize], self.places[other as usize]);
                if moving {
                    let (other_key, other_gaussian) = (self.keys[other as usize], self.gaussians[other as usize]);
                    let (other_place, other_alpha) = (self.places[other as usize], self.alphas[other as usize]);
                    self.put(at, other_key, other_gaussian, other_place, other_alpha);
                    at = other;
                    moving = at > 0;
                }
            }
            self.put(at, key, gaussian, place, alpha);
        }
        select(full, count, count + 1)
    }
}
