//! Prediction of a run's memory, printed before it begins.

use splat_model::capture::Photograph;
use splat_model::trainer::TrainConfig;
use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Floats of a Gaussian besides its spherical harmonics: centre, rotation, scales, opacity.
const PLAIN: usize = 11;

/// Copies of a parameter at the peak: values and gradient, old and new while rows are edited, and one on the host.
const COPIES: usize = 5;

/// Copies of both moments at the peak: old and new while rows are edited.
const MOMENT_COPIES: usize = 2;

/// Bytes of a Gaussian in a render and its backward pass: its activated and projected values, and its intersections
/// with tiles.
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
            scene: splats * (COPIES * values + MOMENT_COPIES * moments + RENDERED),
            other: PROGRAM + PIXEL * largest,
        }
    }

    /// Returns the sum, bytes.
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
            let option = match self.scene > self.photographs {
                true => "--max-splats",
                false => "--cache-mb",
            };
            text += &format!(
                ". That is more than the {} that this machine has left: lower `{option}` first, then `--moment-bits`, `--max-side` or `--sh-degree`",
                gb(available)
            );
        }
        text
    }
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
mod tests {
    use glam::DAffine3;
    use splat_model::capture::Photo;
    use splat_model::optim::MomentBits;
    use splat_op::Intrinsics;

    use super::*;

    fn photo() -> Photo {
        let intrinsics = Intrinsics::centred(100, 50, 80.0);
        let (rgb, cam_from_world) = (vec![0; 3 * 5_000], DAffine3::IDENTITY);
        Photo { name: "a".into(), intrinsics, cam_from_world, rgb, alpha: None, mask: None }
    }

    #[test]
    fn a_budget_is_the_sum_of_what_is_there() {
        let kept = Photograph::from(photo());
        let let_go = Photograph::read_again(&photo(), || Ok(photo()));
        let config = TrainConfig { sh_degree: 0, cache_mib: 0, ..TrainConfig::default() };
        let budget = MemoryEstimate::of(&[kept.clone(), let_go], &[kept], &config, 10);
        assert_eq!(budget.photographs, 2 * 15_000);
        assert_eq!(budget.prepared, 0);
        assert_eq!(budget.scene, 10 * ((COPIES + 2 * MOMENT_COPIES) * 14 * 4 + RENDERED));
        let packed = TrainConfig { moment_bits: MomentBits::Eight, ..config.clone() };
        // Two bytes a number, in whole words.
        assert_eq!(
            MemoryEstimate::of(&[], &[], &packed, 10).scene,
            10 * (COPIES * 14 * 4 + MOMENT_COPIES * 36 + RENDERED)
        );
        let config = TrainConfig { sh_degree: 1, ..config };
        let more = MemoryEstimate::of(&[], &[], &config, 10).scene - budget.scene;
        assert_eq!(more, 10 * (COPIES + 2 * MOMENT_COPIES) * 9 * 4);
        assert_eq!(MemoryEstimate::of(&[], &[], &config, 0).total(), PROGRAM);
    }

    #[test]
    fn a_run_that_would_not_fit_says_so() {
        let budget = |photographs, scene| MemoryEstimate { photographs, prepared: 0, scene, other: 0 };
        let large = budget(1_000_000_000, 3_000_000_000);
        assert!(!large.said(7, None).contains("--") && !large.said(7, Some(5_000_000_000)).contains("--"));
        let said = large.said(7, Some(2_000_000_000));
        assert!(
            said.contains("about 1.0 GB, and 3.0 GB more")
                && said.contains("2.0 GB")
                && said.contains("`--max-splats`"),
            "{said}"
        );
        let said = budget(3_000_000_000, 1_000_000_000).said(7, Some(2_000_000_000));
        assert!(said.contains("`--cache-mb`"), "{said}");
    }

    #[test]
    fn half_of_what_is_left_is_for_photographs() {
        assert_eq!(cache(None, Some(10)), 5);
        assert_eq!(cache(Some(3), Some(10)), 3_000_000);
        assert!(cache(None, None) > 0 && available().is_none_or(|bytes| bytes > 1 << 20));
    }
}
