//! The installed programs, and what they can do. Options are looked up in a program's own help, because COLMAP renames them.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, anyhow, bail};

const COLMAP_ADVICE: &str = "`apt install colmap` (Debian, Ubuntu), `brew install colmap` (macOS), or a program from \
                             https://github.com/colmap/colmap/releases (Windows) on the PATH; or name a folder that has been reconstructed \
                             already, with `images/` and `sparse/0/`, or `transforms.json`";

const FFMPEG_ADVICE: &str = "`apt install ffmpeg` (Debian, Ubuntu), `brew install ffmpeg` (macOS), or a program from \
                             https://ffmpeg.org/download.html (Windows) on the PATH; or save the frames as photographs in a folder";

pub struct ColmapProgram {
    /// Its version, such as `3.8`.
    pub version: String,
    commands: BTreeSet<String>,
}

impl ColmapProgram {
    /// Finds `colmap` on the PATH and asks for its version and commands. An error if it is not there, with how to
    /// install it, or does not answer.
    pub fn find() -> Result<Self> {
        let help = answer(Self::command("help"), "COLMAP, which finds the cameras of photographs,", COLMAP_ADVICE)?;
        let version = help.lines().find_map(|line| line.strip_prefix("COLMAP ")?.split_whitespace().next());
        let commands = help.split("Available commands:").nth(1).unwrap_or_default();
        let commands: BTreeSet<String> = commands.split_whitespace().map(str::to_owned).collect();
        match version {
            Some(version) if commands.contains("feature_extractor") => Ok(Self { version: version.into(), commands }),
            _ => bail!(
                "`colmap help` does not answer as COLMAP does, but with `{}`: check which program `colmap` is on the PATH",
                brief(&help)
            ),
        }
    }

    pub fn has(&self, command: &str) -> bool {
        self.commands.contains(command)
    }

    /// A command, without options yet. COLMAP opens a window's library even where there is no display.
    pub fn command(name: &str) -> Command {
        let mut command = Command::new("colmap");
        command.arg(name);
        if std::env::var_os("QT_QPA_PLATFORM").is_none() {
            command.env("QT_QPA_PLATFORM", "offscreen");
        }
        command
    }

    pub fn options(&self, name: &str) -> Result<Options> {
        let mut command = Self::command(name);
        command.arg("-h");
        let help = answer(command, "COLMAP", COLMAP_ADVICE)?;
        let names = help.split_whitespace().filter_map(|word| word.strip_prefix("--"));
        let options = Options(names.map(|name| name.trim_end_matches([',', ']']).to_owned()).collect());
        match options.0.contains("database_path") {
            true => Ok(options),
            false => bail!("`colmap {name} -h` lists no option `--database_path`, but says `{}`", brief(&help)),
        }
    }
}

/// Names of a command's options, without dashes.
pub struct Options(BTreeSet<String>);

impl Options {
    /// The first of several names of an option, by version, that this program has.
    pub fn first(&self, names: &[&'static str]) -> Option<&'static str> {
        names.iter().find(|name| self.0.contains(**name)).copied()
    }
}

pub struct Ffmpeg {
    /// Its option that keeps frames as they are in the file: neither doubled nor dropped.
    pub every_frame: &'static str,
}

impl Ffmpeg {
    pub fn find() -> Result<Self> {
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-h", "long"]);
        let help = answer(command, "ffmpeg, which decodes videos,", FFMPEG_ADVICE)?;
        // Since version 5.1.
        Ok(Self { every_frame: if help.contains("-fps_mode") { "-fps_mode" } else { "-vsync" } })
    }

    /// A command that reads the first video stream of a file.
    pub fn reading(video: &std::path::Path) -> Command {
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-hide_banner", "-loglevel", "error", "-i"]).arg(video).args(["-map", "0:v:0"]);
        command
    }
}

/// All that a program prints.
fn answer(mut command: Command, what: &str, advice: &str) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).output().map_err(|error| match error.kind() {
        ErrorKind::NotFound => {
            anyhow!("{what} is not installed: there is no `{name}` on the PATH. Install it: {advice}")
        }
        _ => anyhow::Error::from(error).context(format!("cannot run `{name}`: check that it may be executed")),
    })?;
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text).into_owned();
    (!text.trim().is_empty()).then_some(text).with_context(|| {
        format!("`{name}` says nothing when asked for its options ({}): install it again. {advice}", output.status)
    })
}

/// The first line that says something, for a message.
fn brief(text: &str) -> String {
    text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default().chars().take(200).collect()
}
