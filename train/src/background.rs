//! `--background`: the background behind a scene.

use std::path::Path;
use std::str::FromStr;

use anyhow::Result;
use serde::Serialize;
use splat_model::effects::background::{Backdrop, Background};
use splat_model::ply::TrainedAs;
use splat_model::trainer::TrainConfig;

use crate::accuracy::ModelArgs;
use crate::device::DeviceName;
use crate::progress;

/// File of the background in a run's folder, where the run learned it.
pub const BACKGROUND: &str = "background.json";

/// Parses a colour: a name, or three comma-separated numbers from 0 to 1.
fn colour(text: &str) -> Option<[f32; 3]> {
    match text {
        "black" => return Some([0.0; 3]),
        "white" => return Some([1.0; 3]),
        _ => {}
    }
    let values: Vec<f32> = text.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    let colour: [f32; 3] = values.try_into().ok()?;
    colour.iter().all(|value| (0.0..=1.0).contains(value)).then_some(colour)
}

/// The value of `splat train --background`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainBackground {
    pub backdrop: Backdrop,
    /// The colour of a fixed backdrop, else black.
    colour: [f32; 3],
}

/// Default degree of the environment's spherical harmonics.
pub const ENVIRONMENT_DEGREE: usize = 3;

impl FromStr for TrainBackground {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let degree = |digit: &str| digit.parse().ok().filter(|degree| *degree <= splat_op::sh::SH_DEGREE_MAX);
        let backdrop = match text {
            "random" => Some(Backdrop::Random),
            "learned" => Some(Backdrop::Learned),
            "environment" => Some(Backdrop::Environment { degree: ENVIRONMENT_DEGREE }),
            _ => match text.strip_prefix("environment:") {
                Some(digit) => degree(digit).map(|degree| Backdrop::Environment { degree }),
                None => colour(text).map(|_| Backdrop::Fixed),
            },
        };
        let colour = colour(text).unwrap_or_default();
        backdrop.map(|backdrop| Self { backdrop, colour }).ok_or_else(|| {
            format!(
                "{text:?} is not a background, expected black, white, three numbers from 0 to 1 such as 0.5,0.5,0.5, random, \
                 learned, environment, or environment:D with a degree from 0 to 4"
            )
        })
    }
}

impl std::fmt::Display for TrainBackground {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { backdrop, colour: [r, g, b] } = self;
        match backdrop {
            Backdrop::Fixed => write!(out, "{r},{g},{b}"),
            Backdrop::Random => out.write_str("random"),
            Backdrop::Learned => out.write_str("learned"),
            Backdrop::Environment { degree } => write!(out, "environment:{degree}"),
        }
    }
}

impl TrainBackground {
    /// Applies the background to the configuration of a run.
    pub fn configure(self, config: &mut TrainConfig) {
        (config.backdrop, config.background) = (self.backdrop, self.colour);
    }
}

/// The value of `--background` of the subcommands that render a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShownBackground(String);

impl FromStr for ShownBackground {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match colour(text).is_some() || text.ends_with(".json") {
            true => Ok(Self(text.into())),
            false => Err(format!(
                "{text:?} is not a background, expected black, white, three numbers from 0 to 1 such as 0.5,0.5,0.5, or the \
                 background.json that a run left beside its scene"
            )),
        }
    }
}

impl ShownBackground {
    /// The file that it is in, if it is in one.
    pub fn file(&self) -> Option<&Path> {
        colour(&self.0).is_none().then(|| Path::new(&self.0))
    }

    /// Returns the background, read from its file if it is one; without one, that of the training of a scene. An error
    /// if the file cannot be read or holds no background.
    pub fn read(asked: Option<&Self>, scene: &Path, trained: &TrainedAs) -> Result<Background> {
        let beside = scene.with_file_name(BACKGROUND);
        match asked {
            Some(asked) => match asked.file() {
                None => Ok(Background::Colour(colour(&asked.0).unwrap_or_default())),
                Some(file) => Ok(Background::read(file)?),
            },
            None if trained.environment && beside.is_file() => Ok(Background::read(&beside)?),
            None => {
                if trained.environment {
                    progress::note(&format!(
                        "{} is not there: the light behind the scene is left out",
                        beside.display()
                    ));
                }
                Ok(Background::Colour(trained.background))
            }
        }
    }
}

/// How a scene is shown: the device, the model choices and the background.
#[derive(Clone, Debug, clap::Args)]
pub struct ShowArgs {
    /// Device to compute on: auto, cpu, flex, ndarray, gpu, gpu:N and what else `splat devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    pub device: DeviceName,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Background behind the scene: black, white, R,G,B from 0 to 1, or the background.json of a training run [default: that of the
    /// scene's training]
    #[arg(long, value_name = "WHAT")]
    pub background: Option<ShownBackground>,
}

impl ShowArgs {
    /// The file of the background, if it is in one.
    pub fn file(&self) -> Option<&Path> {
        self.background.as_ref().and_then(ShownBackground::file)
    }

    /// Returns the background of a scene; see [`ShownBackground::read`].
    pub fn background(&self, scene: &Path, trained: &TrainedAs) -> Result<Background> {
        ShownBackground::read(self.background.as_ref(), scene, trained)
    }
}

#[cfg(test)]
mod tests;
