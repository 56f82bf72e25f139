use std::fs;

use clap::Parser;

use splat_model::density::{AdaptiveConfig, McmcConfig};

use super::*;
use crate::options::{Cli, Command};

fn config(arguments: &[&str]) -> Result<TrainConfig> {
    let cli = Cli::try_parse_from(["splat", "train"].iter().chain(arguments)).unwrap();
    let Command::Train(args) = cli.command else { panic!("asked for train") };
    args.config()
}

#[test]
fn without_options_a_capture_trains_as_the_library_does() {
    let of = |steps: &str| config(&["capture", "--out", "out", "--steps", steps]).unwrap();
    assert_eq!(config(&["capture", "--out", "out"]).unwrap(), TrainConfig::for_steps(30_000));
    assert_eq!(of("2000"), TrainConfig::for_steps(2_000));
    assert_eq!(config(&["capture", "--opacity-weight", "0"]).unwrap().opacity_weight, 0.0);
    let original = config(&["capture", "--strategy", "adaptive", "--sh-every", "1000"]).unwrap();
    assert_eq!(original, TrainConfig { learning_rates: LearningRates::for_steps(30_000), ..TrainConfig::default() });
}

#[test]
fn what_a_checkpoint_keeps_of_the_options_is_all_of_them() {
    let arguments = ["c", "--device", "gpu:1", "--effects=auto,-masks", "--background", "0.1,0.2,0.3"];
    let more = ["--projection", "ray-max", "--accuracy", "fast", "--opacity-weight", "0.1", "--eval-during", "9"];
    let cli = Cli::try_parse_from(["splat", "train"].iter().chain(&arguments).chain(&more)).unwrap();
    let Command::Train(args) = cli.command else { panic!("asked for train") };
    let text = serde_json::to_string(&args).unwrap();
    let read: TrainArgs = serde_json::from_str(&text).unwrap();
    assert_eq!(format!("{read:?}"), format!("{args:?}"));
}

#[test]
fn the_demo_is_short_unless_told_otherwise() {
    assert_eq!(config(&[]).unwrap().steps, DEMO_STEPS);
    assert_eq!(config(&["--steps", "9"]).unwrap().steps, 9);
}

#[test]
fn options_reach_the_configuration() {
    let arguments =
        ["--seed", "5", "--max-splats", "77", "--sh-degree", "2", "--antialias", "--opacity-weight", "0.01"];
    let config = config(&arguments).unwrap();
    assert_eq!((config.seed, config.density.max_splats(), config.sh_degree, config.antialias), (5, 77, 2, true));
    assert_eq!(config.opacity_weight, 0.01);
    let cache = |mb: &str| self::config(&["--cache-mb", mb]).unwrap().cache_mib;
    assert_eq!([cache("0"), cache("100"), cache("9000")], [0, 95, TrainConfig::default().cache_mib]);
    assert_eq!(self::config(&["--sh-every", "300"]).unwrap().sh_every, 300);
}

#[test]
fn a_model_choice_and_a_preset_are_dials_of_one_run() {
    let dials = |arguments: &[&str]| config(arguments).unwrap().dials.to_string();
    assert_eq!(dials(&["--projection", "affine"]), "nothing turned");
    assert_eq!(dials(&["--projection", "ray-max"]), "projection ray-max");
    let both = ["--projection", "ray-max", "--accuracy", "fast"];
    assert_eq!(dials(&both), "alpha_min 4/255, projection ray-max, transmittance_min 1e-3");
    let options = config(&both).unwrap().render_options(1.0);
    assert_eq!((options.projection, options.alpha_min), (splat_op::Projection::RayMax, 4.0 / 255.0));
}

#[test]
fn rates_weights_and_thresholds_are_those_that_were_given() {
    let given = ["--lr-means", "1e-3", "--lr-sh-rest", "2e-5", "--ssim-weight", "0.5", "--grad-threshold", "3e-4"];
    let (given, usual) = (config(&given).unwrap(), config(&[]).unwrap());
    let rates = LearningRates { means: 1e-3, sh_rest: 2e-5, ..usual.learning_rates };
    assert_eq!((given.learning_rates, given.lambda), (rates, 0.5));
    let DensityConfig::Adaptive(density) = given.density else { panic!("gradual is adaptive") };
    assert_eq!(density.grad_threshold, 3e-4);
    let refused = config(&["--grad-threshold", "1", "--strategy", "mcmc"]).unwrap_err().to_string();
    assert!(refused.contains("no threshold"), "{refused}");
    for wrong in [["--lr-means", "0"], ["--ssim-weight", "1.5"], ["--lr-sh-dc", "nan"]] {
        assert!(Cli::try_parse_from(["splat", "train"].iter().chain(&wrong)).is_err(), "{wrong:?}");
    }
}

#[test]
fn strategies_have_the_settings_of_the_library() {
    let density = |arguments: &[&str]| config(arguments).unwrap().density;
    assert_eq!(density(&["--strategy", "adaptive"]), DensityConfig::from(AdaptiveConfig::default()));
    let absgrad = AdaptiveConfig { max_splats: 5, ..AdaptiveConfig::absgrad() };
    assert_eq!(density(&["--strategy", "absgrad", "--max-splats", "5"]), absgrad.into());
    let mcmc = McmcConfig { max_splats: 5, ..McmcConfig::default() };
    assert_eq!(density(&["--strategy", "mcmc", "--max-splats", "5"]), mcmc.into());
    assert_eq!(config(&["--batch", "4"]).unwrap().batch, 4);
}

#[test]
fn photographs_are_small_at_first_where_asked_for() {
    let divisor = |arguments: &[&str], step| config(arguments).unwrap().resolution.divisor_at(step, 100);
    assert_eq!(divisor(&[], 1), 1);
    assert_eq!([1, 26, 51].map(|step| divisor(&["--coarsest", "4"], step)), [4, 2, 1]);
    assert_eq!([(&["--for", "60s"][..]), &["--for", "60s", "--coarsest", "1"]].map(|flags| divisor(flags, 1)), [4, 1]);
}

#[test]
fn impossible_options_are_refused() {
    assert!(config(&["--steps", "0"]).unwrap_err().to_string().contains("--steps"));
    assert!(config(&["--sh-degree", "5"]).unwrap_err().to_string().contains("sh_degree"));
    assert!(config(&["--coarsest", "3"]).unwrap_err().to_string().contains("--coarsest"));
}

#[test]
fn what_a_killed_process_was_writing_goes() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().join(checkpoints::FOLDER);
    fs::create_dir(&folder).unwrap();
    for name in [".step-00000010.safetensors.tmp-aB3dE9", ".tmpaB3dE9", ".tmp-mine", "mine"] {
        fs::write(folder.join(name), "").unwrap();
    }
    let _open = checkpoints::Checkpoints::open(out.path()).unwrap();
    let mut left: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, [".tmp-mine", "mine"]);
}
