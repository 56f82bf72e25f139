//! `--lpips`: a score by what a network sees, with weights from a file.

use std::path::PathBuf;

use anyhow::Result;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use splat_model::metrics::lpips::{Input, Lpips};

/// Whether LPIPS is measured.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct LpipsArgs {
    /// Measure LPIPS too, with the network whose weights this safetensors file holds: AlexNet or VGG16, as docs/METRICS.md has
    /// them exported. Without, LPIPS is reported as not measured
    #[arg(long, value_name = "WEIGHTS")]
    pub lpips: Option<PathBuf>,
    /// With `--lpips`: give the network pixels from 0 to 1 as they are, as the evaluation of the original 3D Gaussian splatting
    /// code does, for numbers to compare with papers; the network expects -1 to 1, which is what it is given without
    #[arg(long, requires = "lpips")]
    pub lpips_unscaled: bool,
}

impl LpipsArgs {
    /// The metric on a device; none if it was not asked for.
    ///
    /// # Errors
    /// If the weights cannot be read.
    pub fn read(&self, device: &Device) -> Result<Option<Lpips>> {
        let input = if self.lpips_unscaled { Input::Unscaled } else { Input::Scaled };
        Ok(self.lpips.as_deref().map(|path| Lpips::read(path, input, device)).transpose()?)
    }

    /// The same from whatever folder.
    pub fn from_anywhere(self) -> Self {
        Self { lpips: self.lpips.map(|path| std::path::absolute(&path).unwrap_or(path)), ..self }
    }
}
