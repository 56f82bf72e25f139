use std::fs;

use super::*;

fn parsed(words: &[&str]) -> Result<Cli> {
    parse(["splat"].iter().chain(words).map(OsString::from))
}

fn train(words: &[&str]) -> TrainArgs {
    let Command::Train(args) = parsed(words).unwrap().command else { panic!("asked for train") };
    args
}

#[test]
fn the_command_line_is_consistent() {
    command().debug_assert();
}

/// Short help fits a screen of 40 lines; long help has everything, below headings.
#[test]
fn short_help_fits_a_screen_and_names_what_people_use() {
    let mut command = command();
    command.build();
    let short = command.render_help().to_string();
    assert!(short.lines().count() <= 40, "{short}");
    let groups = [
        "Scenes:",
        "  train ",
        "  resume ",
        "  view ",
        "  clean ",
        "Measurements:",
        "Captures:",
        "Machine:",
        "Options:",
    ];
    let at: Vec<usize> =
        groups.iter().map(|part| short.find(part).unwrap_or_else(|| panic!("{part}: {short}"))).collect();
    assert!(at.is_sorted() && !short.contains("completions"), "{short}");
    let train = command.find_subcommand_mut("train").unwrap();
    let (short, long) = (train.render_help().to_string(), train.render_long_help().to_string());
    assert!(short.lines().count() <= 40, "{} lines: {short}", short.lines().count());
    let options = |help: &str| help.lines().filter(|line| line.trim_start().starts_with("--")).count();
    assert_eq!(options(&short), 15, "{short}");
    let (people, headings) = long.split_once("\nCapture:").unwrap();
    assert_eq!(options(people), 15, "{people}");
    for heading in ["Density:", "Optimiser:", "Accuracy:", "Memory:", "Output:"] {
        assert!(headings.contains(&format!("\n{heading}\n")), "{heading}: {long}");
    }
    assert!(headings.contains("--lr-means") && headings.contains("--frames") && options(headings) > 20, "{long}");
}

#[test]
fn a_file_of_options_is_read_and_the_command_line_comes_first() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("my.toml");
    let path = file.to_str().unwrap();
    let given = train(&[
        "train",
        "c",
        "--antialias",
        "--background",
        "0.1,0.2,0.3",
        "--effects=auto,-masks",
        "--lr-means",
        "0.01",
        "--scale-from",
        "gps",
        "--for",
        "1h",
        "--strategy",
        "mcmc",
        "--device",
        "ndarray",
        "--lpips",
        "w",
        "--moment-bits",
        "8",
    ]);
    fs::write(&file, train::config::to_toml(&given).unwrap()).unwrap();
    assert_eq!(format!("{:?}", train::config::read(&file).unwrap()), format!("{given:?}"));
    let changed = train(&["train", "--config", path, "--steps", "7", "--strategy=adaptive", "d"]);
    assert_eq!((changed.steps, changed.time, changed.lr.lr_means), (Some(7), None, Some(0.01)));
    assert_eq!((changed.strategy, changed.capture), (crate::parts::StrategyName::Adaptive, Some("d".into())));

    fs::write(&file, "steps = 9\nmax-side = 64\nquiet = true\n[anything]\nssim_weight = 0.5\n").unwrap();
    let args = train(&["train", "--config", path]);
    assert_eq!((args.steps, args.photos.max_side, args.voice.quiet, args.ssim_weight), (Some(9), Some(64), true, 0.5));
    for (text, part) in [
        ("step = 9", "`step` is no option"),
        ("steps = -9", "--steps"),
        ("quiet = 3", "expected true or false"),
        ("steps 9", "is not TOML"),
        ("config = \"other.toml\"", "`config` is no option"),
    ] {
        fs::write(&file, text).unwrap();
        let error = format!("{:#}", parsed(&["train", "--config", path]).unwrap_err());
        assert!(error.contains(path) && error.contains(part), "{text}: {error}");
    }
    fs::remove_file(&file).unwrap();
    assert!(parsed(&["train", "--config", path]).unwrap_err().to_string().contains(path));
}

#[test]
fn a_run_that_goes_on_takes_no_options_of_a_new_one() {
    for option in ["--steps=7", "--seed=1", "--out=other", "--device=cpu", "capture"] {
        assert!(parsed(&["resume", "out", option]).is_err(), "{option}");
    }
    for option in ["--quiet", "--json"] {
        let Command::Resume(args) = parsed(&["resume", "out", option]).unwrap().command else {
            panic!("asked for resume")
        };
        assert_eq!((args.voice.quiet, args.voice.json), (option == "--quiet", option == "--json"));
    }
    assert!(parsed(&["resume"]).is_err(), "of which run?");
}
