//! Synthetic views from a fixed seed.

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::DAffine3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::{AdaptiveConfig, morton_order};
use splat_model::gaussians::GaussianRows;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, render};

use crate::values;

/// A cloud of Gaussians in front of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyntheticView {
    /// Number of Gaussians. A fifth of them lies outside the picture.
    pub splats: usize,
    /// Width of the picture, px.
    pub width: usize,
    /// Height of the picture, px.
    pub height: usize,
    /// Typical standard deviation in the picture, px. Those along a Gaussian's axes are 0.4 to 1.6 times as large.
    pub sigma_px: f64,
    /// Smallest and largest opacity of a uniform distribution.
    pub opacity: [f64; 2],
}

/// A scene small enough for valgrind, with nearly as many contributions per pixel as [`MEDIUM`].
pub const TINY: SyntheticView =
    SyntheticView { splats: 3_000, width: 150, height: 100, sigma_px: 3.05, opacity: [0.02, 0.7] };

/// A scene as large as `fox_small` after densification.
pub const SMALL: SyntheticView =
    SyntheticView { splats: 20_000, width: 270, height: 480, sigma_px: 3.6, opacity: [0.02, 0.6] };

/// A hundred thousand Gaussians at a quarter of full HD. Sizes and opacities of this view and of [`LARGE`] were adjusted until
/// [`crate::Load::verify`] passed by a small margin.
pub const MEDIUM: SyntheticView =
    SyntheticView { splats: 100_000, width: 960, height: 540, sigma_px: 3.05, opacity: [0.02, 0.7] };

/// [`MEDIUM`] at full HD.
pub const WIDE: SyntheticView = SyntheticView { width: 1920, height: 1080, sigma_px: 6.1, ..MEDIUM };

/// A million Gaussians at full HD. With four tiles each, they lie a hundred deep, and the nearer ones are opaque enough
/// to hide those beyond the first forty.
pub const LARGE: SyntheticView =
    SyntheticView { splats: 1_000_000, width: 1920, height: 1080, sigma_px: 2.65, opacity: [0.65, 0.99] };

/// Four million Gaussians of half the width of [`LARGE`]'s.
pub const HUGE: SyntheticView = SyntheticView { splats: 4_000_000, sigma_px: 1.325, ..LARGE };

impl SyntheticView {
    /// Creates the camera, at the origin, looking along +z.
    pub fn camera(&self, device: &Device, dtype: DType) -> Camera {
        let intrinsics = Intrinsics::centred(self.width, self.height, 0.9 * self.width.max(self.height) as f64);
        let camera = Camera::new(intrinsics, &DAffine3::IDENTITY, device);
        Camera { cam_from_world: camera.cam_from_world.cast(dtype), ..camera }
    }

    /// Creates the Gaussians, SH degree 3, with values rounded to f32 in any requested type.
    pub fn scene(&self, device: &Device, dtype: DType) -> Splats {
        let Drawn { means, rotations, scales, opacities, sh } = self.draw();
        let tensor = |values: Vec<f32>, shape: &[usize]| TensorData::new(values, shape.to_vec()).convert_dtype(dtype);
        let count = self.splats;
        Splats {
            means: Tensor::from_data(tensor(means, &[count, 3]), (device, dtype)),
            rotations: Tensor::from_data(tensor(rotations, &[count, 4]), (device, dtype)),
            scales: Tensor::from_data(tensor(scales, &[count, 3]), (device, dtype)),
            opacities: Tensor::from_data(tensor(opacities, &[count]), (device, dtype)),
            colour: Colour::SphericalHarmonics(Tensor::from_data(tensor(sh, &[count, 16, 3]), (device, dtype))),
        }
    }

