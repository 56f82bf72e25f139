//! What a render computes: model choices, numerical dials, and which outputs.

use crate::dials::{Culling, Exponential, Storage};
use crate::error::SplatError;

/// Choices and dials of a render. Start from a preset and change fields.
///
/// *Model choices* define the function and are judged against photographs; *numerical dials* approximate that function
/// and are judged against [`crate::exact`] under the same choices. The two are never mixed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// Model: variance added to both axes of every 2D ellipse, px². Half a pixel wide, so that a splat far below a
    /// pixel still covers one (Kerbl et al. 2023; EWA's low-pass filter).
    pub blur: f64,
    /// Model: splats whose centre has camera z at or below this are left out, scene units.
    pub near: f64,
    /// Model: the Jacobian of the projection is evaluated no further outside the picture than this share of half its
    /// size, because the affine approximation degrades there. That of a fisheye is exact everywhere.
    pub jacobian_margin: f64,
    /// Model: multiply each opacity by the ratio of the ellipse's area before and after `blur`, floor 0.005
    /// (Mip-Splatting, Yu et al. 2024, eq. 9).
    pub antialias: bool,
    /// Model: coefficients of the spherical harmonics above this degree, 0 to 4, are left out of a render and get a gradient of
    /// exactly zero. `None` uses all there are.
    pub sh_degree: Option<usize>,
    /// Model: what a pixel sees of a Gaussian, an affine approximation of the projection or the projection itself.
    pub projection: Projection,
    /// Model: what is sorted by depth, Gaussians for the whole picture or the contributions to each pixel.
    pub order: Order,
    /// Dial: contributions with alpha below this are skipped. Zero skips none, and lists every Gaussian in every tile: a render is
    /// then refused above [`MAX_UNCULLED_INTERSECTIONS`] pairs of the two.
    pub alpha_min: f64,
    /// Dial: alpha is at most this, so that every layer lets some light through.
    pub alpha_max: f64,
    /// Dial: the splat that would bring a pixel's transmittance to this or below, and all behind it, are left out.
    /// Zero leaves out none.
    pub transmittance_min: f64,
    /// Dial: how GPUs add the gradients of a Gaussian's intersections. CPU backends always add in order, and so do renders with another
    /// `projection` or `order` than the plain ones.
    pub accumulation: Accumulation,
    /// Dial: which tiles list a Gaussian. Changes time only.
    pub culling: Culling,
    /// Dial: how `exp` is computed in f32. Another `projection` or `order` than the plain one takes the library's.
    pub exponential: Exponential,
    /// Dial: how coefficients of spherical harmonics are stored where colours are computed from them. Ones of half precision are taken
    /// as they are; others are rounded in every render, at the cost of a pass over them, unless
    /// [`Colour::stored`](crate::Colour::stored) has done so once.
    pub coefficients: Storage,
    /// Output: also accumulate depth, `Σ wᵢ zᵢ`.
    pub depth: bool,
}

/// What a pixel sees of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Projection {
    /// Its projection linearised at its centre: an ellipse (EWA splatting, Zwicker et al. 2001). Good where a Gaussian is small
    /// beside its distance.
    #[default]
    Affine,
    /// The maximum of the Gaussian along the pixel's ray, exactly; see [`crate::rasterize_rays`]. For pinholes. Knows no
    /// [`RenderOptions::jacobian_margin`].
    RayMax,
}

/// What is sorted by depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Order {
    /// All Gaussians once, by the camera z of their centres. Two of them change places in all pixels at the same moment as a
    /// camera turns or moves, which shows as popping.
    #[default]
    CentreDepth,
    /// The contributions to each pixel, by the camera z of each Gaussian's maximum along the pixel's ray (Radl et al. 2024,
    /// StopThePop), equal ones by index. For pinholes.
    PerPixelSort,
}

