//! The photographs of a reconstruction: which are used, where COLMAP finds them, and which share a camera.

use std::fs;
#[cfg(not(unix))]
use std::io;
#[cfg(unix)]
use std::os::unix::fs::symlink as make_link;
use std::path::Path;

use anyhow::{Context, Result};
use clap::ValueEnum;
use splat_model::capture::unposed::{PhotographFolder, SameCamera, Unposed, by_camera};

use super::cache::{IMAGES, MASKS, Workspace};
use super::failure;
use crate::progress;

/// Fewest photographs of one camera whose lens has two coefficients of each kind and two focal lengths. With fewer, one focal length and one
/// coefficient are better determined.
const MANY: usize = 20;

/// Most cameras that are told apart. Photographs of more, as from the internet, are left to COLMAP, which reads the same EXIF.
const MOST_CAMERAS: usize = 8;

/// COLMAP's camera models that the projection supports without undistortion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum CameraModelName {
    /// One focal length
    SimplePinhole,
    /// Two focal lengths
    Pinhole,
    /// One focal length, one radial coefficient
    SimpleRadial,
    /// One focal length, two radial coefficients
    Radial,
    /// Two focal lengths, two radial and two decentring coefficients: phones and most lenses
    Opencv,
    /// Fisheyes: two focal lengths, four coefficients
    OpencvFisheye,
}

impl CameraModelName {
    pub fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Parameters of a camera without distortion: focal lengths, the middle, zeros.
    fn parameters(self, focal_px: f64, [width, height]: [usize; 2]) -> String {
        let (focal_lengths, coefficients) = match self {
            Self::SimplePinhole => (1, 0),
            Self::Pinhole => (2, 0),
            Self::SimpleRadial => (1, 1),
            Self::Radial => (1, 2),
            Self::Opencv | Self::OpencvFisheye => (2, 4),
        };
        let mut numbers = vec![format!("{focal_px:.3}"); focal_lengths];
        numbers.extend([width, height].map(|side| format!("{:.1}", side as f64 / 2.0)));
        numbers.extend(vec!["0".to_string(); coefficients]);
        numbers.join(",")
    }
}

/// One call of `feature_extractor`.
pub struct Extraction {
    /// Photographs, by name; all of them if there is one call.
    pub names: Vec<String>,
    /// Options that describe their camera.
    pub arguments: Vec<String>,
}

/// Looks at all photographs, and says how they are left to COLMAP.
pub fn look(folder: &PhotographFolder) -> Result<Vec<Unposed>> {
    failure::check_number(folder)?;
    let counter = progress::counter("looking at photographs", folder.names.len());
    let photographs = folder.look(|done| counter.inc(done))?;
    failure::check_different(&photographs, &folder.root)?;
    Ok(photographs)
}

/// Groups photographs by camera: one call of `feature_extractor` for each.
pub fn extractions(photographs: &[Unposed], model: Option<CameraModelName>) -> Vec<Extraction> {
    let cameras = by_camera(photographs);
    let of = |camera: &SameCamera| {
        let few = if camera.members.len() < MANY { CameraModelName::SimpleRadial } else { CameraModelName::Opencv };
        let model = model.unwrap_or(few);
        let mut arguments = vec!["--ImageReader.camera_model".into(), model.name()];
        arguments.extend(["--ImageReader.single_camera".into(), "1".into()]);
        let focal = camera.focal_px.map_or("unknown".into(), |focal_px| format!("{focal_px:.0} px by EXIF"));
        if let Some(focal_px) = camera.focal_px {
            arguments.extend(["--ImageReader.camera_params".into(), model.parameters(focal_px, camera.size)]);
        }
        let ([width, height], taken) = (camera.size, camera.members.len());
        progress::note(&format!(
            "{taken} photographs of {width} × {height} px share one camera: {}, focal length {focal}",
            model.name()
        ));
        let names = camera.members.iter().map(|&member| photographs[member].name.clone()).collect();
        Extraction { names, arguments }
    };
    if cameras.len() <= MOST_CAMERAS {
        return cameras.iter().map(of).collect();
    }
    let model = model.unwrap_or(CameraModelName::SimpleRadial).name();
    progress::note(&format!("photographs of {} cameras: each has its own {model}", cameras.len()));
    let names = photographs.iter().map(|photograph| photograph.name.clone()).collect();
    vec![Extraction { names, arguments: vec!["--ImageReader.camera_model".into(), model] }]
}

/// Makes `images/` in the workspace: links to the photographs, which are neither changed nor moved, or copies where the system has no
/// links. Masks beside the photographs are linked too. Files that are there stay.
pub fn link(workspace: &Workspace, source: &Path, folder: &PhotographFolder) -> Result<()> {
    let images = workspace.join(IMAGES);
    let root = std::path::absolute(&folder.root)?;
    for name in &folder.names {
        let (from, to) = (root.join(name), images.join(name));
        let parent = to.parent().unwrap_or(&images);
        let ready = match fs::read_link(&to) {
            Ok(target) if target == from => continue,
            // A copy.
            Err(_) if to.exists() => continue,
            // The photographs were elsewhere.
            Ok(_) => fs::remove_file(&to),
            Err(_) => fs::create_dir_all(parent),
        };
        ready
            .and_then(|()| make_link(&from, &to).or_else(|_| fs::copy(&from, &to).map(drop)))
            .with_context(|| format!("cannot make a link or a copy of {} in {}", from.display(), parent.display()))?;
    }
    let to = workspace.join(MASKS);
    if to.exists() {
        return Ok(());
    }
    if to.is_symlink() {
        fs::remove_file(&to).with_context(|| format!("cannot remove the link {}", to.display()))?;
    }
    for name in ["masks", "mask"] {
        let masks = std::path::absolute(source)?.join(name);
        // Without links masks stay where they are, and training does without them.
        if masks.is_dir() && make_link(&masks, &to).is_ok() {
            break;
        }
    }
    Ok(())
}

#[cfg(not(unix))]
fn make_link(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests;
