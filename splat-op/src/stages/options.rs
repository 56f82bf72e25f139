//! Options of a render: model choices, numerical dials and outputs.

use crate::check::check_value;
use crate::sh::SH_DEGREE_MAX;
use crate::{CameraModel, Intrinsics, Result};

/// Declares a struct of options. Each field has a builder, after its `=>`, that sets it.
macro_rules! with_builders {
    ($(#[$about:meta])* pub struct $name:ident {
        $($(#[$of_field:meta])* pub $field:ident: $type:ty => $builder:ident,)*
    }) => {
        $(#[$about])*
        pub struct $name {
            $($(#[$of_field])* pub $field: $type,)*
        }

        impl $name {$(
            #[doc = concat!("Sets [`", stringify!($field), "`](Self::", stringify!($field), ").")]
            pub const fn $builder(self, $field: $type) -> Self {
                Self { $field, ..self }
            }
        )*}
    };
}

with_builders! {
    /// Options of a render. Start from a preset and change fields with the builders `with_…`.
    ///
    /// *Model choices* define the function and are judged against photographs; *numerical dials* approximate that function
    /// and are judged against an exact render under the same choices. The two are never mixed.
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[non_exhaustive]
    pub struct RenderOptions {
        /// Model: variance added to both axes of every 2D ellipse, px². The default is about half a pixel wide, so that a splat much
        /// smaller than a pixel still covers one (Kerbl et al. 2023; EWA's low-pass filter).
        pub blur: f64 => with_blur,
        /// Model: near plane, scene units. Splats whose centre has a camera z of at most this are culled.
        pub near: f64 => with_near,
        /// Model: far plane, scene units. Splats whose centre has a camera z of this or more are culled. Infinite for none.
        pub far: f64 => with_far,
        /// Model: splats that reach at most this far from their centre along x and along y, three standard deviations, are culled. Zero for
        /// none; px. It saves time where a scene is seen from far away, and makes it darker.
        pub radius_clip: f64 => with_radius_clip,
        /// Model: margin around the picture, as a share of half its size, within which the Jacobian of the projection is evaluated. For
        /// centres farther out it is evaluated at the margin, because the affine approximation degrades there. The Jacobian of a
        /// fisheye is exact everywhere and is never clamped.
        pub jacobian_margin: f64 => with_jacobian_margin,
        /// Model: whether each opacity is multiplied by the ratio of the ellipse's area before and after `blur`, at least 0.005
        /// (Mip-Splatting, Yu et al. 2024, eq. 9).
        pub antialias: bool => with_antialias,
        /// Model: highest degree of the spherical harmonics that is used, 0 to 4. Coefficients above it have a gradient of exactly
        /// zero. `None` uses all degrees.
        pub sh_degree: Option<usize> => with_sh_degree,
        /// Model: value of a Gaussian at a pixel, by an affine approximation of the projection or by its maximum along the pixel's ray.
        pub projection: Projection => with_projection,
        /// Dial: contributions with an alpha below this are skipped. Zero skips none and lists every Gaussian in every tile; a render
        /// with more than [`MAX_UNCULLED_INTERSECTIONS`] pairs of a Gaussian and a tile is then refused.
        pub alpha_min: f64 => with_alpha_min,
        /// Dial: upper limit of the alpha of a contribution, so that every layer transmits some light.
        pub alpha_max: f64 => with_alpha_max,
        /// Dial: a pixel is finished before the splat that would bring its transmittance to this or below; that splat and all behind
        /// it are skipped. Zero skips none.
        pub transmittance_min: f64 => with_transmittance_min,
        /// Dial: how GPUs add the gradients of a Gaussian's intersections. CPU backends always add them in order.
        pub accumulation: Accumulation => with_accumulation,
        /// Dial: how long the lists of the Gaussians in each tile are on a GPU, and whether a render waits for their length.
        pub lists: ListLength => with_lists,
        /// Output: whether [`Rendered::depth`](crate::Rendered) is rendered.
        pub depth: bool => with_depth,
        /// Output: whether [`Rendered::expected_depth`](crate::Rendered) is computed.
        pub expected_depth: bool => with_expected_depth,
        /// Output: whether [`Rendered::normals`](crate::Rendered) are rendered, as three more channels.
        pub normals: bool => with_normals,
        /// Output: whether [`Rendered::radii`](crate::Rendered) are computed.
        pub radii: bool => with_radii,
        /// Output: whether [`Rendered::visible`](crate::Rendered) is computed.
        pub visible: bool => with_visible,
    }
}

/// The value of a Gaussian at a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Projection {
    /// Value of the ellipse that results from linearising the projection at the Gaussian's centre (EWA splatting, Zwicker et
    /// al. 2001). Accurate if the Gaussian is small compared with its distance.
    #[default]
    Affine,
    /// Exact maximum of the Gaussian along the pixel's ray; see [`crate::rasterize_rays`]. It ignores
    /// [`RenderOptions::jacobian_margin`]: the ellipse of a pinhole's centre beyond the picture is that at the picture's border. Through
    /// a lens, a pixel without a ray shows the background.
    RayMax,
}

/// The way in which GPUs add the gradients of one Gaussian's intersections with many tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Accumulation {
    /// Atomic additions in the order in which the device executes them: the last digits differ from run to run.
    #[default]
    Atomic,
    /// One row per intersection, added in the order of the intersections. The bits are the same in every run; the memory is
    /// proportional to the number of intersections.
    Ordered,
}

/// The length of the lists of the Gaussians in each tile, which depends on the view. CPU backends always count first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ListLength {
    /// As long as the view needs. Every render waits for the device to count.
    #[default]
    Counted,
    /// As long as recent views of as many tiles needed, with headroom. No render waits for the device, so that a program can queue whole
    /// steps. A view that needs longer lists lacks its farthest Gaussians, and [`truncated_views`](crate::truncated_views) counts it. With [`Accumulation::Ordered`], renders wait all the same.
    Expected,
}

/// Largest number of pairs of a Gaussian and a tile that a render with an `alpha_min` of zero lists: 2²⁶, which is 8,224
/// Gaussians in a picture of 1920 × 1080 px. A CPU stores 16 bytes per pair for its lists and 36 for the gradients of three
/// channels, together 3.3 GiB at this number.
pub const MAX_UNCULLED_INTERSECTIONS: usize = 1 << 26;

impl RenderOptions {
    /// Returns the default options, with the thresholds of the original implementation and of gsplat.
    ///
    /// Contributions below one level of 8 bits are skipped (`alpha_min = 1/255`), every layer transmits at least a hundredth
    /// (`alpha_max = 0.99`), and splats behind a transmittance of `transmittance_min = 1e-4` are skipped. All other dials have the
    /// fastest values whose error is within the rounding of f32: atomic accumulation.
    ///
    /// `docs/ACCURACY.md` has the error and the time of each preset.
    pub const fn standard() -> Self {
        Self {
            blur: 0.3,
            near: 0.01,
            far: f64::INFINITY,
            radius_clip: 0.0,
            jacobian_margin: 0.3,
            antialias: false,
            projection: Projection::Affine,
            alpha_min: 1.0 / 255.0,
            alpha_max: 0.99,
            transmittance_min: 1e-4,
            sh_degree: None,
            accumulation: Accumulation::Atomic,
            lists: ListLength::Counted,
            depth: false,
            expected_depth: false,
            normals: false,
            radii: false,
            visible: false,
        }
    }

    /// Returns options for previews: [`Self::standard`] with coarser thresholds.
    ///
    /// `alpha_min` is four times as large, so that a tile lists fewer Gaussians, and `transmittance_min` is 1e-3, so that a pixel is
    /// finished after fewer. It stays below `1 − alpha_max`, so that one layer is never skipped.
    pub const fn fast() -> Self {
        Self { alpha_min: 4.0 / 255.0, transmittance_min: 1e-3, ..Self::standard() }
    }

    /// Returns options for accurate renders: [`Self::standard`] with finer thresholds.
    ///
    /// `alpha_min` is 2⁻²⁶ and no pixel is finished early (`transmittance_min = 0`), so that nothing is skipped that an 8-bit or 16-bit
    /// picture could show. `alpha_max` is unchanged, because scenes were trained with it; so are the dials whose error is within rounding.
    pub const fn exact() -> Self {
        // 2⁻²⁶: a thousand such contributions stay below half a level of a 16-bit picture.
        Self { alpha_min: 1.0 / 67_108_864.0, transmittance_min: 0.0, ..Self::standard() }
    }

    /// Whether `intersect` waits for a GPU to count the intersections. Ordered sums are numbered by that count.
    #[cfg(feature = "cube")]
    pub(crate) fn counts_first(&self) -> bool {
        self.lists == ListLength::Counted || self.accumulation == Accumulation::Ordered
    }

    /// Whether Gaussians are seen along rays: by `ray_space` and the splat of `rasterize_rays`.
    pub(crate) fn along_rays(&self) -> bool {
        self.projection == Projection::RayMax
    }

    /// Options for `project`. `RayMax` is exact wherever the Jacobian is taken. A pinhole's is taken at the point of the picture
    /// next to the centre, whence `rasterize` evaluates the Gaussian: f32 loses all digits where it is taken far outside. A
    /// lens's is taken at the centre, however far outside that lies; no f32 render has a slope of 1e20.
    pub(crate) fn of_project(&self, camera: &Intrinsics) -> Self {
        match self.projection {
            Projection::Affine => *self,
            Projection::RayMax if camera.model == CameraModel::Pinhole => Self { jacobian_margin: 0.0, ..*self },
            Projection::RayMax => Self { jacobian_margin: 1e20, ..*self },
        }
    }

    /// Options for `rasterize`, whose planes include the depth that an output needs.
    pub(crate) fn of_rasterize(&self) -> Self {
        Self { depth: self.depth || self.expected_depth, ..*self }
    }

    pub(crate) fn check(&self) -> Result<()> {
        let within = |field, value: f64, low: f64, high: f64, expected| {
            check_value(field, value >= low && value <= high, value, expected)
        };
        within("blur", self.blur, 0.0, 1e6, "a variance from 0 to 1e6 px²")?;
        within("near", self.near, 0.0, 1e30, "a distance of at least 0")?;
        within("far", self.far, 0.0, f64::INFINITY, "a distance of at least 0")?;
        within("radius_clip", self.radius_clip, 0.0, 1e6, "a radius from 0 to 1e6 px")?;
        within("jacobian_margin", self.jacobian_margin, 0.0, 1e6, "a share of at least 0")?;
        let degree = self.sh_degree.unwrap_or_default();
        let expected = "a degree from 0 to 4, or `None` for all degrees";
        check_value("sh_degree", degree <= SH_DEGREE_MAX, degree, expected)?;
        within("alpha_min", self.alpha_min, 0.0, 1.0, "0 to 1")?;
        within("alpha_max", self.alpha_max, 0.0, 1.0, "0 to 1")?;
        within("transmittance_min", self.transmittance_min, 0.0, 1.0, "0 to 1")
    }

    /// Refuses to list every Gaussian in every tile if there are more than [`MAX_UNCULLED_INTERSECTIONS`] pairs.
    pub(crate) fn check_uncut(&self, gaussians: usize, tiles: usize) -> Result<()> {
        let pairs = gaussians.saturating_mul(tiles);
        let ok = self.alpha_min > 0.0 || pairs <= MAX_UNCULLED_INTERSECTIONS;
        let expected = "a value above 0, so that Gaussians are listed only in the tiles they reach, or at most 67108864 \
                        pairs: use fewer Gaussians or render a smaller picture";
        let found = format_args!("0 for {gaussians} Gaussians in {tiles} tiles, {pairs} pairs");
        check_value("alpha_min", ok, found, expected)
    }
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self::standard()
    }
}

#[cfg(test)]
mod tests;