/// How GPUs add the gradients of one Gaussian's intersections in many tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Accumulation {
    /// By atomic additions, in whatever order the device comes to them: the last digits differ from run to run.
    #[default]
    Atomic,
    /// One row per intersection, added in the order of the intersections: the same bits in every run, for memory in proportion to the intersections.
    Ordered,
}

/// The largest degree of spherical harmonics.
const MAX_SH_DEGREE: usize = 4;

/// The most pairs of a Gaussian and a tile that a render lists where `alpha_min` is zero: 2²⁶, 8,224 Gaussians in a picture of
/// 1920 × 1080 px. A CPU keeps 16 bytes of each pair in its lists and 36 for the gradients of three channels: 3.3 GiB for so many.
pub const MAX_UNCULLED_INTERSECTIONS: usize = 1 << 26;

impl RenderOptions {
    /// The thresholds of the original implementation and of gsplat: 8-bit contributions below one level are skipped
    /// (`alpha_min = 1/255`), every layer lets a hundredth through (`alpha_max = 0.99`), and what lies behind a transmittance of
    /// `transmittance_min = 1e-4` is left out. All other dials stand where a render is quickest without being less exact than the
    /// rounding of f32: atomic accumulation, [`Culling::Ellipse`], [`Exponential::Standard`], [`Storage::Full`].
    ///
    /// Error to expect: 50 dB against the exact render, 0.05 at the worst pixel, nearly all of it from `alpha_min`; gradients 14% off
    /// in relative L2 (cosine 0.991), those of the scales most. (These figures and those of the other presets: `fox_colmap`, 19,437
    /// Gaussians, 180 × 320 px, f32 on two CPU cores, in `docs/pareto/pareto.md`; `splat pareto` measures other scenes and devices.)
    pub const fn standard() -> Self {
        Self {
            blur: 0.3,
            near: 0.01,
            jacobian_margin: 0.3,
            antialias: false,
            projection: Projection::Affine,
            order: Order::CentreDepth,
            alpha_min: 1.0 / 255.0,
            alpha_max: 0.99,
            transmittance_min: 1e-4,
            sh_degree: None,
            accumulation: Accumulation::Atomic,
            culling: Culling::Ellipse,
            exponential: Exponential::Standard,
            coefficients: Storage::Full,
            depth: false,
        }
    }

    /// [`Self::standard`] with coarser cuts, for previews: `alpha_min` four times as large, so that a tile lists fewer Gaussians, and
    /// `transmittance_min = 1e-3`, so that a pixel is finished after fewer. Nothing else changes. (At 1e-2 a layer with an alpha of
    /// `alpha_max`, 0.99, would itself be left out: surfaces had holes.)
    ///
    /// Error to expect: 39 dB, 0.17 at the worst pixel; gradients 30% off (cosine 0.955). Saving over the standard: a sixth of a
    /// render and a fifth of a backward pass, too little there to be told from noise. Runs of 500 steps took 12% less time and lost
    /// 0.2 dB.
    pub const fn fast() -> Self {
        Self { alpha_min: 4.0 / 255.0, transmittance_min: 1e-3, ..Self::standard() }
    }

    /// [`Self::standard`] with finer cuts: nothing that 8-bit or 16-bit pictures could show is left out. `alpha_min = 2⁻²⁶`, and no
    /// pixel is ever finished (`transmittance_min = 0`). `alpha_max` stays, for it is part of what photographs were trained with;
    /// so do the dials that are within rounding.
    ///
    /// Error to expect: 93 dB, 0.007 at the worst pixel; gradients 0.06% off. Cost over the standard: 2.4 times the time of a render
    /// and of a backward pass, and twice the memory.
    pub const fn exact() -> Self {
        // 2⁻²⁶: a thousand such contributions stay below half a level of a 16-bit picture.
        Self { alpha_min: 1.0 / 67_108_864.0, transmittance_min: 0.0, ..Self::standard() }
    }

