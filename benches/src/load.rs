//! Load that a scene puts on the stages, counted by plain code on the CPU.

use std::fmt::{self, Display};

use burn::tensor::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::{Camera, Extras, RenderOptions, Splats, intersect, project};

use crate::values;

/// Number of pixels whose layers are counted one by one: enough for a mean within a few hundredths.
const SAMPLED_PIXELS: usize = 256;

/// Load of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Gaussians.
    pub splats: usize,
    /// Number of Gaussians whose extent, the ellipse within which alpha is at least `alpha_min`, has a bounding box that meets
    /// the picture.
    pub visible: usize,
    /// Number of intersections, pairs of a tile and a Gaussian that `intersect` lists.
    pub intersections: usize,
    /// Number of Gaussians that contribute to a pixel by the rules of `rasterize`, the mean over `SAMPLED_PIXELS` random pixels.
    pub layers: f64,
}

impl Load {
    /// Counts the load. `splats` and `camera` must be on a CPU device.
    ///
    /// # Panics
    /// If the scene's shapes do not fit together.
    pub fn of(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Self {
        let projected = project(splats, camera, &Extras::default(), options).expect("the scene's shapes fit");
        let counts = intersect(&projected, options).expect("options are in range").counts;
        let columns = projected.ellipses();
        let column = |values_of: Tensor<1>| values(values_of);
        let (sigma_u, shear, sigma_v) = (column(columns.sigma_u), column(columns.shear), column(columns.sigma_v));
        let (depth, opacity) = (column(columns.depth), column(columns.opacity));
        let mean2d = values(columns.mean2d);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);

        let mut visible: Vec<ProjectedEllipse> = (0..opacity.len())
            .filter(|&i| opacity[i] >= options.alpha_min && opacity[i] > 0.0)
            .map(|i| ProjectedEllipse {
                x: mean2d[2 * i],
                y: mean2d[2 * i + 1],
                sigma_u: sigma_u[i],
                shear: shear[i],
                sigma_v: sigma_v[i],
                depth: depth[i],
                opacity: opacity[i],
                extent: (2.0 * (opacity[i] / options.alpha_min).ln()).sqrt(),
            })
            .filter(|ellipse| ellipse.meets(width as f64, height as f64))
            .collect();
        visible.sort_by(|a, b| a.depth.total_cmp(&b.depth));

        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut centre = |size: usize| rng.random_range(0..size) as f64 + 0.5;
        let layers: usize = (0..SAMPLED_PIXELS).map(|_| layers(&visible, centre(width), centre(height), options)).sum();
        Self {
            splats: opacity.len(),
            visible: visible.len(),
            intersections: values(counts.float()).iter().sum::<f64>() as usize,
            layers: layers as f64 / SAMPLED_PIXELS as f64,
        }
    }

    /// Returns the share of Gaussians that are visible.
    pub fn visible_share(&self) -> f64 {
        self.visible as f64 / self.splats as f64
    }

    /// Returns the number of tiles per visible Gaussian.
    pub fn intersections_per_visible(&self) -> f64 {
        self.intersections as f64 / self.visible as f64
    }

    /// Asserts the load for which the figures of the synthetic scenes are specified: at least, and hardly more than, 80% visible,
    /// 4 tiles per visible Gaussian and 40 contributions per pixel.
    ///
    /// # Panics
    /// If a count is out of its range.
    pub fn verify(&self) {
        assert!((0.8..0.85).contains(&self.visible_share()), "visible: {self:?}");
        assert!((4.0..4.5).contains(&self.intersections_per_visible()), "tiles per visible Gaussian: {self:?}");
        assert!((40.0..48.0).contains(&self.layers), "contributions per pixel: {self:?}");
    }
}

impl Display for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { splats, visible, intersections, layers } = self;
        let (share, tiles) = (100.0 * self.visible_share(), self.intersections_per_visible());
        write!(
            f,
            "{splats} Gaussians, {visible} visible ({share:.1}%), {intersections} intersections ({tiles:.2} per visible), "
        )?;
        write!(f, "{layers:.1} contributions per pixel")
    }
}

/// A projected Gaussian; see `splat_op::Ellipses`.
struct ProjectedEllipse {
    x: f64,
    y: f64,
    sigma_u: f64,
    shear: f64,
    sigma_v: f64,
    depth: f64,
    opacity: f64,
    /// Extent in standard deviations.
    extent: f64,
}

impl ProjectedEllipse {
    fn meets(&self, width: f64, height: f64) -> bool {
        let half_x = self.extent * self.sigma_u;
        let half_y = self.extent * (self.shear * self.sigma_u).hypot(self.sigma_v);
        self.x + half_x > 0.0 && self.x - half_x < width && self.y + half_y > 0.0 && self.y - half_y < height
    }
}

/// Counts the contributions to one pixel, front to back.
fn layers(visible: &[ProjectedEllipse], x: f64, y: f64, options: &RenderOptions) -> usize {
    let (mut count, mut transmittance) = (0, 1.0);
    for ellipse in visible {
        let u = (x - ellipse.x) / ellipse.sigma_u;
        if u.abs() > ellipse.extent {
            continue;
        }
        let v = (y - ellipse.y - ellipse.shear * (x - ellipse.x)) / ellipse.sigma_v;
        let alpha = (ellipse.opacity * (-0.5 * (u * u + v * v)).exp()).min(options.alpha_max);
        if alpha < options.alpha_min {
            continue;
        }
        let behind = transmittance * (1.0 - alpha);
        if behind <= options.transmittance_min {
            break;
        }
        transmittance = behind;
        count += 1;
    }
    count
}
