//! Vectors, matrices, rotations and float tests for kernels.
//!
//! NaN and infinity are decided on bits ([`finite`], [`positive`], [`clamped`]). Compilers of shaders may assume that neither
//! occurs: they then fold comparisons, and `min` and `max` may return either argument. A comparison may decide only where its
//! operands are known to be finite, or where the bits decide as well.

use cubecl::prelude::*;

/// A vector in picture axes.
#[derive(CubeType, CubeTypeMut, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Vec2 {
    pub x: f32,
    pub y: f32,
}

#[cube]
impl Vec2 {
    pub fn new(x: f32, y: f32) -> Vec2 {
        Vec2 { x, y }
    }

    pub fn dot(&self, other: Vec2) -> f32 {
        self.x * other.x + self.y * other.y
    }
}

/// A vector in the axes of a frame.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Vec3 {
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

#[cube]
impl Vec3 {
    pub fn new(x: f32, y: f32, z: f32) -> Vec3 {
        Vec3 { x, y, z }
    }

    pub fn load(from: &[f32], at: usize) -> Vec3 {
        Vec3 { x: from[at], y: from[at + 1], z: from[at + 2] }
    }

    pub fn store(&self, to: &mut [f32], at: usize) {
        to[at] = self.x;
        to[at + 1] = self.y;
        to[at + 2] = self.z;
    }

