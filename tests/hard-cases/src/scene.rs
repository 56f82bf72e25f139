//! A hard scene: Gaussians, a camera, options and the weights of the loss, on the host.

use splat_op::{Accumulation, Intrinsics, RenderOptions};

use crate::ceiling::rounded;
use crate::random::Random;

/// Options without cuts: the render is continuous, and arithmetic is the only source of error.
pub const SMOOTH: RenderOptions = RenderOptions::standard()
    .with_depth(true)
    .with_alpha_min(0.0)
    .with_transmittance_min(0.0)
    // Gradients on a GPU, and therefore the table, have the same bits in every run.
    .with_accumulation(Accumulation::Ordered);

/// Options with the cuts that every implementation makes and that are the default here.
pub const STANDARD: RenderOptions =
    SMOOTH.with_alpha_min(RenderOptions::standard().alpha_min).with_transmittance_min(1e-4);

/// One Gaussian.
#[derive(Clone, Debug)]
pub struct Splat {
    /// Centre, world frame.
    pub mean: [f64; 3],
    /// Quaternion wxyz.
    pub quat: [f64; 4],
    /// Standard deviations along the axes; their logarithms in a scene with [`HardScene::stored`].
    pub scale: [f64; 3],
    /// Opacity, 0 to 1; its logit in a scene with [`HardScene::stored`].
    pub opacity: f64,
    /// Features, or coefficients of spherical harmonics.
    pub colour: Vec<f64>,
}

/// Representation of colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paint {
    /// This number of features, used as they are.
    Features(usize),
    /// Spherical harmonics of this degree. The textbook has no column for them, because all implementations compute them alike.
    Harmonics(usize),
}

/// Source of a scene's reference values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TruthSource {
    /// The papers' formulas in 106 bits, checked against the exact renderer where float64 suffices for that renderer.
    Wide,
    /// The CPU twin in f64, for decisions at thresholds and for scenes too large for 106-bit arithmetic.
    Twin,
}

/// A scene and the expectations on its render.
#[derive(Clone, Debug)]
pub struct HardScene {
    /// Name of the scene within its case.
    pub label: String,
    pub means: Vec<f64>,
    pub quats: Vec<f64>,
    pub scales: Vec<f64>,
    pub opacities: Vec<f64>,
    pub colours: Vec<f64>,
    pub paint: Paint,
    pub background: Vec<f64>,
    /// Pose, camera from world, `[3, 4]`.
    pub pose: Vec<f64>,
    pub intrinsics: Intrinsics,
    /// Whether the picture is a panorama; of the intrinsics, only its size counts then.
    pub panorama: bool,
    pub options: RenderOptions,
    /// Number of neighbours, the last rows. They lie beside the hard Gaussians without overlap and must not be changed by them.
    pub neighbours: usize,
    /// Whether scales and opacities are logarithms and logits, as scenes are stored and trained.
    pub stored: bool,
    /// Whether camera z stays fixed when inputs move, for cases that test the order in depth.
    pub hold_depth: bool,
    /// Whether centres, camera and opacities stay fixed too, for cases with an alpha at a threshold, where any move is a jump.
    pub hold_alpha: bool,
    /// Rows that must be culled. No other row may be culled.
    pub culled: Vec<usize>,
    pub truth: TruthSource,
    /// Number of random moves of the inputs by one ulp.
    pub draws: u64,
    /// Seed of the weights of the loss.
    pub seed: u64,
}

/// Weights of the loss `Σ w·out` over image, alpha and depth.
#[derive(Clone, Debug)]
pub struct OutputWeights {
    pub image: Vec<f64>,
    pub alpha: Vec<f64>,
    pub depth: Vec<f64>,
}

/// The camera at the origin that looks along z.
pub const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// An ordinary view whose size is not a multiple of the tile size.
pub fn camera() -> Intrinsics {
    Intrinsics::pinhole(60, 44, [60.0, 63.0], [28.5, 22.5])
}

impl Splat {
    /// Creates a Gaussian with its centre at `px` of [`camera`] and standard deviations near `sigma_px`. They differ, because
    /// the rotation of a round Gaussian has no gradient.
    pub fn at(px: [f64; 2], depth: f64, sigma_px: f64) -> Self {
        Self::seen_by(&camera(), px, depth, sigma_px)
    }