    /// With another blur, px².
    pub const fn with_blur(self, blur: f64) -> Self {
        Self { blur, ..self }
    }

    /// With another margin of the Jacobian, a share of half the picture's size.
    pub const fn with_jacobian_margin(self, jacobian_margin: f64) -> Self {
        Self { jacobian_margin, ..self }
    }

    /// With another alpha below which contributions are skipped.
    pub const fn with_alpha_min(self, alpha_min: f64) -> Self {
        Self { alpha_min, ..self }
    }

    /// With another largest alpha.
    pub const fn with_alpha_max(self, alpha_max: f64) -> Self {
        Self { alpha_max, ..self }
    }

    /// With another transmittance at which a pixel is finished.
    pub const fn with_transmittance_min(self, transmittance_min: f64) -> Self {
        Self { transmittance_min, ..self }
    }

    /// With or without accumulated depth.
    pub const fn with_depth(self, depth: bool) -> Self {
        Self { depth, ..self }
    }

    /// With another near plane, scene units.
    pub const fn with_near(self, near: f64) -> Self {
        Self { near, ..self }
    }

    /// With or without opacity compensation.
    pub const fn with_antialias(self, antialias: bool) -> Self {
        Self { antialias, ..self }
    }

    /// With another projection.
    pub const fn with_projection(self, projection: Projection) -> Self {
        Self { projection, ..self }
    }

    /// With another order.
    pub const fn with_order(self, order: Order) -> Self {
        Self { order, ..self }
    }

    /// With another way to add gradients on GPUs.
    pub const fn with_accumulation(self, accumulation: Accumulation) -> Self {
        Self { accumulation, ..self }
    }

    /// With no spherical harmonics above this degree; `None` for all there are.
    pub const fn with_sh_degree(self, sh_degree: Option<usize>) -> Self {
        Self { sh_degree, ..self }
    }

    /// With another choice of the tiles that list a Gaussian.
    pub const fn with_culling(self, culling: Culling) -> Self {
        Self { culling, ..self }
    }

    /// With another exponential.
    pub const fn with_exponential(self, exponential: Exponential) -> Self {
        Self { exponential, ..self }
    }

    /// With coefficients of spherical harmonics stored in another way.
    pub const fn with_coefficients(self, coefficients: Storage) -> Self {
        Self { coefficients, ..self }
    }

    /// Whether pixels look along their rays, in `depth_slope` and `rasterize_rays`, which take the place of `rasterize`.
    pub(crate) fn along_rays(&self) -> bool {
        self.projection != Projection::Affine || self.order != Order::CentreDepth
    }

    /// Whether how far a Gaussian reaches is that of its bounds, not of its ellipse.
    pub(crate) fn extends_by_bounds(&self) -> bool {
        self.projection == Projection::RayMax
    }

    /// As `project` takes them. The exact projection is right however far outside the picture a centre lies, so nothing is held
    /// there; a slope of 1e20 is one that no f32 render has.
    pub(crate) fn of_project(&self) -> Self {
        match self.projection {
            Projection::Affine => *self,
            Projection::RayMax => Self { jacobian_margin: 1e20, ..*self },
        }
    }

