//! Runs everything that a graphics card can tell about this project, each part as a process of its own with a time limit, so that
//! a driver that hangs or crashes ends one part and not the page.

use std::error::Error;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use splat_train::device::built;

use crate::page::{self, Files, Outcome, PartResult};

/// Options of `card`.
#[derive(Clone, Debug, clap::Parser)]
pub struct Options {
    /// Folder for card.md, card.json and the logs of all parts.
    #[arg(long, default_value = "out")]
    pub out: PathBuf,
    /// Folder with the compiled tests `kernels` and `reference_test`, and the reference vectors in `reference/`.
    #[arg(long)]
    pub tests: PathBuf,
    /// Commit of the binaries, for the page.
    #[arg(long, default_value = "unknown")]
    pub commit: String,
    /// Time limit of all parts together, seconds.
    #[arg(long, default_value_t = 520)]
    pub seconds: u64,
    /// Factor of the parts' time limits, which are those of a graphics card; larger for a driver in software.
    #[arg(long, default_value_t = 1)]
    pub patience: u32,
    /// Length of a side of the demo's photographs, px, and steps of training on it. Smaller for a driver in software.
    #[arg(long, default_value_t = 320)]
    pub side: usize,
    #[arg(long, default_value_t = 2000)]
    pub steps: usize,
    /// Scenes of the benches.
    #[arg(long, value_delimiter = ',', default_value = "wide,large,huge")]
    pub scenes: Vec<String>,
    /// Captures to train on, such as bonsai and fox_colmap.
    #[arg(long, value_delimiter = ',')]
    pub captures: Vec<PathBuf>,
    /// Steps of training on a capture.
    #[arg(long, default_value_t = 7000)]
    pub capture_steps: usize,
}

/// A part of the page: a process and its time limit.
struct Part {
    title: String,
    program: PathBuf,
    arguments: Vec<String>,
    environment: Vec<(&'static str, String)>,
    limit: Duration,
}

/// Folders of the demo capture and of runs.
struct Folders {
    demo: String,
    gpu: String,
    cpu: String,
    /// Of the runs on captures.
    captures: Vec<String>,
    frontier: String,
    cases: String,
    times: String,
}

/// Runs all parts and writes the page. A part that fails does not end the run.
///
/// # Errors
/// If the page cannot be written.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let out = &options.out;
    fs::create_dir_all(out)?;
    let start = Instant::now();
    let whole = Duration::from_secs(options.seconds);
    let folders = Folders::of(options);
    let mut results = Vec::new();
    for (number, part) in parts(options, &folders)?.into_iter().enumerate() {
        let part = Part { limit: part.limit * options.patience, ..part };
        let result = part.run(whole.saturating_sub(start.elapsed()), &out.join(format!("part{number}.log")))?;
        println!("{:>6.1} s  {}: {}", result.seconds, result.title, page::outcome(&result.outcome));
        results.push(result);
        // After each part: what is known is kept if the machine stops.
        page::write(out, &options.commit, &results, &read_files(options, &folders))?;
    }
    println!("wrote {} in {:.0} s", out.join("card.md").display(), start.elapsed().as_secs_f64());
    Ok(())
}

impl Folders {
    fn of(options: &Options) -> Self {
        let path = |name: &str| options.out.join(name).display().to_string();
        Self {
            demo: path("demo"),
            gpu: path("train_gpu"),
            cpu: path("train_cpu"),
            captures: (0..options.captures.len()).map(|number| path(&format!("train_capture{number}"))).collect(),
            frontier: path("frontier"),
            cases: path("hard_cases"),
            times: path("times.json"),
        }
    }
}

fn read_files(options: &Options, folders: &Folders) -> Files {
    let read = |folder: &str| fs::read_to_string(Path::new(folder).join("metrics.json")).ok();
    let demo = [("demo, GPU", &folders.gpu), ("demo, CPU", &folders.cpu)].map(|(run, folder)| (run.into(), folder));
    let captures = options.captures.iter().map(|capture| format!("{}, GPU", capture.display())).zip(&folders.captures);
    let runs = captures.chain(demo).filter_map(|(run, folder)| Some((run, read(folder)?)));
    Files { times: fs::read_to_string(&folders.times).ok(), metrics: runs.collect() }
}

