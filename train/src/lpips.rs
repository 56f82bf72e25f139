//! `--lpips`: a perceptual score by a network whose weights are in a file.

use std::path::PathBuf;

use anyhow::Result;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use splat_model::metrics::lpips::Lpips;

/// Options of the LPIPS score.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct LpipsArgs {
    /// Also measure LPIPS, with the AlexNet or VGG16 weights in this safetensors file (export: docs/METRICS.md) [default: not measured]
    #[arg(long, value_name = "WEIGHTS")]
    pub lpips: Option<PathBuf>,
}

impl LpipsArgs {
    /// Returns the metric on a device; `None` if it was not asked for. An error if the weights cannot be read.
    pub fn read(&self, device: &Device) -> Result<Option<Lpips>> {
        Ok(self.lpips.as_deref().map(|path| Lpips::read(path, device)).transpose()?)
    }
}