    pub(crate) fn check(&self) -> Result<(), SplatError> {
        let within = |field, value: f64, low: f64, high: f64, expected| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(SplatError::Value { field, found: value.to_string(), expected })
            }
        };
        within("blur", self.blur, 0.0, 1e6, "a variance from 0 to 1e6 px²")?;
        within("near", self.near, 0.0, 1e30, "a distance of at least 0")?;
        within("jacobian_margin", self.jacobian_margin, 0.0, 1e6, "a share of at least 0")?;
        if let Some(degree) = self.sh_degree.filter(|degree| *degree > MAX_SH_DEGREE) {
            let expected = "a degree from 0 to 4, or `None` for all coefficients there are";
            return Err(SplatError::Value { field: "sh_degree", found: degree.to_string(), expected });
        }
        within("alpha_min", self.alpha_min, 0.0, 1.0, "0 to 1")?;
        within("alpha_max", self.alpha_max, 0.0, 1.0, "0 to 1")?;
        within("transmittance_min", self.transmittance_min, 0.0, 1.0, "0 to 1")
    }

    /// Refuses to list every Gaussian in every tile where that is more than [`MAX_UNCULLED_INTERSECTIONS`].
    pub(crate) fn check_uncut(&self, gaussians: usize, tiles: usize) -> Result<(), SplatError> {
        let pairs = gaussians.saturating_mul(tiles);
        if self.alpha_min > 0.0 || pairs <= MAX_UNCULLED_INTERSECTIONS {
            return Ok(());
        }
        Err(SplatError::Value {
            field: "alpha_min",
            found: format!("0 for {gaussians} Gaussians in {tiles} tiles, {pairs} pairs"),
            expected: "a value above 0, so that Gaussians are listed only in the tiles they reach, or at most 67108864 \
                       pairs: use fewer Gaussians or render a smaller picture",
        })
    }
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self::standard()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_cut_there_is_a_most_of_pairs_and_the_message_names_it() {
        let uncut = RenderOptions { alpha_min: 0.0, ..RenderOptions::exact() };
        // A picture of 32,768 × 32,768 px.
        let tiles = 2048 * 2048;
        assert_eq!(uncut.check_uncut(16, tiles), Ok(()));
        let message = uncut.check_uncut(17, tiles).expect_err("one too many").to_string();
        for part in [
            "`alpha_min`",
            "17 Gaussians",
            "71303168 pairs",
            &MAX_UNCULLED_INTERSECTIONS.to_string(),
            "fewer Gaussians",
        ] {
            assert!(message.contains(part), "`{part}` is missing: {message}");
        }
        assert!(uncut.check_uncut(usize::MAX, 2).is_err(), "a product beyond all numbers");
        assert_eq!(RenderOptions::exact().check_uncut(usize::MAX, tiles), Ok(()), "with a cut the lists tell");
    }

    #[test]
    fn every_field_has_a_builder_that_sets_it_alone() {
        let built = RenderOptions::standard()
            .with_blur(0.1)
            .with_near(0.2)
            .with_jacobian_margin(0.4)
            .with_antialias(true)
            .with_sh_degree(Some(1))
            .with_projection(Projection::RayMax)
            .with_order(Order::PerPixelSort)
            .with_alpha_min(0.01)
            .with_alpha_max(0.9)
            .with_transmittance_min(0.02)
            .with_accumulation(Accumulation::Ordered)
            .with_culling(Culling::OpacityBox)
            .with_exponential(Exponential::Library)
            .with_coefficients(Storage::Half)
            .with_depth(true);
        let expected = RenderOptions {
            blur: 0.1,
            near: 0.2,
            jacobian_margin: 0.4,
            antialias: true,
            sh_degree: Some(1),
            projection: Projection::RayMax,
            order: Order::PerPixelSort,
            alpha_min: 0.01,
            alpha_max: 0.9,
            transmittance_min: 0.02,
            accumulation: Accumulation::Ordered,
            culling: Culling::OpacityBox,
            exponential: Exponential::Library,
            coefficients: Storage::Half,
            depth: true,
        };
        assert_eq!(built, expected);
    }

    #[test]
    fn presets_differ_in_their_cuts_alone() {
        let standard = RenderOptions::standard();
        for preset in [RenderOptions::fast(), RenderOptions::exact()] {
            assert_eq!(preset.check(), Ok(()));
            let RenderOptions { alpha_min, transmittance_min, .. } = preset;
            assert!(alpha_min != standard.alpha_min && transmittance_min != standard.transmittance_min);
            assert_eq!(RenderOptions { alpha_min, transmittance_min, ..standard }, preset);
        }
    }
}
