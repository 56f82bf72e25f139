//! The sizes: a scene on the host, the camera that sees it, and the photograph it is compared with.

use std::error::Error;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_model::capture::{Capture, Split, load_all};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, project, render, shade};

use crate::limit::Sizes;
use crate::{LARGE, Load, MEDIUM, SMALL, SyntheticView, TINY, share_apart, values};

/// How everything is rendered.
pub const OPTIONS: RenderOptions = RenderOptions::standard();

/// Steps on the CPU that give the real scenes harmonics which are not zero.
const STEPS_OF_FOX: usize = 10;

/// Degree of all harmonics.
const DEGREE: usize = 3;

/// Harmonics of that degree.
pub const COEFFICIENTS: usize = (DEGREE + 1) * (DEGREE + 1);

/// A scene to measure on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// [`TINY`].
    Tiny,
    /// [`SMALL`].
    Small,
    /// The real capture of that name, a quarter of its width.
    FoxSmall,
    /// The real capture of that name.
    FoxColmap,
    /// [`MEDIUM`].
    Medium,
    /// [`LARGE`].
    Large,
}

impl Size {
    pub const ALL: [Self; 6] = [Self::Tiny, Self::Small, Self::FoxSmall, Self::FoxColmap, Self::Medium, Self::Large];

    /// The sizes named on the command line, else `standard`.
    ///
    /// # Errors
    /// The word that is no size.
    pub fn from_arguments(standard: &[Self]) -> Result<Vec<Self>, String> {
        let known = || Self::ALL.map(|size| size.to_string()).join(", ");
        // Cargo passes `--bench`; other words with hyphens are the bench's own.
        let words = std::env::args().skip(1).filter(|word| !word.starts_with("--"));
        let named: Result<Vec<Self>, String> =
            words.map(|word| word.parse().map_err(|()| format!("`{word}` is none of {}", known()))).collect();
        named.map(|named| if named.is_empty() { standard.to_vec() } else { named })
    }

    /// The synthetic view it is, if it is one.
    pub fn view(self) -> Option<SyntheticView> {
        match self {
            Self::Tiny => Some(TINY),
            Self::Small => Some(SMALL),
            Self::Medium => Some(MEDIUM),
            Self::Large => Some(LARGE),
            Self::FoxSmall | Self::FoxColmap => None,
        }
    }
}

impl Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tiny => "tiny",
            Self::Small => "small",
            Self::FoxSmall => "fox_small",
            Self::FoxColmap => "fox_colmap",
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
    /// Makes or loads the scene. Captures lie in `SPLAT_DATA_DIR`, see `docs/CAPTURES.md`.
    ///
    /// # Errors
    /// If a capture cannot be read or trained on.
    pub fn new(size: Size) -> Result<Self, Box<dyn Error>> {
        match size.view() {
            Some(view) => Ok(Self::synthetic(size, &view)),
            None => Self::fox(size),
        }
    }

    fn fox(size: Size) -> Result<Self, Box<dyn Error>> {
        let folder = std::env::var_os("SPLAT_DATA_DIR")
            .ok_or_else(|| format!("`{size}` is a real capture: set SPLAT_DATA_DIR as docs/CAPTURES.md says"))?;
        let capture = Capture::load(&PathBuf::from(folder).join(size.to_string()))?;
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
            size,
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
        let picture = render(&scene, std::slice::from_ref(&camera), &Extras::default(), &OPTIONS);
        let photograph = floats(picture.expect("the scene's shapes fit").colour * 0.5);
        Self { size, rows: view.rows(), intrinsics: camera.intrinsics, cam_from_world: DAffine3::IDENTITY, photograph }
    }

    /// The camera on a device.
    pub fn camera(&self, device: &Device) -> Camera {
        Camera::new(self.intrinsics, &self.cam_from_world, device)
    }

    /// The scene on a device; trainable if that is an autodiff device.
    pub fn gaussians(&self, device: &Device) -> Gaussians {
        Gaussians::from_rows(&self.rows, device).expect("rows of one scene")
    }

    /// `[H, W, 3]`.
    pub fn photograph(&self, device: &Device) -> Tensor<3> {
        let shape = [self.intrinsics.height, self.intrinsics.width, 3];
        Tensor::from_data(TensorData::new(self.photograph.clone(), shape), device)
    }

    /// Counts on the CPU, and for [`MEDIUM`] and [`LARGE`] the assertion that they are what the figures are specified for.
    pub fn verify_load(&self) -> Load {
        let device = Device::flex();
        let load = Load::of(&self.gaussians(&device).splats(), &self.camera(&device), &OPTIONS);
        if matches!(self.size, Size::Medium | Size::Large) {
            load.verify();
        }
        load
    }

    /// What the passes are asked to do.
    pub fn sizes(&self, load: &Load) -> Sizes {
        Sizes::new(load, &self.intrinsics, DEGREE)
    }

    /// The device's picture is the CPU's but for pixels at a threshold.
    ///
    /// # Errors
    /// If the op refuses the scene.
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
    ///
    /// # Errors
    /// What does not fit.
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
        project(&splats, &camera, &Extras::default(), &OPTIONS)?;
        let sh = Tensor::<3>::zeros([1, COEFFICIENTS, 3], device).expand([count, COEFFICIENTS, 3]);
        shade(&sh, &splats.means, &camera).map(drop)
    }
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("the benches compute in f32")
}
