//! Enumerations of the numerical dials of [`crate::RenderOptions`].

/// The test that decides which tiles of 16 × 16 px list a Gaussian. It changes the time of a render, not its result: a Gaussian
/// listed needlessly contributes to no pixel of the tile.
///
/// Each variant lists a superset of the variants after it. On CPUs, pictures and gradients are equal bit by bit. On GPUs they are
/// equal bit by bit if no tile lists more Gaussians than one bucket of `rasterize` holds (32). In longer lists the bucket
/// boundaries shift, so sums are grouped differently and agree within the rounding of f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Culling {
    /// Square around the centre whose half side is the extent of an opaque Gaussian along its long axis. Kerbl et al. 2023 take 3
    /// standard deviations; here it is `√(2 ln(1 / alpha_min))` of them, 3.33 for `1/255`, so that nothing is lost.
    BoundingBox,
    /// Bounding box of the ellipse in which the Gaussian's alpha is at least `alpha_min`, `u² + v² <= 2 ln(opacity / alpha_min)`.
    OpacityBox,
    /// Tiles that this ellipse itself overlaps.
    #[default]
    Ellipse,
}

/// The method by which `rasterize` computes `exp` in f32. In f64 it always uses the library's function, because that is the
/// reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Exponential {
    /// The faster method of each device: [`Self::Polynomial`] on CPUs, [`Self::Library`] on GPUs.
    #[default]
    Standard,
    /// The platform's function. On CPUs it is that of Rust's standard library, one pixel at a time, within an ulp. On GPUs it is the
    /// shading language's, whose accuracy depends on the driver (WGSL allows `3 + 2|x|` ulp).
    Library,
    /// A polynomial of degree 6 for the fractional part of the exponent: within 2 ulp on every device.
    Polynomial,
}

/// Storage of spherical-harmonics coefficients. Arithmetic, sums and gradients stay in f32 or f64; gradients are evaluated at the
/// rounded coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Storage {
    /// The given coefficients, unchanged.
    #[default]
    Full,
    /// Coefficients rounded to the nearest half-precision float and clamped to ±65,504. The error is at most 2⁻¹¹ relative, or 2⁻²⁵
    /// absolute for magnitudes below 2⁻¹⁴. (Burn's cast does the rounding: a driver may round towards zero, which doubles the
    /// error.) On GPUs two coefficients share a word, which halves the memory traffic.
    Half,
}
