//! Scenes by size: a scene on the host, its camera, and the photograph that it is compared with.

use std::error::Error;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::DAffine3;
use splat_model::capture::{Capture, Split, load_all};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, evaluate_sh, project, render};

use crate::limit::Sizes;
use crate::{HUGE, LARGE, Load, MEDIUM, SMALL, SyntheticView, TINY, WIDE, share_apart, values};

/// Options of all renders.
pub const OPTIONS: RenderOptions = RenderOptions::standard();

/// Training steps on the CPU that make the harmonics of the real scenes nonzero.
const STEPS_OF_FOX: usize = 10;

/// SH degree of all scenes.
const DEGREE: usize = 3;

/// Number of SH coefficients of that degree.
pub const COEFFICIENTS: usize = (DEGREE + 1) * (DEGREE + 1);

/// Name of a scene to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobSize {
    /// [`TINY`].
    Tiny,
    /// [`SMALL`].
    Small,
    /// The real capture `fox_small`, at a quarter of the photographs' width.
    FoxSmall,
    /// The real capture `fox_colmap`.
    FoxColmap,
    /// [`MEDIUM`].
    Medium,
    /// [`WIDE`].
    Wide,
    /// [`LARGE`].
    Large,
    /// [`HUGE`].
    Huge,
}

impl JobSize {
    pub const ALL: [Self; 8] =
        [Self::Tiny, Self::Small, Self::FoxSmall, Self::FoxColmap, Self::Medium, Self::Wide, Self::Large, Self::Huge];

    /// Returns the sizes named on the command line, or `standard` if there are none.
    ///
    /// # Errors
    /// The word that is not a size.
    pub fn from_arguments(standard: &[Self]) -> Result<Vec<Self>, String> {
        let known = || Self::ALL.map(|size| size.to_string()).join(", ");
        // Cargo passes `--bench`. Other words with hyphens are options of the bench.
        let words = std::env::args().skip(1).filter(|word| !word.starts_with("--"));
        let named: Result<Vec<Self>, String> =
            words.map(|word| word.parse().map_err(|()| format!("`{word}` is not one of {}", known()))).collect();
        named.map(|named| if named.is_empty() { standard.to_vec() } else { named })
    }

    /// Returns the sizes named on the command line, or `standard` if there are none, and the last word that is no size: a device's name.
    pub fn beside_a_device(standard: &[Self]) -> (Vec<Self>, Option<String>) {
        let (mut sizes, mut device) = (Vec::new(), None);
        // Cargo passes `--bench`.
        for word in std::env::args().skip(1).filter(|word| word != "--bench") {
            match word.parse() {
                Ok(size) => sizes.push(size),
                Err(()) => device = Some(word),
            }
        }
        (if sizes.is_empty() { standard.to_vec() } else { sizes }, device)
    }

    /// Returns the synthetic view; `None` for a real capture.
    pub fn view(self) -> Option<SyntheticView> {
        match self {
            Self::Tiny => Some(TINY),
            Self::Small => Some(SMALL),
            Self::Medium => Some(MEDIUM),
            Self::Wide => Some(WIDE),
            Self::Large => Some(LARGE),
            Self::Huge => Some(HUGE),
            Self::FoxSmall | Self::FoxColmap => None,
        }
    }
}

impl Display for JobSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In the order of the variants.
        f.write_str(["tiny", "small", "fox_small", "fox_colmap", "medium", "wide", "large", "huge"][*self as usize])
    }
}

impl FromStr for JobSize {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|size| size.to_string() == text).ok_or(())
    }
}

/// Scene, camera and photograph of one size, on the host.
pub struct Job {
    pub size: JobSize,
    pub rows: GaussianRows,
    pub intrinsics: Intrinsics,
    cam_from_world: DAffine3,
    /// `[H, W, 3]`, row-major, 0 to 1.
    photograph: Vec<f32>,
}

impl Job {
    /// Generates or loads the scene. Captures are in `SPLAT_DATA_DIR`, see `docs/CAPTURES.md`.
    ///
    /// # Errors
    /// If a capture cannot be read or trained on.
    pub fn new(size: JobSize) -> Result<Self, Box<dyn Error>> {
        match size.view() {
            Some(view) => Ok(Self::synthetic(size, &view)),
            None => Self::fox(size),
        }
    }

    fn fox(size: JobSize) -> Result<Self, Box<dyn Error>> {
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

    /// Creates a job whose photograph is the scene's picture at half the brightness, so that the loss has a derivative everywhere.
    fn synthetic(size: JobSize, view: &SyntheticView) -> Self {
        let device = Device::flex();
        let scene = view.scene(&device, DType::F32);
        let camera = view.camera(&device, DType::F32);
        let picture = render(&scene, std::slice::from_ref(&camera), &Extras::default(), &OPTIONS);
        let photograph = floats(picture.expect("the scene's shapes fit").colour * 0.5);
        Self { size, rows: view.rows(), intrinsics: camera.intrinsics, cam_from_world: DAffine3::IDENTITY, photograph }
    }

    /// Creates the camera on a device.
    pub fn camera(&self, device: &Device) -> Camera {
        Camera::new(self.intrinsics, &self.cam_from_world, device)
    }

    /// Creates the scene on a device, trainable if the device records gradients.
    pub fn gaussians(&self, device: &Device) -> Gaussians {
        Gaussians::from_rows(&self.rows, device).expect("rows of one scene")
    }

    /// Creates the photograph, `[H, W, 3]`.
    pub fn photograph(&self, device: &Device) -> Tensor<3> {
        let shape = [self.intrinsics.height, self.intrinsics.width, 3];
        Tensor::from_data(TensorData::new(self.photograph.clone(), shape), device)
    }

    /// Counts the load on the CPU, and for [`MEDIUM`] and [`LARGE`] asserts the load for which the figures are specified.
    pub fn verify_load(&self) -> Load {
        let device = Device::flex();
        let load = Load::of(&self.gaussians(&device).splats(), &self.camera(&device), &OPTIONS);
        if matches!(self.size, JobSize::Medium | JobSize::Large) {
            load.verify();
        }
        load
    }

    /// Returns the sizes of the passes' work.
    pub fn sizes(&self, load: &Load) -> Sizes {
        Sizes::new(load, &self.intrinsics, DEGREE)
    }

    /// Asserts that the device's picture equals the CPU's, except at pixels near a threshold.
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

    /// Checks whether the scene fits the device, with tensor views of one row that take no memory.
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
        evaluate_sh(&sh, &splats.means, &camera).map(drop)
    }
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("the benches compute in f32")
}
