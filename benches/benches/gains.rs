//! Gains and costs of the effects, on demo captures that show one effect each. Prints a table.
//!
//! `cargo bench --workspace --bench gains -- masks exposure` measures the cases named, and all of them without names. `--quick` takes small
//! pictures and few steps, to test that effects are detected and not how much they gain. It fails where `auto` misses an effect, finds one
//! that is absent, or the effect gains less than it must.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Parser;
use splat_demo::DemoOptions;
use splat_model::capture::Capture;
use splat_model::effects::{EffectKind, Plan, Survey};
use splat_op::CameraModel;
use splat_train::options::{Cli, Command};
use splat_train::report::SCENE;
use splat_train::{demo, eval, train};

splat_train::allocator!();

/// Picture sizes and lengths of runs.
#[derive(Clone, Copy, Debug)]
struct RunSize {
    /// Width of the pictures, px; the height is three quarters of it.
    width: usize,
    /// Number of photographs, unless the case sets its own.
    views: usize,
    /// Steps of each run.
    steps: usize,
}

impl RunSize {
    /// The scale of published figures.
    const FULL: Self = Self { width: 160, views: 40, steps: 1500 };
    /// The scale of tests.
    const QUICK: Self = Self { width: 96, views: 24, steps: 300 };
}

/// A case about one effect.
#[derive(Clone, Copy, Debug)]
struct EffectCase {
    /// Name, as on the command line.
    name: &'static str,
    /// Options of the demo capture, at any size.
    demo: fn(DemoOptions) -> DemoOptions,
    /// The same options on the command line.
    demo_flags: &'static str,
    /// Effects that the plan must switch on.
    expected: &'static [EffectKind],
    /// Whether the plan must find view-dependent colours. `None` where other faults of the photographs make colours vary
    /// too, so that the plan may keep the harmonics.
    harmonics: Option<bool>,
    /// Options of both runs.
    both: &'static [&'static str],
    /// Options of the run without the effect. [`Self::with`] has those of the run with it.
    without: &'static [&'static str],
    /// See [`Self::without`].
    with: &'static [&'static str],
    /// Options of `splat eval`.
    eval: &'static [&'static str],
    /// Whether the compared PSNR is that after colour correction, because no training photograph determines the exposure
    /// of a test photograph.
    corrected: bool,
    /// Whether the cameras of the run without the effect are declared as pinholes.
    strip_lens: bool,
    /// Smallest required gain at full size, dB: the measured gain minus the variation between runs.
    least_gain_db: f64,
    /// Number of photographs of the case. `None` for the usual number.
    views: Option<usize>,
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
    corrected: false,
    strip_lens: false,
    least_gain_db: 0.9,
    views: None,
};

