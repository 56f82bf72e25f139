//! A hard scene: Gaussians, a camera, options and a cotangent, on the host.

use splat_op::{Accumulation, Intrinsics, RenderOptions};

use crate::ceiling::rounded;
use crate::random::Random;

/// Without cuts, so that nothing jumps: what remains is arithmetic.
pub const SMOOTH: RenderOptions = RenderOptions {
    alpha_min: 0.0,
    transmittance_min: 0.0,
    // So that gradients on a GPU are the same bits in every run, and so is the table.
    accumulation: Accumulation::Ordered,
    ..RenderOptions::standard().with_depth(true)
};

/// The cuts of every implementation, and ours by default.
pub const STANDARD: RenderOptions =
    RenderOptions { alpha_min: RenderOptions::standard().alpha_min, transmittance_min: 1e-4, ..SMOOTH };

/// One Gaussian.
#[derive(Clone, Debug)]
pub struct Splat {
    /// Centre, world frame.
    pub mean: [f64; 3],
    /// Quaternion wxyz.
    pub quat: [f64; 4],
    /// Standard deviations; their logarithms in a scene with [`HardScene::stored`].
    pub scale: [f64; 3],
    /// 0 to 1; its logit in a scene with [`HardScene::stored`].
    pub opacity: f64,
    /// Features, or coefficients of spherical harmonics.
    pub colour: Vec<f64>,
}

/// What colours are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paint {
    /// Features as they are, this many.
    Features(usize),
    /// Spherical harmonics of this degree; the textbook has no column for these, as all compute them alike.
    Harmonics(usize),
}

/// What is true of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// The papers' formulas in 106 bits, checked against the exact renderer where float64 suffices for it.
    Wide,
    /// The CPU twin in f64: where decisions are judged, or there is too much for 106 bits.
    Twin,
}

/// A scene and what is expected of it.
#[derive(Clone, Debug)]
pub struct HardScene {
    /// Which of the case's scenes it is.
    pub label: String,
    pub means: Vec<f64>,
    pub quats: Vec<f64>,
    pub scales: Vec<f64>,
    pub opacities: Vec<f64>,
    pub colours: Vec<f64>,
    pub paint: Paint,
    pub background: Vec<f64>,
    /// Camera from world, `[3, 4]`.
    pub pose: Vec<f64>,
    pub intrinsics: Intrinsics,
    pub options: RenderOptions,
    /// The last rows are neighbours: beside the hard ones, without overlap, and not to be changed by them.
    pub neighbours: usize,
    /// Whether scales and opacities are logarithms and logits, as scenes are stored and trained.
    pub stored: bool,
    /// Whether camera z is held when inputs move: where the order in depth is the question.
    pub hold_depth: bool,
    /// Whether centres, camera and opacities are held too: where an alpha is at a threshold, and any move a jump.
    pub hold_alpha: bool,
    /// Rows that must be culled; all others must not.
    pub culled: Vec<usize>,
    pub truth: Truth,
    /// Random moves of the inputs by one ulp.
    pub draws: u64,
    /// Of the cotangent.
    pub seed: u64,
}

/// The loss is `Σ w·out` over image, alpha and depth.
#[derive(Clone, Debug)]
pub struct Weights {
    pub image: Vec<f64>,
    pub alpha: Vec<f64>,
    pub depth: Vec<f64>,
}

/// The camera at the origin that looks along z.
pub const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// An ordinary view, of no whole number of tiles.
pub fn camera() -> Intrinsics {
    Intrinsics { fx: 60.0, fy: 63.0, cx: 28.5, cy: 22.5, ..Intrinsics::centred(60, 44, 60.0) }
}

impl Splat {
    /// One with its centre at `px` of [`camera`] at a depth, its standard deviations near one in px: not equal, because a
    /// round one's rotation has no gradient.
    pub fn at(px: [f64; 2], depth: f64, sigma_px: f64) -> Self {
        Self::seen_by(&camera(), px, depth, sigma_px)
    }

    /// As [`Self::at`], on another camera's picture.
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
    /// Three channels, seen by [`camera`] from the origin, without cuts.
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
            options: SMOOTH,
            neighbours: 0,
            stored: false,
            hold_depth: false,
            hold_alpha: false,
            culled: Vec::new(),
            truth: Truth::Wide,
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

    /// With one more, which none before it reaches.
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

    pub fn with_truth(self, truth: Truth) -> Self {
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

    /// Colours are coefficients of spherical harmonics.
    pub fn with_harmonics(self, degree: usize) -> Self {
        Self { paint: Paint::Harmonics(degree), truth: Truth::Twin, ..self }
    }

    /// Scales are logarithms and opacities logits.
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

    /// Some of the Gaussians, none of them a neighbour.
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

    /// Numbers of a Gaussian's colour.
    pub fn colour_columns(&self) -> usize {
        match self.paint {
            Paint::Features(channels) => channels,
            Paint::Harmonics(degree) => 3 * (degree + 1) * (degree + 1),
        }
    }

    /// Channels of the image.
    pub fn channels(&self) -> usize {
        self.background.len()
    }

    /// The same with other numbers.
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
            intrinsics: Intrinsics { fx: lens[0], fy: lens[1], cx: lens[2], cy: lens[3], ..self.intrinsics },
            ..self.clone()
        }
    }

    /// What an f32 render really sees.
    pub fn rounded(&self) -> Self {
        let options = RenderOptions {
            blur: rounded(self.options.blur),
            near: rounded(self.options.near),
            alpha_min: rounded(self.options.alpha_min),
            alpha_max: rounded(self.options.alpha_max),
            transmittance_min: rounded(self.options.transmittance_min),
            ..self.options
        };
        Self { options, ..self.map(rounded) }
    }

    /// Every number one f32 ulp up or down, the blur too, but for what is zero or not finite: that it is so is a statement.
    pub fn moved(&self, random: &mut Random) -> Self {
        let options = RenderOptions { blur: moved(self.options.blur, random), ..self.options };
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

    /// The cotangent, the same in f32 and f64.
    pub fn weights(&self) -> Weights {
        let pixels = self.intrinsics.width * self.intrinsics.height;
        let mut random = Random::new(self.seed);
        let mut fill = |count| random.fill(count, -1.0, 1.0).into_iter().map(rounded).collect::<Vec<f64>>();
        Weights { image: fill(self.channels() * pixels), alpha: fill(pixels), depth: fill(pixels) }
    }
}

impl Weights {
    /// Each one ulp up or down; one of zero masks a pixel and stays.
    pub fn moved(&self, random: &mut Random) -> Self {
        let mut all = |values: &[f64]| values.iter().map(|v| moved(*v, random)).collect::<Vec<f64>>();
        Self { image: all(&self.image), alpha: all(&self.alpha), depth: all(&self.depth) }
    }

    /// Zero in the pixels that are not kept.
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
