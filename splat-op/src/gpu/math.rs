//! Vectors, matrices and tests of floats inside kernels.

use cubecl::prelude::*;

/// Three numbers along the axes of a frame.
#[derive(CubeType, Clone, Copy)]
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

    /// The length, scaled by the largest component so that no square overflows or vanishes.
    pub fn length(&self) -> f32 {
        let largest = max(max(self.x.abs(), self.y.abs()), self.z.abs());
        let mut length = 0.0f32;
        if largest > 0.0 {
            let scaled = Vec3 { x: self.x / largest, y: self.y / largest, z: self.z / largest };
            length = largest * scaled.dot(scaled).sqrt();
        }
        length
    }
}

/// Whether a float is neither infinite nor NaN, from its bits: shader compilers may assume that NaN does not occur.
#[cube]
pub(crate) fn finite(value: f32) -> bool {
    (u32::reinterpret(value) & 0x7f80_0000) != 0x7f80_0000
}

/// `value` held between two limits.
#[cube]
pub(crate) fn within(value: f32, low: f32, high: f32) -> f32 {
    min(max(value, low), high)
}
