//! Cases of `splat effects`: a demo capture that shows one effect, and two runs on it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Parser;
use splat_demo::DemoOptions;
use splat_model::capture::{Capture, write_binary_with_tracks};
use splat_model::effects::{EffectKind, Plan, Survey};
use splat_op::{CameraModel, Intrinsics};

use crate::options::{Cli, Command};
use crate::report::metrics::Metrics;
use crate::report::{BACKGROUND, SCENE};
use crate::{demo, eval, train};

/// Picture sizes and lengths of runs.
#[derive(Clone, Copy, Debug)]
pub struct RunSize {
    /// Width of the pictures, px; the height is three quarters of it.
    pub width: usize,
    /// Number of photographs, unless the case sets its own.
    pub views: usize,
    /// Steps of each run.
    pub steps: usize,
}

impl RunSize {
    /// The scale of published figures.
    pub const FULL: Self = Self { width: 160, views: 40, steps: 1500 };
    /// The scale of tests.
    pub const QUICK: Self = Self { width: 96, views: 24, steps: 300 };
}

/// A case about one effect.
#[derive(Clone, Copy, Debug)]
pub struct EffectCase {
    /// Name, as in `--case`.
    pub name: &'static str,
    /// Options of the demo capture, at any size.
    pub demo: fn(DemoOptions) -> DemoOptions,
    /// The same options on the command line.
    pub demo_flags: &'static str,
    /// Effects that the plan must switch on.
    pub expected: &'static [EffectKind],
    /// Whether the plan must find view-dependent colours. `None` where other faults of the photographs make colours vary
    /// too, so that the plan may keep the harmonics.
    pub harmonics: Option<bool>,
    /// Options of both runs.
    pub both: &'static [&'static str],
    /// Options of the run without the effect. [`Self::with`] has those of the run with it.
    pub without: &'static [&'static str],
    /// See [`Self::without`].
    pub with: &'static [&'static str],
    /// Options of `splat eval` for both scenes. [`Self::eval_with`] has those for the scene with the effect only.
    pub eval: &'static [&'static str],
    /// See [`Self::eval`].
    pub eval_with: &'static [&'static str],
    /// Whether the compared PSNR is that after colour correction, because no training photograph determines the exposure
    /// of a test photograph.
    pub corrected: bool,
    /// Whether the cameras of the run without the effect are declared as pinholes.
    pub strip_lens: bool,
    /// Smallest required gain at full size, dB: the measured gain minus the variation between runs.
    pub least_gain_db: f64,
    /// Number of photographs of the case. `None` for the usual number.
    pub views: Option<usize>,
}

const PLAIN: EffectCase = EffectCase {
    name: "plain",
    demo: |options| options,
    demo_flags: "",
    expected: &[],
    harmonics: Some(false),
    both: &["--sh-degree", "0"],
    without: &["--effects", "none"],
    with: &["--effects", "auto"],
    eval: &[],
    eval_with: &[],
    corrected: false,
    strip_lens: false,
    least_gain_db: 0.9,
    views: None,
};