    pub fn plus(&self, other: Vec3) -> Vec3 {
        Vec3 { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }

    pub fn minus(&self, other: Vec3) -> Vec3 {
        Vec3 { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    pub fn times(&self, factor: f32) -> Vec3 {
        Vec3 { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    pub fn by_axis(&self, other: Vec3) -> Vec3 {
        Vec3 { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }

    pub fn dot(&self, other: Vec3) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    pub fn cross(&self, other: Vec3) -> Vec3 {
        Vec3 {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// Whether no component is infinite or NaN.
    pub fn is_finite(&self) -> bool {
        let (x, y, z) = (u32::reinterpret(self.x), u32::reinterpret(self.y), u32::reinterpret(self.z));
        max(max(x & comptime!(EXPONENT), y & comptime!(EXPONENT)), z & comptime!(EXPONENT)) != comptime!(EXPONENT)
    }

    /// The largest absolute component.
    pub fn largest(&self) -> f32 {
        max(max(self.x.abs(), self.y.abs()), self.z.abs())
    }

    /// The length. Scaling keeps squares from overflowing or vanishing.
    pub fn length(&self) -> f32 {
        let (down, up) = powers_of_two(self.largest());
        let scaled = self.times(down);
        scaled.dot(scaled).sqrt() * up
    }
}

/// Returns a power of two that scales a number of this size to between 1 and 4, or leaves it below 1 if it is subnormal, and the
/// inverse of that power. Multiplication by either is exact; division by the size would not be, as WebGPU allows 2.5 ulp.
#[cube]
pub(crate) fn powers_of_two(size: f32) -> (f32, f32) {
    let exponent = min(max((u32::reinterpret(size) >> 23) & 255, 1), 253);
    (f32::reinterpret((254 - exponent) << 23), f32::reinterpret(exponent << 23))
}

/// A matrix, stored by rows.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Mat3 {
    pub x: Vec3,
    pub y: Vec3,
    pub z: Vec3,
}

#[cube]
impl Mat3 {
    /// `A v`.
    pub fn apply(&self, v: Vec3) -> Vec3 {
        Vec3 { x: self.x.dot(v), y: self.y.dot(v), z: self.z.dot(v) }
    }

    /// `Aᵀ v`.
    pub fn apply_transposed(&self, v: Vec3) -> Vec3 {
        self.x.times(v.x).plus(self.y.times(v.y)).plus(self.z.times(v.z))
    }

    /// `A B`.
    pub fn times(&self, other: Mat3) -> Mat3 {
        Mat3 { x: other.apply_transposed(self.x), y: other.apply_transposed(self.y), z: other.apply_transposed(self.z) }
    }

    pub fn transposed(&self) -> Mat3 {
        Mat3 {
            x: Vec3 { x: self.x.x, y: self.y.x, z: self.z.x },
            y: Vec3 { x: self.x.y, y: self.y.y, z: self.z.y },
            z: Vec3 { x: self.x.z, y: self.y.z, z: self.z.z },
        }
    }
}

/// Number of values that a unit of a search loads together.
pub(crate) const AT_ONCE: usize = 4;

/// Number of entries of a pose.
pub(crate) const POSE: usize = 12;

/// A camera's pose, `[3, 4]`: a matrix, which need not be a rotation, and a translation. Also used for the gradient of a pose.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Pose {
    pub matrix: Mat3,
    pub translation: Vec3,
}

#[cube]
impl Pose {
    pub fn load(from: &[f32]) -> Pose {
        Pose {
            matrix: Mat3 { x: Vec3::load(from, 0), y: Vec3::load(from, 4), z: Vec3::load(from, 8) },
            translation: Vec3::new(from[3], from[7], from[11]),
        }
    }

    pub fn store(&self, to: &mut [f32], at: usize) {
        self.matrix.x.store(to, at);
        self.matrix.y.store(to, at + 4);
        self.matrix.z.store(to, at + 8);
        to[at + 3] = self.translation.x;
        to[at + 7] = self.translation.y;
        to[at + 11] = self.translation.z;
    }

    /// Transforms a point from the world frame to the camera frame.
    pub fn apply(&self, point: Vec3) -> Vec3 {
        self.matrix.apply(point).plus(self.translation)
    }
}

/// A rotation as a quaternion wxyz.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Quaternion {
    pub w: f32,
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

#[cube]
impl Quaternion {
    /// Loads row `row` of `[N, 4]`.
    pub fn load(from: &[Vector<f32, Const<4>>], row: usize) -> Quaternion {
        let all = from[row];
        Quaternion { w: all.extract(0usize), x: all.extract(1usize), y: all.extract(2usize), z: all.extract(3usize) }
    }

    pub fn store(&self, to: &mut [Vector<f32, Const<4>>], row: usize) {
        let mut all = Vector::<f32, Const<4>>::empty();
        all.insert(0usize, self.w);
        all.insert(1usize, self.x);
        all.insert(2usize, self.y);
        all.insert(3usize, self.z);
        to[row] = all;
    }

    pub fn times(&self, factor: f32) -> Quaternion {
        Quaternion { w: self.w * factor, x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    pub fn dot(&self, other: Quaternion) -> f32 {
        self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Returns the unit quaternion and the length of this one. Scaling keeps squares from overflowing or vanishing. The result is
    /// meaningless if the length is not positive.
    pub fn unit(&self) -> (Quaternion, f32) {
        let (down, up) = powers_of_two(max(self.w.abs(), Vec3::new(self.x, self.y, self.z).largest()));
        let scaled = self.times(down);
        let length = scaled.dot(scaled).sqrt();
        (scaled.times(1.0 / length), length * up)
    }

    /// Returns the rotation matrix of a unit quaternion.
    pub fn matrix(&self) -> Mat3 {
        let (w, x, y, z) = (self.w, self.x, self.y, self.z);
        Mat3 {
            x: Vec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            y: Vec3::new(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            z: Vec3::new(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        }
    }

    /// For a unit quaternion, returns the gradient of the quaternion of length `length` that it was normalised from, given the
    /// gradient of the rotation matrix. The gradient passes through [`Self::matrix`], then through `q / |q|`, which keeps only
    /// the component normal to the unit quaternion. It is clamped to the range of f32 where the length is too short; NaN stays NaN.
    pub fn backward(&self, length: f32, grad: Mat3) -> Quaternion {
        let (w, x, y, z) = (self.w, self.x, self.y, self.z);
        let odd = Vec3::new(grad.z.y - grad.y.z, grad.x.z - grad.z.x, grad.y.x - grad.x.y);
        let even = Vec3::new(grad.z.y + grad.y.z, grad.x.z + grad.z.x, grad.y.x + grad.x.y);
        let half = Quaternion {
            w: x * odd.x + y * odd.y + z * odd.z,
            x: w * odd.x + y * even.z + z * even.y - 2.0 * x * (grad.y.y + grad.z.z),
            y: w * odd.y + x * even.z + z * even.x - 2.0 * y * (grad.x.x + grad.z.z),
            z: w * odd.z + x * even.y + y * even.x - 2.0 * z * (grad.x.x + grad.y.y),
        };
        let radial = half.dot(Quaternion { w, x, y, z });
        let normal = Quaternion {
            w: half.w - w * radial,
            x: half.x - x * radial,
            y: half.y - y * radial,
            z: half.z - z * radial,
        };
        // The length is `short * up`; neither factor can overflow before the limit is taken, nor the product after.
        let (down, up) = powers_of_two(length);
        let (short, limit) = (length * down, f32::max_value() * min(up, 1.0));
        let per_up = normal.times(2.0 / short);
        Quaternion {
            w: clamped(per_up.w, limit) * down,
            x: clamped(per_up.x, limit) * down,
            y: clamped(per_up.y, limit) * down,
            z: clamped(per_up.z, limit) * down,
        }
    }
}

/// Bits of the exponent, all set in infinities and NaN alone.
const EXPONENT: u32 = 0x7f80_0000;

/// Whether a float is neither infinite nor NaN.
#[cube]
pub(crate) fn finite(value: f32) -> bool {
    (u32::reinterpret(value) & comptime!(EXPONENT)) != comptime!(EXPONENT)
}

/// Whether a float is greater than zero, infinity included. NaN is not.
#[cube]
pub(crate) fn positive(value: f32) -> bool {
    let bits = u32::reinterpret(value);
    bits != 0 && bits <= comptime!(EXPONENT)
}

/// Whether a float is less than zero, infinity included. NaN is not.
#[cube]
pub(crate) fn negative(value: f32) -> bool {
    positive(f32::reinterpret(u32::reinterpret(value) ^ 0x8000_0000))
}

/// Clamps a float to ± `limit`, which is finite and not negative. NaN stays as it is.
#[cube]
pub(crate) fn clamped(value: f32, limit: f32) -> f32 {
    let (bits, most) = (u32::reinterpret(value), u32::reinterpret(limit));
    let size = bits & 0x7fff_ffff;
    f32::reinterpret(select(size > most && size <= comptime!(EXPONENT), (bits & 0x8000_0000) | most, bits))
}

/// Whether a float is NaN.
#[cube]
pub(crate) fn undefined(value: f32) -> bool {
    (u32::reinterpret(value) & 0x7fff_ffff) > 0x7f80_0000
}

/// Whether this unit's values, `stride` apart, are all finite. The values of a turn are loaded before any is looked at, so that
/// the unit waits for all of them together.
#[cube]
pub(crate) fn own_values_finite(values: &[f32], count: u32, stride: u32) -> bool {
    let mut at = ABSOLUTE_POS as u32;
    let mut worst = 0u32;
    while at < count {
        // Beyond the end a unit reads a value of its own once more.
        let mut place = at;
        #[unroll]
        for _turn in 0..comptime!(AT_ONCE) {
            worst = max(worst, u32::reinterpret(values[place as usize]) & comptime!(EXPONENT));
            place = select(count - place > stride, place + stride, place);
        }
        at = select(count - at > stride * comptime!(AT_ONCE as u32), at + stride * comptime!(AT_ONCE as u32), count);
    }
    worst != comptime!(EXPONENT)
}

/// Clamps `value` between two limits.
#[cube]
pub(crate) fn within(value: f32, low: f32, high: f32) -> f32 {
    min(max(value, low), high)
}
