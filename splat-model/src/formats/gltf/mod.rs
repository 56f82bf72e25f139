//! glTF 2.0 with the extension `KHR_gaussian_splatting`, as ratified by Khronos
//! (<https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_gaussian_splatting>; glTF 2.0, §3.6 to §3.7 for buffers and
//! meshes, §4.4 for the binary container).
//!
//! A scene is a mesh primitive of points whose attributes have one element per Gaussian:
//!
//! | attribute | written as | holds |
//! |---|---|---|
//! | `POSITION` | 3 floats | the centre |
//! | `COLOR_0` | 4 normalised bytes | colour and opacity for programs that draw points |
//! | `KHR_gaussian_splatting:ROTATION` | 4 floats | a unit quaternion, `x y z w` |
//! | `KHR_gaussian_splatting:SCALE` | 3 floats | standard deviations, not their logarithms |
//! | `KHR_gaussian_splatting:OPACITY` | 1 float | the opacity, 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | 3 floats each | the harmonic of degree `l`, order `n − l`, of the three channels; `l` to 3 |
//!
//! Attributes are written as floats, so that conversion loses nothing but the rounding of `exp` and the logistic function. The format is
//! written for other programs, and not read.
//!
//! **Frame.** glTF is left-up-front: half a turn about `z` from the frame of scenes here. `asset.extras` stores the origin, in the frame of
//! scenes here, and the mark of antialiasing; the format itself has no place for them.
//!
//! **Crates.** `gltf` 1.4 refuses attributes whose names have a colon, as those of the extension do.

#[cfg(test)]
mod tests;
mod write;

pub(super) use write::write;

/// The highest degree of the spherical harmonics.
pub(super) const DEGREE_MAX: usize = 3;

/// First bytes of the binary container.
const MAGIC: [u8; 4] = *b"glTF";

/// Version of the binary container.
const VERSION: u32 = 2;

/// Types of the container's chunks.
const CHUNKS: [[u8; 4]; 2] = [*b"JSON", *b"BIN\0"];

const EXTENSION: &str = "KHR_gaussian_splatting";

/// The kernel and the colour space of scenes here.
const KERNEL: &str = "ellipse";
const COLOUR_SPACE: &str = "srgb_rec709_display";

/// Names of the attributes, without those of harmonics.
const POSITION: &str = "POSITION";
const ROTATION: &str = "KHR_gaussian_splatting:ROTATION";
const SCALE: &str = "KHR_gaussian_splatting:SCALE";
const OPACITY: &str = "KHR_gaussian_splatting:OPACITY";

/// Name of the attribute of harmonic `k` in the order of the coefficients, `k = l² + n`.
fn harmonic(k: usize) -> String {
    let l = k.isqrt();
    format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{}", k - l * l)
}
