//! A Gaussian along a pixel's ray, in the kernels.

use cubecl::prelude::*;

use super::pair_sums::RaySums;
use super::{D_MIN, WHITENED_MAX};
use crate::camera::LEAST_NO_RAY;
use crate::gpu::{Vec2, Vec3, finite, within};
use crate::project::forward::PackedEllipse;
use crate::rasterize::blocks::{BLOCK_PIXELS, HALF_BLOCKS, pixel_of};
use crate::rasterize::layer::{Four, KernelShape, RasterFrame, SplatInputs, TilePixel, four};
use crate::rasterize::splat::{BlockPairs, Splat};
use crate::ray_space::{KernelFrame, LENS_FRAME, RAY_SPACE, SLOPES};

/// A Gaussian as pixels evaluate it: its whitening, its depth slope, its centre relative to the origin of the whitened
/// coordinates, and the columns of a lens.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct RayGaussian {
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
    frame: ComptimeOption<KernelFrame>,
}

/// Whitened coordinates.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct WhitenedPoint {
    u: f32,
    v: f32,
}

#[cube]
fn whiten(dx: f32, dy: f32, sigma_u: f32, shear: f32, sigma_v: f32) -> WhitenedPoint {
    let widest = comptime!(WHITENED_MAX as f32);
    // Divided by each pixel: the rounding of a reciprocal would be the same in all of them.
    let u = within(dx / sigma_u, -widest, widest);
    let v = within((dy - shear * dx) / sigma_v, -widest, widest);
    WhitenedPoint { u, v }
}