/// All cases.
const CASES: &[EffectCase] = &[
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
        both: &["--sh-degree", "0", "--test-every", "2"],
        eval: &["--test-every", "2"],
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
struct EffectGain {
    /// Effects that the plan switched on.
    planned: Vec<EffectKind>,
    /// Whether the plan found view-dependent colours.
    harmonics: bool,
    /// Evidence of the effect in the words of `splat inspect`.
    evidence: String,
    /// Scores without and with the effect, dB.
    score_db: [f64; 2],
    /// Training times, s.
    seconds: [f64; 2],
}

impl EffectCase {
    /// Creates the capture in `work`, surveys it, trains twice and measures.
    fn measure(&self, scale: &RunSize, work: &Path) -> Result<EffectGain> {
        let folder = work.join(self.name);
        let (width, views) = (scale.width, self.views.unwrap_or(scale.views));
        let options = DemoOptions { width, height: 3 * width / 4, views, ..DemoOptions::default() };
        demo::ensure(&folder, &(self.demo)(options))?;
        let capture = Capture::load(&folder)?;
        let plan = Plan::from(&Survey::of(&capture)?);
        let named = |name: &str| plan.decisions.iter().find(|decision| decision.name == name);
        let evidence = named(self.name).map_or(String::new(), |decision| decision.evidence.clone());
        let without = if self.strip_lens { strip_lens(&folder, &capture)? } else { folder.clone() };
        let runs = [(&without, self.without, "without"), (&folder, self.with, "with")];
        let mut score_db = [0.0; 2];
        let mut seconds = [0.0; 2];
        for (i, (capture, options, name)) in runs.into_iter().enumerate() {
            let out = work.join(format!("{}-{name}", self.name));
            seconds[i] = self.train(capture, &out, options, scale)?;
            score_db[i] = self.evaluate(capture, &out)?;
        }
        Ok(EffectGain { planned: plan.effects(), harmonics: plan.sh_degree().is_none(), evidence, score_db, seconds })
    }

    fn train(&self, capture: &Path, out: &Path, options: &[&str], scale: &RunSize) -> Result<f64> {
        let steps = scale.steps.to_string();
        let always = ["splat", "train", text(capture)?, "--out", text(out)?, "--device", "cpu", "--steps", &steps];
        let arguments = always.iter().chain(self.both).chain(options);
        match Cli::try_parse_from(arguments)?.command {
            Command::Train(args) => Ok(train::run(&args)?.seconds.train.unwrap_or_default()),
            _ => bail!("`train` is another command"),
        }
    }

    fn evaluate(&self, capture: &Path, out: &Path) -> Result<f64> {
        let (scene, to) = (out.join(SCENE), out.join("eval"));
        let mut arguments = vec!["splat", "eval", text(capture)?, "--scene", text(&scene)?, "--out", text(&to)?];
        arguments.extend(["--device", "cpu"]);
        arguments.extend(self.eval);
        let Command::Eval(args) = Cli::try_parse_from(arguments)?.command else { bail!("`eval` is another command") };
        let test = eval::run(&args)?.test.context("photographs were held out")?;
        Ok(if self.corrected { test.psnr_corrected } else { test.psnr })
    }

    /// A description of the first failed expectation. Gains are checked only if `gains` is set.
    fn complaint(&self, gain: &EffectGain, gains: bool) -> Option<String> {
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
        view.intrinsics = view.intrinsics.with_lens(CameraModel::Pinhole, [0.0; 8]);
    }
    splat_demo::write_model(&stripped, &views, &capture.points, &capture.tracks)?;
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

/// A line of the table. The cost is the difference of the training times.
fn line(case: &EffectCase, gain: &EffectGain) -> String {
    let mut names: Vec<&str> = gain.planned.iter().map(|effect| effect.name()).collect();
    names.extend((case.harmonics == Some(true) && gain.harmonics).then_some("harmonics"));
    let names = if names.is_empty() { "nothing".into() } else { names.join(", ") };
    let ([without, with], [before, after]) = (gain.score_db, gain.seconds);
    let cost = 100.0 * (after / before - 1.0);
    let flags = if case.demo_flags.is_empty() { "plain".into() } else { format!("`{}`", case.demo_flags) };
    let gained = with - without;
    format!(
        "| {flags} | {names} | {} | {without:.2} | {with:.2} | {gained:+.2} | {cost:+.0}% | {before:.0}, {after:.0} |",
        gain.evidence
    )
}

fn main() -> Result<()> {
    // `cargo bench` adds an option of its own.
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let (quick, names): (Vec<_>, Vec<_>) = words.iter().partition(|word| *word == "--quick");
    if let Some(unknown) = names.iter().find(|name| !CASES.iter().any(|case| case.name == ***name)) {
        let names: Vec<&str> = CASES.iter().map(|case| case.name).collect();
        bail!("there is no case {unknown:?}: give some of {}", names.join(", "));
    }
    let scale = if quick.is_empty() { RunSize::FULL } else { RunSize::QUICK };
    let work = tempfile::tempdir().context("cannot create a temporary folder for the captures")?;
    println!("| demo | `auto` switches on | evidence | without, dB | with, dB | gain, dB | time | training, s |");
    println!("|---|---|---|---|---|---|---|---|");
    let mut wrong = Vec::new();
    for case in CASES.iter().filter(|case| names.is_empty() || names.iter().any(|name| *name == case.name)) {
        let gain = case.measure(&scale, work.path())?;
        println!("{}", line(case, &gain));
        wrong.extend(case.complaint(&gain, quick.is_empty()));
    }
    if wrong.is_empty() { Ok(()) } else { bail!("{}", wrong.join("\n")) }
}