    /// Returns the Gaussians in the representation of a trainer.
    pub fn rows(&self) -> GaussianRows {
        let Drawn { means, rotations, scales, opacities, sh } = self.draw();
        let coefficients = sh.as_chunks::<48>().0;
        GaussianRows {
            means: means.as_chunks().0.to_vec(),
            rotations: rotations.as_chunks().0.to_vec(),
            log_scales: scales.as_chunks().0.iter().map(|scales: &[f32; 3]| scales.map(f32::ln)).collect(),
            logit_opacities: opacities.iter().map(|o| (o / (1.0 - o)).ln()).collect(),
            sh_dc: coefficients.iter().map(|row| [row[0], row[1], row[2]]).collect(),
            sh_rest: coefficients.iter().flat_map(|row| row[3..].iter().copied()).collect(),
            sh_degree: 3,
            groups: Vec::new(),
        }
    }

    fn draw(&self) -> Drawn {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let focal = 0.9 * self.width.max(self.height) as f64;
        let mut drawn = Drawn::default();
        let [low, high] = self.opacity;
        for i in 0..self.splats {
            let depth = rng.random_range(2.0..8.0);
            let aside = if i % 5 == 0 { 3.0 } else { 0.0 };
            let x = (rng.random_range(-0.5..0.5) + aside) * self.width as f64 / focal * depth;
            let y = rng.random_range(-0.5..0.5) * self.height as f64 / focal * depth;
            drawn.means.extend([x, y, depth].map(|v| v as f32));
            let size = self.sigma_px * depth / focal;
            drawn.scales.extend([(); 3].map(|()| (size * rng.random_range(0.4..1.6)) as f32));
            drawn.rotations.extend([(); 4].map(|()| rng.random_range(-1.0_f64..1.0) as f32));
            drawn.opacities.push(rng.random_range(low..high) as f32);
            drawn.sh.extend([(); 48].map(|()| rng.random_range(-0.3_f64..0.3) as f32));
        }
        drawn.in_order()
    }

    /// Creates a training run on `views` photographs, all of them pictures of the scene, from its centres in grey, with all SH
    /// degrees in use from the start.
    ///
    /// # Panics
    /// If there are no views.
    pub fn trainer(&self, views: usize) -> Trainer {
        let device = Device::flex();
        let rgb: Vec<u8> =
            values(self.picture(&device, DType::F32)).iter().map(|v| (v * 255.0).round() as u8).collect();
        let intrinsics = self.camera(&device, DType::F32).intrinsics;
        let photo = |view| Photo {
            name: format!("view {view}"),
            intrinsics,
            cam_from_world: DAffine3::IDENTITY,
            rgb: rgb.clone(),
            alpha: None,
            mask: None,
        };
        let means = values(self.scene(&device, DType::F32).means);
        let positions: Vec<[f32; 3]> = means.as_chunks::<3>().0.iter().map(|mean| mean.map(|v| v as f32)).collect();
        let points = PointCloud { colours: vec![[128; 3]; positions.len()], positions };
        let density = AdaptiveConfig { max_splats: usize::MAX, ..AdaptiveConfig::default() };
        let config = TrainConfig { steps: 100_000, sh_every: 0, density: density.into(), ..TrainConfig::default() };
        let photos = (0..views).map(photo).collect();
        Trainer::new(photos, &points, config, &device).expect("photographs and steps are given")
    }

    /// Renders `[1, H, W, 3]` in the given float type.
    pub fn picture(&self, device: &Device, dtype: DType) -> Tensor<4> {
        let (scene, camera) = (self.scene(device, dtype), self.camera(device, dtype));
        let rendered = render(&scene, &[camera], &Extras::default(), &RenderOptions::standard());
        rendered.expect("the scene's shapes fit").colour
    }
}

/// Drawn parameters, row-major.
#[derive(Default)]
struct Drawn {
    means: Vec<f32>,
    rotations: Vec<f32>,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    sh: Vec<f32>,
}

impl Drawn {
    /// Returns the parameters in the order of a trainer.
    fn in_order(self) -> Self {
        let order = morton_order(self.means.as_chunks().0);
        let of = |values: Vec<f32>| {
            let width = values.len() / order.len();
            order.iter().flat_map(|&row| &values[row as usize * width..][..width]).copied().collect()
        };
        Self {
            rotations: of(self.rotations),
            scales: of(self.scales),
            opacities: of(self.opacities),
            sh: of(self.sh),
            means: of(self.means),
        }
    }
}
