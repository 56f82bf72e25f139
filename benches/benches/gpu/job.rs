//! The three sizes: a scene on the host, the camera that sees it, and the photograph it is compared with.

use std::error::Error;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_benches::{LARGE, Load, MEDIUM, SyntheticView, share_apart, values};
use splat_model::capture::{Capture, Split, load_all};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, project, render, shade};

pub const OPTIONS: RenderOptions = RenderOptions::standard();

/// Steps on the CPU that give the real scene harmonics which are not zero.
const STEPS_OF_FOX: usize = 10;

/// Harmonics of degree 3.
pub const COEFFICIENTS: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    FoxSmall,
    Medium,
    Large,
}

impl Size {
    pub const ALL: [Self; 3] = [Self::FoxSmall, Self::Medium, Self::Large];
}

impl Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FoxSmall => "fox_small",
            Self::Medium => "medium",
            Self::Large => "large",
        })
    }
}

impl FromStr for Size {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|size| size.to_string() == text).ok_or(())
    }
}

/// One size, on the host.
pub struct Job {
    pub size: Size,
    pub rows: GaussianRows,
    pub intrinsics: Intrinsics,
    cam_from_world: DAffine3,
    /// `[H, W, 3]`, row-major, 0 to 1.
    photograph: Vec<f32>,
}

impl Job {
    pub fn new(size: Size) -> Result<Self, Box<dyn Error>> {
        match size {
            Size::FoxSmall => Self::fox_small(),
            Size::Medium => Ok(Self::synthetic(size, &MEDIUM)),
            Size::Large => Ok(Self::synthetic(size, &LARGE)),
        }
    }

    fn fox_small() -> Result<Self, Box<dyn Error>> {
        let standard = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
        let folder = std::env::var_os("SPLAT_DATA_DIR").map_or_else(|| PathBuf::from(standard), PathBuf::from);
        let capture = Capture::load(&folder.join("fox_small"))?;
        let split = Split::every(&capture.views, 8);
        let photos = load_all(split.train.iter().map(|view| &capture.views[*view]), None, |_| ())?;
        let photo = photos[0].clone();
        let device = Device::flex();
        let config = TrainConfig { sh_every: 0, ..TrainConfig::default() };
        let photograph = photo.rgb_over(config.background, &device);
        let mut trainer = Trainer::new(photos, &capture.points, config, &device)?;
        for _ in 0..STEPS_OF_FOX {
            trainer.step()?;
        }
        Ok(Self {
            size: Size::FoxSmall,
            rows: trainer.gaussians().to_rows(),
            intrinsics: photo.intrinsics,
            cam_from_world: photo.cam_from_world,
            photograph: floats(photograph),
        })
    }

    /// The photograph is the scene's picture, half as strong: a loss with a derivative everywhere.
    fn synthetic(size: Size, view: &SyntheticView) -> Self {
        let device = Device::flex();
        let scene = view.scene(&device, DType::F32);
        let camera = view.camera(&device, DType::F32);
        let Colour::SphericalHarmonics(sh) = &scene.colour else { unreachable!("the scene has harmonics") };
        let sh = floats(sh.clone());
        let coefficients = sh.as_chunks::<{ 3 * COEFFICIENTS }>().0;
        let rows = GaussianRows {
            means: rows_of(scene.means.clone()),
            rotations: rows_of(scene.rotations.clone()),
            log_scales: rows_of(scene.scales.clone().log()),
            logit_opacities: floats(scene.opacities.clone()).iter().map(|o| (o / (1.0 - o)).ln()).collect(),
            sh_dc: coefficients.iter().map(|row| [row[0], row[1], row[2]]).collect(),
            sh_rest: coefficients.iter().flat_map(|row| row[3..].iter().copied()).collect(),
            sh_degree: 3,
        };
        let picture = render(&scene, std::slice::from_ref(&camera), &Extras::default(), &OPTIONS);
        let photograph = floats(picture.expect("the scene's shapes fit").colour * 0.5);
        Self { size, rows, intrinsics: camera.intrinsics, cam_from_world: DAffine3::IDENTITY, photograph }
    }

    pub fn camera(&self, device: &Device) -> Camera {
        Camera::new(self.intrinsics, &self.cam_from_world, device)
    }

    pub fn gaussians(&self, device: &Device) -> Gaussians {
        Gaussians::from_rows(&self.rows, device).expect("rows of one scene")
    }

    /// `[H, W, 3]`.
    pub fn photograph(&self, device: &Device) -> Tensor<3> {
        let shape = [self.intrinsics.height, self.intrinsics.width, 3];
        Tensor::from_data(TensorData::new(self.photograph.clone(), shape), device)
    }

    /// Counts on the CPU, and for the synthetic scenes the assertion that they are what the figures are specified for.
    pub fn verify_load(&self) -> Load {
        let device = Device::flex();
        let load = Load::of(&self.gaussians(&device).splats(), &self.camera(&device), &OPTIONS);
        if self.size != Size::FoxSmall {
            assert!(load.visible_share() >= 0.8, "too few are visible: {load:?}");
            assert!(load.hits_per_visible() >= 4.0, "too few tiles: {load:?}");
            assert!(load.layers >= 40.0, "too few layers: {load:?}");
        }
        load
    }

    /// The device's picture is the CPU's but for pixels at a threshold.
    pub fn verify_picture(&self, device: &Device) -> Result<(), SplatError> {
        let picture = |device: &Device| -> Result<Vec<f64>, SplatError> {
            let (splats, camera) = (self.gaussians(device).splats(), self.camera(device));
            Ok(values(render(&splats, &[camera], &Extras::default(), &OPTIONS)?.colour))
        };
        let (found, expected) = (picture(device)?, picture(&Device::flex())?);
        let share = share_apart(&found, &expected, 1e-4);
        assert!(share < 2e-3, "{share} of the values differ from the CPU's");
        assert!(share_apart(&found, &expected, 2e-2) == 0.0, "values differ from the CPU's by more than a threshold");
        println!(
            "  picture: {share:.1e} of the values differ from the CPU's by more than 1e-4, none by more than 2e-2"
        );
        Ok(())
    }

    /// Asks the op whether the scene fits, by views of one row that take no memory themselves.
    pub fn check_fits(&self, device: &Device) -> Result<(), SplatError> {
        let count = self.rows.len();
        let row = |columns| Tensor::<2>::ones([1, columns], device).expand([count, columns]);
        let splats = Splats {
            means: row(3),
            rotations: row(4),
            scales: row(3),
            opacities: Tensor::<1>::zeros([1], device).expand([count]),
            colour: Colour::Features(row(3)),
        };
        let camera = self.camera(device);
        project(&splats, &camera, None, &OPTIONS)?;
        let sh = Tensor::<3>::zeros([1, COEFFICIENTS, 3], device).expand([count, COEFFICIENTS, 3]);
        shade(&sh, &splats.means, &camera).map(drop)
    }
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("the benches compute in f32")
}

fn rows_of<const C: usize>(tensor: Tensor<2>) -> Vec<[f32; C]> {
    floats(tensor).as_chunks::<C>().0.to_vec()
}