/// All cases.
pub(super) const CASES: &[EffectCase] = &[
    EffectCase { least_gain_db: 0.0, ..PLAIN },
    EffectCase {
        name: "exposure",
        demo: |options| DemoOptions { exposure: true, ..options },
        demo_flags: "--exposure",
        expected: &[EffectKind::Exposure],
        corrected: true,
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "bilateral-grid",
        demo: |options| DemoOptions { graded: true, ..options },
        demo_flags: "--graded",
        expected: &[EffectKind::BilateralGrid],
        corrected: true,
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "masks",
        demo: |options| DemoOptions { masks: true, ..options },
        demo_flags: "--masks",
        expected: &[EffectKind::Masks],
        eval: &["--masks"],
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "alpha",
        demo: |options| DemoOptions { alpha: true, ..options },
        demo_flags: "--alpha",
        expected: &[EffectKind::Alpha],
        eval: &["--background", "white"],
        ..PLAIN
    },
    EffectCase {
        name: "antialias",
        demo: |options| DemoOptions { zoom: true, ..options },
        demo_flags: "--zoom",
        expected: &[EffectKind::Antialias],
        eval: &["--shrink", "4"],
        eval_with: &["--antialias"],
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "lens",
        demo: |options| DemoOptions { lens: true, ..options },
        demo_flags: "--lens",
        strip_lens: true,
        ..PLAIN
    },
    EffectCase {
        name: "fisheye",
        demo: |options| DemoOptions { fisheye: true, ..options },
        demo_flags: "--fisheye",
        strip_lens: true,
        ..PLAIN
    },
    EffectCase {
        name: "environment",
        demo: |options| DemoOptions { far: true, ..options },
        demo_flags: "--far --views 17",
        views: Some(17),
        expected: &[EffectKind::Environment],
        harmonics: None,
        least_gain_db: 0.6,
        ..PLAIN
    },
    EffectCase {
        name: "pose-refinement",
        demo: |options| DemoOptions { poses: true, ..options },
        demo_flags: "--poses",
        expected: &[EffectKind::PoseRefinement],
        ..PLAIN
    },
    EffectCase {
        name: "depth-supervision",
        demo: |options| DemoOptions { depth: true, points: 150, ..options },
        demo_flags: "--depth --views 16 --points 150",
        // Half of the photographs are held out.
        both: &["--sh-degree", "0", "--eval-every", "2"],
        eval: &["--eval-every", "2"],
        expected: &[EffectKind::DepthSupervision],
        views: Some(16),
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "motion-blur",
        demo: |options| DemoOptions { motion: true, ..options },
        demo_flags: "--motion",
        expected: &[EffectKind::MotionBlur],
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "rolling-shutter",
        demo: |options| DemoOptions { rolling: true, ..options },
        demo_flags: "--rolling",
        expected: &[EffectKind::RollingShutter],
        ..PLAIN
    },
    EffectCase {
        name: "defocus",
        demo: |options| DemoOptions { defocus: true, ..options },
        demo_flags: "--defocus",
        with: &["--effects", "defocus"],
        least_gain_db: 0.0,
        harmonics: None,
        ..PLAIN
    },
    EffectCase {
        name: "view-dependence",
        demo: |options| DemoOptions { glossy: true, ..options },
        demo_flags: "--glossy",
        harmonics: Some(true),
        // Otherwise a run this short would end before the harmonics start.
        both: &["--sh-every", "100"],
        without: &["--effects", "none", "--sh-degree", "0"],
        ..PLAIN
    },
];

/// The results of a case.
#[derive(Clone, Debug)]
pub struct EffectGain {
    /// Effects that the plan switched on.
    pub planned: Vec<EffectKind>,
    /// Whether the plan found view-dependent colours.
    pub harmonics: bool,
    /// Evidence of the effect in the words of `splat inspect`.
    pub evidence: String,
    /// Scores without and with the effect, dB.
    pub score_db: [f64; 2],
    /// Training times, s.
    pub seconds: [f64; 2],
}

impl EffectCase {
    /// Creates the capture in `work`, surveys it, trains twice and measures.
    pub fn measure(&self, scale: &RunSize, work: &Path) -> Result<EffectGain> {
        let folder = work.join(self.name);
        let (width, views) = (scale.width, self.views.unwrap_or(scale.views));
        let options = DemoOptions { width, height: 3 * width / 4, views, ..DemoOptions::default() };
        demo::ensure(&folder, &(self.demo)(options))?;
        let capture = Capture::load(&folder)?;
        let plan = Plan::from(&Survey::of(&capture)?);
        let named = |name: &str| plan.decisions.iter().find(|decision| decision.name == name);
        let evidence = named(self.name).map_or(String::new(), |decision| decision.evidence.clone());
        let without = if self.strip_lens { strip_lens(&folder, &capture)? } else { folder.clone() };
        let runs = [(&without, self.without, &[][..], "without"), (&folder, self.with, self.eval_with, "with")];
        let mut score_db = [0.0; 2];
        let mut seconds = [0.0; 2];
        for (i, (capture, options, eval, name)) in runs.into_iter().enumerate() {
            let out = work.join(format!("{}-{name}", self.name));
            let metrics = self.train(capture, &out, options, scale)?;
            seconds[i] = metrics.seconds.train.unwrap_or_default();
            score_db[i] = self.evaluate(capture, &out, eval)?;
        }
        Ok(EffectGain { planned: plan.effects(), harmonics: plan.sh_degree().is_none(), evidence, score_db, seconds })
    }