/// Returns the columns of a lens of the row of `ray_space` that begins at `at`, if there is one.
#[cube]
fn frame_of(inputs: &SplatInputs, at: usize) -> ComptimeOption<KernelFrame> {
    let first = at + comptime!(RAY_SPACE);
    #[comptime]
    match &inputs.slopes {
        ComptimeOption::Some(_slopes) => ComptimeOption::new_Some(KernelFrame {
            centre: Vec2::new(inputs.ray_value(first), inputs.ray_value(first + 1)),
            x: Vec2::new(inputs.ray_value(first + 2), inputs.ray_value(first + 3)),
            y: Vec2::new(inputs.ray_value(first + 4), inputs.ray_value(first + 5)),
        }),
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

/// Returns the point of the picture next to a centre, px, with a lens the centre itself.
#[cube]
fn base_of(x: f32, y: f32, inputs: &SplatInputs, frame: &RasterFrame) -> (f32, f32) {
    let mut base_x = x;
    let mut base_y = y;
    if comptime!(inputs.slopes.is_none()) {
        base_x = within(x, 0.0, f32::cast_from(frame.width));
        base_y = within(y, 0.0, f32::cast_from(frame.height));
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
}

#[cube]
impl RayGaussian {
    fn whitened(&self, dx: f32, dy: f32) -> WhitenedPoint {
        whiten(dx, dy, self.sigma_u, self.shear, self.sigma_v)
    }

    /// Returns the negative gradient of a position, px, from that of its whitened coordinates.
    pub fn per_px(&self, u: f32, v: f32) -> (f32, f32) {
        let per_v = v / self.sigma_v;
        (u / self.sigma_u - self.shear * per_v, per_v)
    }

    /// Returns the whitened coordinates of a pixel's ray, and whether there is a ray. For a pinhole the pixel's own coordinates are
    /// those of its ray.
    fn ray(&self, pixel: &TilePixel, own: WhitenedPoint) -> (WhitenedPoint, bool) {
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

    /// Evaluates the Gaussian at a pixel.
    fn at(&self, pixel: &TilePixel, frame: &RasterFrame) -> RayLayer {
        let farthest = comptime!((WHITENED_MAX * WHITENED_MAX) as f32);
        let own = self.whitened(pixel.x - self.base_x, (pixel.top + pixel.row) - self.base_y);
        let (ray, sees) = self.ray(pixel, own);
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
        let alpha = min(whole, frame.alpha_max);
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
            alpha: select(known && seen && alpha >= frame.alpha_min, alpha, 0.0),
        }
    }

    /// Adds a pixel to the sums, from `h = α ∂L/∂α` and the weight times the gradient of depth, `seen`.
    fn add_to(
        &self,
        to: &mut RaySums,
        layer: &RayLayer,
        h: f32,
        seen: f32,
        #[comptime] depth: bool,
        #[comptime] absolute: bool,
    ) {
        let (u, v) = (layer.u, layer.v);
        let (slope_u, slope_v) = (self.depth_slope_u, self.depth_slope_v);
        let (a, b, c) = (layer.apart_u, layer.apart_v, layer.apart_s);
        // As `fma`, so that no compiler rounds otherwise where the sums of absolute values read these too.
        let (reach_u, reach_v) = (fma(c, slope_u, a), fma(c, slope_v, b));
        let of_depth = h * c;
        let mut of_gamma = -of_depth;
        let mut of_thickness = c * of_depth;
        // The negative gradients of `α` and `β`.
        let mut centre_u = h * reach_u;
        let mut centre_v = h * reach_v;
        if comptime!(depth) {
            let of_lambda = seen * self.depth;
            let (far, along_s) = (of_lambda * layer.phi, of_lambda * layer.along);
            of_gamma += along_s;
            of_thickness -= 2.0 * c * along_s;
            centre_u = fma(h, reach_u, fma(far, u, -(along_s * slope_u)));
            centre_v = fma(h, reach_v, fma(far, v, -(along_s * slope_v)));
            to.sums[3] += far * reach_u * u;
            to.sums[4] += far * reach_v * u;
            to.sums[5] += far * reach_v * v;
            to.sums[6] -= far * c * u;
            to.sums[7] -= far * c * v;
        }
        to.sums[6] += of_gamma * a;
        to.sums[7] += of_gamma * b;
        to.sums[8] += self.thickness * of_thickness;
        to.sums[9] += of_gamma;
        to.sums[0] += h;
        to.sums[1] += centre_u;
        to.sums[2] += centre_v;
        to.sums[3] += centre_u * a;
        to.sums[4] += centre_v * a;
        to.sums[5] += centre_v * b;
        if comptime!(absolute) {
            let (x, y) = self.per_px(centre_u, centre_v);
            to.sums[10] += x.abs();
            to.sums[11] += y.abs();
        }
    }
}

/// Takes the columns of a lens from three vectors of four, if there is one.
#[cube]
fn stored_frame(centre: Four, rows: Four, inputs: &SplatInputs) -> ComptimeOption<KernelFrame> {
    #[comptime]
    match &inputs.slopes {
        ComptimeOption::Some(_slopes) => ComptimeOption::new_Some(KernelFrame {
            centre: Vec2::new(centre.extract(0usize), centre.extract(1usize)),
            x: Vec2::new(rows.extract(0usize), rows.extract(1usize)),
            y: Vec2::new(rows.extract(2usize), rows.extract(3usize)),
        }),
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

#[cube]
impl Splat for RayGaussian {
    const VECTORS: usize = 4;
    const EXTRA_COLUMNS: usize = SLOPES;
    const ALONG_RAYS: bool = true;

    fn of(inputs: &SplatInputs, gaussian: usize, _top: f32, frame: &RasterFrame) -> RayGaussian {
        let at = gaussian * comptime!(RAY_SPACE + if inputs.slopes.is_some() { LENS_FRAME } else { 0 });
        let e = PackedEllipse::load(&inputs.projected, gaussian);
        let (base_x, base_y) = base_of(e.x, e.y, inputs, frame);
        let (depth_slope_u, depth_slope_v) = (inputs.ray_value(at), inputs.ray_value(at + 1));
        let (sigma_u, shear, sigma_v) = (inputs.ray_value(at + 6), inputs.ray_value(at + 7), inputs.ray_value(at + 8));
        let centre = whiten(inputs.ray_value(at + 4), inputs.ray_value(at + 5), sigma_u, shear, sigma_v);
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
            thickness: inputs.ray_value(at + 2),
            alpha: centre.u,
            beta: centre.v,
            gamma: inputs.ray_value(at + 3) - (depth_slope_u * centre.u + depth_slope_v * centre.v),
            frame: frame_of(inputs, at),
        }
    }

    /// With a lens the centre is the origin, and the pixel's position is not read.
    fn store(splat: &RayGaussian, to: &mut Shared<[Four]>, index: usize) {
        let at = index * 4;
        to[at] = four(splat.sigma_u, splat.shear, splat.sigma_v, splat.opacity);
        to[at + 1] = four(splat.depth, splat.depth_slope_u, splat.depth_slope_v, splat.thickness);
        #[comptime]
        match splat.frame {
            ComptimeOption::Some(frame) => {
                to[at + 2] = four(frame.centre.x, frame.centre.y, 0.0, 0.0);
                to[at + 3] = four(frame.x.x, frame.x.y, frame.y.x, frame.y.y);
            }
            ComptimeOption::None => {
                to[at + 2] = four(splat.base_x, splat.base_y, splat.gamma, 0.0);
                to[at + 3] = four(splat.alpha, splat.beta, 0.0, 0.0);
            }
        }
    }

    fn load(from: &Shared<[Four]>, index: usize, inputs: &SplatInputs) -> RayGaussian {
        let at = index * 4;
        let (shape, depth, place, centre) = (from[at], from[at + 1], from[at + 2], from[at + 3]);
        let bends = comptime!(inputs.slopes.is_some());
        RayGaussian {
            base_x: place.extract(0usize),
            base_y: place.extract(1usize),
            sigma_u: shape.extract(0usize),
            shear: shape.extract(1usize),
            sigma_v: shape.extract(2usize),
            opacity: shape.extract(3usize),
            depth: depth.extract(0usize),
            depth_slope_u: depth.extract(1usize),
            depth_slope_v: depth.extract(2usize),
            thickness: depth.extract(3usize),
            alpha: if comptime!(bends) { 0.0f32.runtime() } else { centre.extract(0usize) },
            beta: if comptime!(bends) { 0.0f32.runtime() } else { centre.extract(1usize) },
            gamma: if comptime!(bends) { 1.0f32.runtime() } else { place.extract(2usize) },
            frame: stored_frame(place, centre, inputs),
        }
    }

    /// All blocks: a tile lists the Gaussian because it may show there.
    fn blocks_met(splat: &RayGaussian, _left: f32, _half: u32, _frame: &RasterFrame) -> u32 {
        select(splat.opacity > 0.0, comptime!((1u32 << HALF_BLOCKS) - 1), 0u32)
    }

    fn seen(splat: &RayGaussian, pixel: &TilePixel, frame: &RasterFrame) -> (f32, f32) {
        let layer = splat.at(pixel, frame);
        (layer.alpha, layer.depth)
    }

    /// Adds the moments, the gradients of the depth slope, the thickness and the centre's relative depth, and the sums of absolute values.
    fn add_pairs(
        row: &mut Array<f32>,
        splat: &RayGaussian,
        pairs: BlockPairs,
        heights: &Shared<[f32]>,
        weights: &Shared<[f32]>,
        grad: &[f32],
        inputs: &SplatInputs,
        frame: &RasterFrame,
        #[comptime] shape: KernelShape,
        #[comptime] absolute: bool,
    ) {
        let of_depth = pairs.plane * comptime!(shape.features + 1);
        let mut sums = RaySums::new();
        for other in 0..comptime!(BLOCK_PIXELS as u32) {
            let at = (pairs.at + other) as usize;
            let weight = weights[at];
            if weight > 0.0 {
                let pixel = TilePixel::of(pairs.origin, pixel_of(pairs.first_unit + other), inputs, frame);
                let layer = splat.at(&pixel, frame);
                let mut seen = 0.0f32;
                if comptime!(shape.depth) {
                    seen = weight * grad[of_depth + pixel.index];
                }
                splat.add_to(&mut sums, &layer, heights[at], seen, shape.depth, absolute);
            }
        }
        sums.add_to(row, shape, absolute);
    }
}
