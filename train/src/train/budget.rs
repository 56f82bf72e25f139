//! Prediction of a run's memory, printed before it begins.

use splat_model::capture::Photograph;
use splat_model::trainer::TrainConfig;
use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Floats of a Gaussian besides its spherical harmonics: centre, rotation, scales, opacity.
const PLAIN: usize = 11;

/// Copies of a parameter besides the render's memory: values and gradient. While rows are chosen, a copy on the host takes the place of the
/// gradient.
const COPIES: usize = 2;

/// Bytes of a Gaussian in a render and its backward pass: its activated and projected values, and its intersections
/// with tiles. While rows are edited, the old and the new values of one parameter at a time take their place.
const RENDERED: usize = 400;

/// Bytes of a pixel in a render, its loss and its backward pass.
const PIXEL: usize = 200;

/// Bytes of the program, its kernels and its threads.
const PROGRAM: usize = 100 << 20;

/// Bytes of a pixel of a photograph prepared for the loss.
const PREPARED: usize = 36;

/// Predicted memory, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// Decoded photographs that stay in memory.
    pub photographs: usize,
    /// Photographs prepared for the loss.
    pub prepared: usize,
    /// The Gaussians with their training state.
    pub scene: usize,
    /// Everything else.
    pub other: usize,
}

impl MemoryEstimate {
    /// Predicts the memory of a run over these photographs with `splats` Gaussians.
    pub fn of(train: &[Photograph], test: &[Photograph], config: &TrainConfig, splats: usize) -> Self {
        let pixels = |photo: &Photograph| photo.intrinsics.width * photo.intrinsics.height;
        let kept = train.iter().chain(test).filter(|photo| photo.is_kept());
        let all_prepared: usize = train.iter().map(|photo| PREPARED * pixels(photo)).sum();
        let largest = train.iter().chain(test).map(pixels).max().unwrap_or(0);
        let of_sh = 3 * (config.sh_degree + 1) * (config.sh_degree + 1);
        let moments = [3, 4, 3, 1, of_sh].map(|width| config.moment_bits.bytes(width)).iter().sum::<usize>();
        let values = (PLAIN + of_sh) * size_of::<f32>();
        Self {
            photographs: kept.map(Photograph::bytes).sum(),
            prepared: all_prepared.min(config.cache_mib << 20),
            scene: splats * (copies(config) * values + moments + values.max(RENDERED)),
            other: PROGRAM + PIXEL * largest,
        }
    }

    /// Adds the groups of a program's own, with these numbers in a row, of `splats` Gaussians.
    pub fn with_groups(mut self, widths: impl Iterator<Item = usize>, config: &TrainConfig, splats: usize) -> Self {
        let of_row = |width| copies(config) * width * size_of::<f32>() + config.moment_bits.bytes(width);
        self.scene += splats * widths.map(of_row).sum::<usize>();
        self
    }

    pub fn total(self) -> usize {
        self.photographs + self.prepared + self.scene + self.other
    }

    /// Formats the prediction for at most `splats` Gaussians, with advice if it exceeds the available memory.
    pub fn said(self, splats: usize, available: Option<usize>) -> String {
        let gb = |bytes: usize| format!("{:.1} GB", bytes as f64 / 1e9);
        let mut text = format!(
            "memory: about {}, and {} more should there be {splats} splats",
            gb(self.total() - self.scene),
            gb(self.scene)
        );
        if let Some(available) = available.filter(|available| *available < self.total()) {
            let option = if self.scene > self.photographs { "--max-splats" } else { "--cache-mb" };
            text += &format!(
                ". That is more than the {} that this machine has left: lower `{option}` first, then `--moment-bits`, `--max-side` or `--sh-degree`",
                gb(available)
            );
        }
        text
    }
}

/// Copies of a parameter, of which one is the sum of a batch's gradients beside those of a view.
fn copies(config: &TrainConfig) -> usize {
    COPIES + usize::from(config.batch > 1)
}

/// Returns the memory that programs can still take, bytes, where the system reports it.
pub fn available() -> Option<usize> {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let bytes = System::new_with_specifics(memory).available_memory();
    usize::try_from(bytes).ok().filter(|bytes| *bytes > 0)
}

/// Returns the memory for decoded photographs, bytes: the amount asked for, or half of what is available.
pub fn cache(asked_mb: Option<usize>, available: Option<usize>) -> usize {
    let asked = asked_mb.map(|mb| mb.saturating_mul(1_000_000));
    // The memory of a small machine, where the available memory is unknown.
    asked.unwrap_or_else(|| available.map_or(2_000_000_000, |bytes| bytes / 2))
}

#[cfg(test)]
mod tests;