    fn train(&self, capture: &Path, out: &Path, options: &[&str], scale: &RunSize) -> Result<Metrics> {
        let steps = scale.steps.to_string();
        let always = ["splat", "train", text(capture)?, "--out", text(out)?, "--device", "cpu", "--steps", &steps];
        let arguments = always.iter().chain(self.both).chain(options);
        match Cli::try_parse_from(arguments)?.command {
            Command::Train(args) => train::run(&args),
            _ => bail!("`train` is another command"),
        }
    }

    fn evaluate(&self, capture: &Path, out: &Path, options: &[&str]) -> Result<f64> {
        let (scene, to, background) = (out.join(SCENE), out.join("eval"), out.join(BACKGROUND));
        let mut arguments = vec!["splat", "eval", text(capture)?, "--scene", text(&scene)?, "--out", text(&to)?];
        arguments.extend(["--device", "cpu"]);
        arguments.extend(self.eval.iter().chain(options));
        if background.exists() {
            arguments.extend(["--background", text(&background)?]);
        }
        let Command::Eval(args) = Cli::try_parse_from(arguments)?.command else { bail!("`eval` is another command") };
        let test = eval::run(&args)?.test.context("photographs were held out")?;
        Ok(if self.corrected { test.psnr_corrected } else { test.psnr })
    }

    /// A description of the first failed expectation. Gains are checked only if `gains` is set.
    pub fn complaint(&self, gain: &EffectGain, gains: bool) -> Option<String> {
        let names = |effects: &[EffectKind]| effects.iter().map(|effect| effect.name()).collect::<Vec<_>>().join(", ");
        if gain.planned != self.expected {
            let (found, expected) = (names(&gain.planned), names(self.expected));
            return Some(format!("{}: the plan switches on [{found}], expected [{expected}]", self.name));
        }
        if let Some(expected) = self.harmonics.filter(|&expected| expected != gain.harmonics) {
            let [found, expected] = [gain.harmonics, expected].map(|depend| if depend { "depend" } else { "do not" });
            let name = self.name;
            return Some(format!(
                "{name}: the plan finds that colours {found} on the view, expected that they {expected}"
            ));
        }
        let gained = gain.score_db[1] - gain.score_db[0];
        (gains && gained < self.least_gain_db)
            .then(|| format!("{}: {gained:.2} dB gained, expected {:.1}", self.name, self.least_gain_db))
    }
}

/// A copy of the capture whose cameras are declared as pinholes.
fn strip_lens(folder: &Path, capture: &Capture) -> Result<PathBuf> {
    let stripped = folder.with_extension("pinhole");
    let mut views = capture.views.clone();
    for view in &mut views {
        view.intrinsics = Intrinsics { model: CameraModel::Pinhole, distortion: [0.0; 8], ..view.intrinsics };
    }
    write_binary_with_tracks(&stripped, &views, &capture.points, &capture.tracks)?;
    let pictures = stripped.join("images");
    std::fs::create_dir_all(&pictures)?;
    for view in &views {
        std::fs::copy(&view.image_path, pictures.join(&view.name))?;
    }
    Ok(stripped)
}

fn text(path: &Path) -> Result<&str> {
    path.to_str().with_context(|| format!("{} is no UTF-8: choose another temporary folder", path.display()))
}
