//! The choices of numerical dials that have names: see [`crate::RenderOptions`].

/// Which 16 × 16 tiles list a Gaussian. It changes the time of a render, never what it computes: what a tile lists in vain shows
/// in none of its pixels.
///
/// Each lists what the ones after it list, and more. On CPUs pictures and gradients are the same bit by bit. On GPUs they are where
/// no tile lists more Gaussians than one bucket of `rasterize` holds (32). In longer lists the borders of buckets lie
/// elsewhere, so sums are grouped and rounded differently: the same within the rounding of f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Culling {
    /// A square around the centre, as far on each side as the long axis of an opaque Gaussian of this shape shows. Kerbl et al.
    /// 2023 take 3 standard deviations; here it is `√(2 ln(1 / alpha_min))` of them, 3.33 for `1/255`, so that nothing is lost.
    BoundingBox,
    /// The box around the ellipse within which this opacity shows, `u² + v² <= 2 ln(opacity / alpha_min)`.
    OpacityBox,
    /// The tiles that this ellipse itself meets.
    #[default]
    Ellipse,
}

/// How `rasterize` computes `exp` in f32. In f64 it is always the library's: that is the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Exponential {
    /// What is quickest where it runs: [`Self::Polynomial`] on CPUs, [`Self::Library`] on GPUs.
    #[default]
    Standard,
    /// The function of whoever made the platform: of Rust's standard library on CPUs, a pixel at a time, within an ulp; of the
    /// shading language on GPUs, where the driver decides how exact it is (WGSL allows `3 + 2|x|` ulp).
    Library,
    /// A polynomial of degree 6 after the integer part of the exponent is taken out: within 2 ulp wherever it runs.
    Polynomial,
}

/// How coefficients of spherical harmonics are stored. What is computed with them, sums and gradients are f32 or f64 as ever, and
/// gradients are those at the rounded numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Storage {
    /// As they are given.
    #[default]
    Full,
    /// Rounded to the nearest half-precision float, one of at most 65,504: an error of at most 2⁻¹¹ of a number, or of 2⁻²⁵ of one
    /// below 2⁻¹⁴. (It is Burn's cast: a driver may round towards zero, which doubles that.) On GPUs two share a word, so half as
    /// much is read.
    Half,
}
