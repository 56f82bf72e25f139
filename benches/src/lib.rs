//! Scenes that the benches share, and what they verify before they time.

mod load;

pub use load::Load;

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::{DAffine3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, render};

/// A synthetic view: a cloud of Gaussians in front of one camera, from a fixed seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyntheticView {
    /// Gaussians.
    pub splats: usize,
    /// Width of the picture, px.
    pub width: usize,
    /// Height of the picture, px.
    pub height: usize,
}

/// As large as `fox_small` after densification.
pub const SMALL: SyntheticView = SyntheticView { splats: 20_000, width: 270, height: 480 };

/// A tenth of a million Gaussians at a quarter of full HD.
pub const MEDIUM: SyntheticView = SyntheticView { splats: 100_000, width: 960, height: 540 };

/// A million Gaussians at full HD.
pub const LARGE: SyntheticView = SyntheticView { splats: 1_000_000, width: 1920, height: 1080 };

/// Standard deviation on the picture below which a Gaussian, reaching some 2.5 times as far, lies in fewer than four tiles.
const SIGMA_OF_FOUR_TILES_PX: f64 = 3.6;

impl SyntheticView {
    /// The camera, at the origin, looking along +z.
    pub fn camera(&self, device: &Device, dtype: DType) -> Camera {
        let intrinsics = Intrinsics::centred(self.width, self.height, 0.9 * self.width.max(self.height) as f64);
        let camera = Camera::new(intrinsics, &DAffine3::IDENTITY, device);
        Camera { cam_from_world: camera.cam_from_world.cast(dtype), ..camera }
    }

    /// The Gaussians, SH degree 3, rounded to f32 whatever the type asked for. A fifth lies outside the picture; those
    /// inside are about as large as what four tiles each and some forty layers per pixel take.
    pub fn scene(&self, device: &Device, dtype: DType) -> Splats {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let focal = 0.9 * self.width.max(self.height) as f64;
        // Standard deviation on the picture at which the discs of all visible Gaussians cover it about 40 times, given
        // a reach of some 2.5 standard deviations; more if they would be in fewer than four tiles each.
        let pixels = (self.width * self.height) as f64;
        let sigma_px = (40.0 * pixels / (0.8 * self.splats as f64 * std::f64::consts::PI)).sqrt() / 2.5;
        let sigma_px = sigma_px.max(SIGMA_OF_FOUR_TILES_PX);
        let (mut means, mut scales, mut rotations, mut opacities, mut sh) = (vec![], vec![], vec![], vec![], vec![]);
        for i in 0..self.splats {
            let depth = rng.random_range(2.0..8.0);
            let aside = if i % 5 == 0 { 3.0 } else { 0.0 };
            let x = (rng.random_range(-0.5..0.5) + aside) * self.width as f64 / focal * depth;
            let y = rng.random_range(-0.5..0.5) * self.height as f64 / focal * depth;
            means.extend(DVec3::new(x, y, depth).to_array());
            let size = sigma_px * depth / focal;
            scales.extend([(); 3].map(|()| size * rng.random_range(0.4_f64..1.6)));
            rotations.extend([(); 4].map(|()| rng.random_range(-1.0..1.0)));
            opacities.push(rng.random_range(0.02..0.6));
            sh.extend([(); 48].map(|()| rng.random_range(-0.3..0.3)));
        }
        let tensor = |values: Vec<f64>, shape: &[usize]| {
            let rounded: Vec<f64> = values.into_iter().map(|value| f64::from(value as f32)).collect();
            TensorData::new(rounded, shape.to_vec()).convert_dtype(dtype)
        };
        let count = self.splats;
        Splats {
            means: Tensor::from_data(tensor(means, &[count, 3]), (device, dtype)),
            rotations: Tensor::from_data(tensor(rotations, &[count, 4]), (device, dtype)),
            scales: Tensor::from_data(tensor(scales, &[count, 3]), (device, dtype)),
            opacities: Tensor::from_data(tensor(opacities, &[count]), (device, dtype)),
            colour: Colour::SphericalHarmonics(Tensor::from_data(tensor(sh, &[count, 16, 3]), (device, dtype))),
        }
    }

    /// `[1, H, W, 3]` in the given float type.
    pub fn picture(&self, device: &Device, dtype: DType) -> Tensor<4> {
        let (scene, camera) = (self.scene(device, dtype), self.camera(device, dtype));
        let rendered = render(&scene, &[camera], &Extras::default(), &RenderOptions::standard());
        rendered.expect("the scene's shapes fit").colour
    }
}

/// All elements as f64, row-major.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().convert::<f64>().try_into_vec().expect("converted in this line")
}

/// The share of elements further than `tolerance` apart; NaN counts as far.
pub fn share_apart(found: &[f64], expected: &[f64], tolerance: f64) -> f64 {
    assert_eq!(found.len(), expected.len());
    let apart = found.iter().zip(expected).filter(|(a, b)| !((*a - *b).abs() <= tolerance)).count();
    apart as f64 / found.len() as f64
}