/// Returns the parts, those that tell most first. Limits are for a graphics card, where hardly one is reached.
fn parts(options: &Options, folders: &Folders) -> Result<Vec<Part>, Box<dyn Error>> {
    let own = std::env::current_exe()?;
    let splat = |title: &str, arguments: &[&str], limit| {
        let arguments: Vec<&str> = ["splat"].iter().chain(arguments).copied().collect();
        Part::new(title, &own, &arguments, limit)
    };
    let test = |title: String, name: &str, arguments: &[&str], limit| {
        // Tests find the reference vectors by this variable, which names another folder where they were compiled.
        let folder = options.tests.display().to_string();
        let part = Part::new(&title, &options.tests.join(name), arguments, limit);
        part.with("SPLAT_GPU", "require").with("CARGO_MANIFEST_DIR", &folder)
    };
    // Each runtime compiles the kernels to a language of its own.
    let runtimes: Vec<&str> = ["wgpu", "vulkan"].into_iter().filter(|of| built().any(|built| built == *of)).collect();
    let side = options.side.to_string();
    let (height, steps) = ((options.side * 3 / 4).to_string(), options.steps.to_string());
    let train = |capture: &str, device: &'static str, steps: &str, out: &str, limit| {
        let arguments =
            ["train", capture, "--device", device, "--steps", steps, "--out", out, "--effects", "none", "--quiet"];
        splat(&format!("training on {capture}, --device {device}"), &arguments, limit)
    };
    // `gpu` alone would be the best adapter of any runtime, and that of SPIR-V is preferred.
    let devices = runtimes.iter().map(|runtime| if *runtime == "wgpu" { "gpu:0" } else { *runtime });
    let compare = devices.chain(options.scenes.iter().map(String::as_str));
    let compare: Vec<&str> = compare.chain(["--json", &folders.times]).collect();

    let mut parts = vec![splat("devices", &["devices"], 30)];
    let on_runtimes = [
        ("kernels against their CPU twins", "kernels", vec!["kernel_tests"], 90),
        ("reference vectors", "reference_test", vec![], 30),
    ];
    for (title, name, arguments, limit) in on_runtimes {
        parts.extend(runtimes.iter().map(|runtime| {
            let title = format!("{title}, runtime {runtime}");
            test(title, name, &arguments, limit).with("SPLAT_RUNTIME", runtime)
        }));
    }
    parts.push(Part::new("times of all passes", &own, &compare, 240));
    let capture_steps = options.capture_steps.to_string();
    for (capture, out) in options.captures.iter().zip(&folders.captures) {
        parts.push(train(&capture.display().to_string(), "gpu", &capture_steps, out, 120));
    }
    let demo = ["demo", "--out", &folders.demo, "--width", &side, "--height", &height];
    parts.push(splat("the demo capture", &demo, 30));
    parts.push(train(&folders.demo, "gpu", &steps, &folders.gpu, 60));
    parts.push(splat("hard cases", &["hard-cases", "--device", "gpu", "--out", &folders.cases], 90));
    parts.push(train(&folders.demo, "cpu", &steps, &folders.cpu, 90));
    let scene = format!("{}/scene.ply", folders.gpu);
    let frontier = ["pareto", &folders.demo, "--scene", &scene, "--device", "gpu", "--budget", "30", "--out"];
    let frontier: Vec<&str> = frontier.into_iter().chain([folders.frontier.as_str()]).collect();
    parts.push(splat("the frontier of time and error", &frontier, 90));
    Ok(parts)
}

impl Part {
    fn new(title: &str, program: &Path, arguments: &[&str], limit_s: u64) -> Self {
        Self {
            title: title.into(),
            program: program.into(),
            arguments: arguments.iter().map(|&argument| argument.into()).collect(),
            environment: Vec::new(),
            limit: Duration::from_secs(limit_s),
        }
    }

    fn with(mut self, variable: &'static str, value: &str) -> Self {
        self.environment.push((variable, value.into()));
        self
    }

    /// Runs the process until its limit, or until `left` is used up.
    fn run(self, left: Duration, log: &Path) -> Result<PartResult, Box<dyn Error>> {
        let limit = self.limit.min(left);
        let command =
            [self.program.display().to_string()].into_iter().chain(self.arguments.clone()).collect::<Vec<_>>();
        let result = |outcome, seconds, memory_mib, output| PartResult {
            title: self.title.clone(),
            command: command.join(" "),
            outcome,
            seconds,
            memory_mib,
            output,
        };
        if limit < Duration::from_secs(5) {
            return Ok(result(Outcome::Skipped("no time was left".into()), 0.0, None, String::new()));
        }
        // Output goes to a file, because a pipe that nobody reads stops its writer.
        let file = File::create(log)?;
        let start = Instant::now();
        let child = Command::new(&self.program)
            .args(&self.arguments)
            .envs(self.environment.iter().map(|(variable, value)| (*variable, value)))
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            .spawn();
        let mut child = match child {
            Ok(child) => child,
            Err(error) => {
                let why = format!("{} does not start: {error}", self.program.display());
                return Ok(result(Outcome::Skipped(why), 0.0, None, String::new()));
            }
        };
        let (mut memory_mib, mut asked) = (None, start);
        let outcome = loop {
            if let Some(status) = child.try_wait()? {
                break ended(status);
            }
            if start.elapsed() > limit {
                child.kill()?;
                child.wait()?;
                break Outcome::Stopped(limit.as_secs());
            }
            if asked.elapsed() > Duration::from_secs(2) {
                asked = Instant::now();
                memory_mib = memory_mib.max(used_mib());
            }
            thread::sleep(Duration::from_millis(50));
        };
        let output = String::from_utf8_lossy(&fs::read(log)?).into_owned();
        Ok(result(outcome, start.elapsed().as_secs_f64(), memory_mib, output))
    }
}

/// Returns the memory in use on the first card, MiB, by `nvidia-smi`; `None` where that is not installed.
fn used_mib() -> Option<u64> {
    let query = ["--query-gpu=memory.used", "--format=csv,noheader,nounits"];
    let output = Command::new("nvidia-smi").args(query).stderr(Stdio::null()).output().ok()?;
    String::from_utf8_lossy(&output.stdout).lines().next()?.trim().parse().ok()
}

fn ended(status: ExitStatus) -> Outcome {
    match status.success() {
        true => Outcome::Passed,
        // Names the exit code or the signal.
        false => Outcome::Failed(status.to_string()),
    }
}
