//! What a render computes: model choices, numerical dials, and which outputs.

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
    /// Model: what a pixel sees of a Gaussian, an affine approximation of the projection or the projection itself.
    pub projection: Projection,
    /// Model: what is sorted by depth, Gaussians for the whole picture or the contributions to each pixel.
    pub order: Order,
    /// Dial: contributions with alpha below this are skipped. Zero skips none.
    pub alpha_min: f64,
    /// Dial: alpha is at most this, so that every layer lets some light through.
    pub alpha_max: f64,
    /// Dial: the splat that would bring a pixel's transmittance to this or below, and all behind it, are left out.
    /// Zero leaves out none.
    pub transmittance_min: f64,
    /// Dial: how GPUs add the gradients of a Gaussian's hits. CPU backends always add in order, and so do renders with another
    /// `projection` or `order` than the plain ones.
    pub accumulation: Accumulation,
    /// Output: also accumulate depth, `Σ wᵢ zᵢ`.
    pub depth: bool,
}

/// What a pixel sees of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Projection {
    /// Its projection linearised at its centre: an ellipse (EWA splatting, Zwicker et al. 2001). Good where a Gaussian is small
    /// beside its distance.
    #[default]
    Affine,
    /// The maximum of the Gaussian along the pixel's ray, exactly; see [`crate::rays`]. For pinholes. Knows no
    /// [`RenderOptions::jacobian_margin`].
    Exact,
}

/// What is sorted by depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Order {
    /// All Gaussians once, by the camera z of their centres. Two of them change places in all pixels at the same moment as a
    /// camera turns or moves, which shows as popping.
    #[default]
    Centre,
    /// The contributions to each pixel, by the camera z of each Gaussian's maximum along the pixel's ray (Radl et al. 2024,
    /// StopThePop), equal ones by index. For pinholes.
    PerPixel,
}

/// How GPUs add the gradients of one Gaussian's hits in many tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Accumulation {
    /// By atomic additions, in whatever order the device comes to them: the last digits differ from run to run.
    #[default]
    Atomic,
    /// One row per hit, added in the order of the hits: the same bits in every run, for memory in proportion to the hits.
    Ordered,
}

impl RenderOptions {
    /// The thresholds of the original implementation and of gsplat: 8-bit contributions below one level are skipped.
    pub const fn standard() -> Self {
        Self {
            blur: 0.3,
            near: 0.01,
            jacobian_margin: 0.3,
            antialias: false,
            projection: Projection::Affine,
            order: Order::Centre,
            alpha_min: 1.0 / 255.0,
            alpha_max: 0.99,
            transmittance_min: 1e-4,
            accumulation: Accumulation::Atomic,
            depth: false,
        }
    }

    /// Cuts four times coarser than [`Self::standard`]: fewer splats per tile and per pixel. For previews.
    pub const fn fast() -> Self {
        Self { alpha_min: 4.0 / 255.0, transmittance_min: 1e-2, ..Self::standard() }
    }

    /// Nothing that 8-bit or 16-bit pictures could show is left out.
    pub const fn exact() -> Self {
        // 2⁻²⁶: a thousand such contributions stay below half a level of a 16-bit picture.
        Self { alpha_min: 1.0 / 67_108_864.0, transmittance_min: 0.0, ..Self::standard() }
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

    /// Whether pixels look along their rays, in `tilt` and `rays`, which take the place of `blend`.
    pub(crate) fn along_rays(&self) -> bool {
        self.projection != Projection::Affine || self.order != Order::Centre
    }

    /// Whether how far a Gaussian reaches is that of its outline, not of its ellipse.
    pub(crate) fn reaches_by_outline(&self) -> bool {
        self.projection == Projection::Exact
    }

    /// As `project` takes them. The exact projection is right however far outside the picture a centre lies, so nothing is held
    /// there; a slope of 1e20 is one that no f32 render has.
    pub(crate) fn of_project(&self) -> Self {
        match self.projection {
            Projection::Affine => *self,
            Projection::Exact => Self { jacobian_margin: 1e20, ..*self },
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
        within("alpha_min", self.alpha_min, 0.0, 1.0, "0 to 1")?;
        within("alpha_max", self.alpha_max, 0.0, 1.0, "0 to 1")?;
        within("transmittance_min", self.transmittance_min, 0.0, 1.0, "0 to 1")
    }
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self::standard()
    }
}