    /// Creates a Gaussian as [`Self::at`] does, on another camera's picture.
    pub fn seen_by(lens: &Intrinsics, px: [f64; 2], depth: f64, sigma_px: f64) -> Self {
        Self {
            mean: [(px[0] - lens.cx) / lens.fx * depth, (px[1] - lens.cy) / lens.fy * depth, depth],
            quat: [0.9, 0.2, -0.3, 0.25],
            scale: [1.0, 0.8, 1.25].map(|s| s * sigma_px * depth / lens.fx),
            opacity: 0.7,
            colour: vec![0.9, 0.4, 0.2],
        }
    }

    pub fn mean(self, mean: [f64; 3]) -> Self {
        Self { mean, ..self }
    }

    pub fn scale(self, scale: [f64; 3]) -> Self {
        Self { scale, ..self }
    }

    pub fn quat(self, quat: [f64; 4]) -> Self {
        Self { quat, ..self }
    }

    pub fn opacity(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    pub fn colour(self, colour: &[f64]) -> Self {
        Self { colour: colour.to_vec(), ..self }
    }
}

impl HardScene {
    /// Creates a scene of three channels with [`camera`] at the origin, without cuts.
    pub fn new(label: impl Into<String>, splats: &[Splat]) -> Self {
        let mut scene = Self {
            label: label.into(),
            means: Vec::new(),
            quats: Vec::new(),
            scales: Vec::new(),
            opacities: Vec::new(),
            colours: Vec::new(),
            paint: Paint::Features(3),
            background: vec![0.1, 0.2, 0.3],
            pose: IDENTITY.to_vec(),
            intrinsics: camera(),
            panorama: false,
            options: SMOOTH,
            neighbours: 0,
            stored: false,
            hold_depth: false,
            hold_alpha: false,
            culled: Vec::new(),
            truth: TruthSource::Wide,
            draws: 8,
            seed: 1,
        };
        splats.iter().for_each(|splat| scene.push(splat));
        scene
    }

    fn push(&mut self, splat: &Splat) {
        self.means.extend(splat.mean);
        self.quats.extend(splat.quat);
        self.scales.extend(splat.scale);
        self.opacities.push(splat.opacity);
        self.colours.extend(&splat.colour);
    }

    /// Adds a neighbour, which no Gaussian before it overlaps.
    pub fn with_neighbour(mut self, splat: &Splat) -> Self {
        self.push(splat);
        self.neighbours += 1;
        self
    }

    pub fn with_options(self, options: RenderOptions) -> Self {
        Self { options, ..self }
    }

    pub fn with_camera(self, intrinsics: Intrinsics) -> Self {
        Self { intrinsics, ..self }
    }

    /// Declares the picture a panorama of `width` × `height` px.
    pub fn as_panorama(self, width: usize, height: usize) -> Self {
        let intrinsics = Intrinsics::centred(width, height, 1.0);
        Self { intrinsics, panorama: true, truth: TruthSource::Twin, ..self }
    }

    pub fn with_truth(self, truth: TruthSource) -> Self {
        Self { truth, ..self }
    }

    pub fn with_culled(self, culled: &[usize]) -> Self {
        Self { culled: culled.to_vec(), ..self }
    }

    pub fn with_background(self, background: &[f64]) -> Self {
        Self { background: background.to_vec(), ..self }
    }

    pub fn with_draws(self, draws: u64) -> Self {
        Self { draws, ..self }
    }

    /// Declares colours to be coefficients of spherical harmonics.
    pub fn with_harmonics(self, degree: usize) -> Self {
        Self { paint: Paint::Harmonics(degree), truth: TruthSource::Twin, ..self }
    }

    /// Declares scales to be logarithms and opacities logits.
    pub fn stored(self) -> Self {
        Self { stored: true, ..self }
    }

    pub fn holding_alpha(self) -> Self {
        Self { hold_alpha: true, ..self }
    }

    pub fn holding_depth(self) -> Self {
        Self { hold_depth: true, ..self }
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.opacities.len()
    }

    /// Returns the scene with some of the Gaussians, none of them a neighbour.
    pub fn rows(&self, rows: std::ops::Range<usize>) -> Self {
        let of = |values: &[f64], columns: usize| values[columns * rows.start..columns * rows.end].to_vec();
        Self {
            means: of(&self.means, 3),
            quats: of(&self.quats, 4),
            scales: of(&self.scales, 3),
            opacities: of(&self.opacities, 1),
            colours: of(&self.colours, self.colour_columns()),
            neighbours: 0,
            ..self.clone()
        }
    }

    /// Number of values of a Gaussian's colour.
    pub fn colour_columns(&self) -> usize {
        match self.paint {
            Paint::Features(channels) => channels,
            Paint::Harmonics(degree) => 3 * (degree + 1) * (degree + 1),
        }
    }

    /// Number of channels of the image.
    pub fn channels(&self) -> usize {
        self.background.len()
    }

    /// Applies a function to every number of the scene.
    fn map(&self, mut map: impl FnMut(f64) -> f64) -> Self {
        let mut all = |values: &[f64]| values.iter().map(|v| map(*v)).collect::<Vec<f64>>();
        let lens = &self.intrinsics;
        let lens = all(&[lens.fx, lens.fy, lens.cx, lens.cy]);
        Self {
            means: all(&self.means),
            quats: all(&self.quats),
            scales: all(&self.scales),
            opacities: all(&self.opacities),
            colours: all(&self.colours),
            background: all(&self.background),
            pose: all(&self.pose),
            intrinsics: self.intrinsics.with_focal(lens[0], lens[1]).with_principal_point(lens[2], lens[3]),
            ..self.clone()
        }
    }

    /// Rounds every number to f32, as an f32 render receives it.
    pub fn rounded(&self) -> Self {
        let options = self
            .options
            .with_blur(rounded(self.options.blur))
            .with_near(rounded(self.options.near))
            .with_alpha_min(rounded(self.options.alpha_min))
            .with_alpha_max(rounded(self.options.alpha_max))
            .with_transmittance_min(rounded(self.options.transmittance_min));
        Self { options, ..self.map(rounded) }
    }

    /// Moves every number, the blur too, by one f32 ulp. Values that are zero or not finite are intended to be so and stay.
    pub fn moved(&self, random: &mut Random) -> Self {
        let options = self.options.with_blur(moved(self.options.blur, random));
        let mut moved = Self { options, ..self.map(|value| moved(value, random)) };
        if self.hold_alpha {
            moved.means.clone_from(&self.means);
            moved.opacities.clone_from(&self.opacities);
            moved.pose.clone_from(&self.pose);
            moved.intrinsics = self.intrinsics;
        }
        if self.hold_depth {
            (2..moved.means.len()).step_by(3).for_each(|z| moved.means[z] = self.means[z]);
            moved.pose[8..].copy_from_slice(&self.pose[8..]);
        }
        moved
    }

    /// Weights of the loss, equal in f32 and f64.
    pub fn weights(&self) -> OutputWeights {
        let pixels = self.intrinsics.width * self.intrinsics.height;
        let mut random = Random::new(self.seed);
        let mut fill = |count| random.fill(count, -1.0, 1.0).into_iter().map(rounded).collect::<Vec<f64>>();
        OutputWeights { image: fill(self.channels() * pixels), alpha: fill(pixels), depth: fill(pixels) }
    }
}

impl OutputWeights {
    /// Moves every weight by one ulp. A weight of zero masks a pixel and stays.
    pub fn moved(&self, random: &mut Random) -> Self {
        let mut all = |values: &[f64]| values.iter().map(|v| moved(*v, random)).collect::<Vec<f64>>();
        Self { image: all(&self.image), alpha: all(&self.alpha), depth: all(&self.depth) }
    }

    /// Sets the weights of pixels that are not kept to zero.
    pub fn mask(&mut self, kept: &[bool]) {
        let channels = self.image.len() / kept.len().max(1);
        for (pixel, _) in kept.iter().enumerate().filter(|(_, kept)| !**kept) {
            self.image[channels * pixel..channels * (pixel + 1)].fill(0.0);
            (self.alpha[pixel], self.depth[pixel]) = (0.0, 0.0);
        }
    }
}

fn moved(value: f64, random: &mut Random) -> f64 {
    if value == 0.0 || !value.is_finite() { value } else { crate::ceiling::moved_value(value, random) }
}
