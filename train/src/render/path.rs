//! `--path`: cameras that no photograph has, and the video of their pictures.

use std::f64::consts::TAU;
use std::fs;
use std::io::{ErrorKind, Write};
use std::ops::{Add, Mul, Sub};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, anyhow, ensure};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use splat_model::init::focus;
use splat_op::Intrinsics;
use tempfile::TempDir;

use crate::reconstruct::Running;

/// Returns a pinhole with a focal length and even sides, as videos need them.
pub fn pinhole(like: &Intrinsics) -> Intrinsics {
    Intrinsics::centred((like.width & !1).max(2), (like.height & !1).max(2), like.fy)
}

/// Returns the poses of an orbit, `cam_from_world`, from those of a capture's cameras, `world_from_cam`. An error if
/// all cameras are at one place.
pub fn orbit(poses: &[DAffine3], count: usize) -> Result<Vec<DAffine3>> {
    let mean = |of: &dyn Fn(&DAffine3) -> DVec3| poses.iter().map(of).sum::<DVec3>() / poses.len() as f64;
    let up = -mean(&|pose| pose.matrix3.y_axis).try_normalize().unwrap_or(DVec3::Y);
    let ahead = |place: &DVec3| {
        let is_ahead = |pose: &&DAffine3| (place - pose.translation).dot(pose.matrix3.z_axis) > 0.0;
        2 * poses.iter().filter(is_ahead).count() > poses.len()
    };
    let centre = focus(poses).filter(ahead).unwrap_or_else(|| mean(&|pose| pose.translation + pose.matrix3.z_axis));
    let across = |pose: &DAffine3| (pose.translation - centre).reject_from(up);
    let radius = poses.iter().map(|pose| across(pose).length()).sum::<f64>() / poses.len() as f64;
    let height = mean(&|pose| pose.translation - centre).dot(up);
    let start = poses.iter().map(across).find_map(DVec3::try_normalize);
    let start = start.context("the cameras of the capture surround no place: give `--view` instead of `--path`")?;
    let camera = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
        let position = centre + radius * (cos * start + sin * up.cross(start)) + height * up;
        let forward = (centre - position).normalize();
        let right = forward.cross(up).try_normalize().unwrap_or(start);
        DAffine3::from_mat3_translation(DMat3::from_cols(right, forward.cross(right), forward), position).inverse()
    };
    Ok((0..count).map(camera).collect())
}

/// Returns `count` cameras and poses, `cam_from_world`, evenly in time from the first of at least two keyframes to the last, in the world relative to
/// `origin`. Keyframes are `world_from_cam` and a vertical field of view in degrees, by default that of `lens`; they are equally far apart in time.
///
/// Positions, quaternions and logarithms of focal lengths are Catmull-Rom splines (Catmull and Rom 1974).
pub fn along(
    keyframes: &[(DAffine3, Option<f64>)],
    origin: DVec3,
    lens: &Intrinsics,
    count: usize,
) -> Vec<(Intrinsics, DAffine3)> {
    let focal = |degrees: f64| 0.5 * lens.height as f64 / (0.5 * degrees).to_radians().tan();
    let log_focals: Vec<f64> = keyframes.iter().map(|(_, fov)| fov.map_or(lens.fy, focal).ln()).collect();
    let positions: Vec<DVec3> = keyframes.iter().map(|(pose, _)| pose.translation - origin).collect();
    let mut rotations: Vec<DQuat> = keyframes.iter().map(|(pose, _)| DQuat::from_mat3(&pose.matrix3)).collect();
    for i in 1..rotations.len() {
        // Of a rotation's two quaternions, the nearer to the one before: the spline then stays away from zero.
        let sign = rotations[i - 1].dot(rotations[i]).signum();
        rotations[i] *= sign;
    }
    let camera = |i: usize| {
        let at = (i * (keyframes.len() - 1)) as f64 / count.saturating_sub(1).max(1) as f64;
        let rotation = catmull_rom(&rotations, at).normalize();
        let world_from_cam = DAffine3::from_rotation_translation(rotation, catmull_rom(&positions, at));
        let focal = catmull_rom(&log_focals, at).exp();
        (lens.with_focal(focal, focal), world_from_cam.inverse())
    };
    (0..count).map(camera).collect()
}

/// The spline through at least two knots, at 0, 1, 2 and so on. The knot beyond an end mirrors the one before it.
fn catmull_rom<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f64, Output = T>>(knots: &[T], at: f64) -> T {
    let i = (at as usize).min(knots.len() - 2);
    let t = at - i as f64;
    let (from, to) = (knots[i], knots[i + 1]);
    let before = if i == 0 { from * 2.0 - to } else { knots[i - 1] };
    let after = knots.get(i + 2).copied().unwrap_or(to * 2.0 - from);
    let (leave, arrive) = ((to - before) * 0.5, (after - from) * 0.5);
    let chord = to - from;
    from + leave * t + (chord * 3.0 - leave * 2.0 - arrive) * (t * t) + (leave + arrive - chord * 2.0) * (t * t * t)
}

/// A video that is being encoded by the installed ffmpeg. The file appears when it is complete.
pub struct Video<'a> {
    ffmpeg: Running,
    path: &'a Path,
    /// Holds the unfinished file, and is removed with it.
    folder: TempDir,
}

impl<'a> Video<'a> {
    /// Begins a video of pictures of this size. The name of the file gives its format. An error if ffmpeg is not
    /// installed, with how to install it.
    pub fn begin(path: &'a Path, Intrinsics { width, height, .. }: &Intrinsics, fps: u32) -> Result<Self> {
        let name = path.file_name().with_context(|| format!("{} names no file", path.display()))?;
        ensure!(
            path.extension().is_some(),
            "{} has no extension, which gives the format: end it in .mp4",
            path.display()
        );
        let beside = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        let folder = tempfile::Builder::new().prefix(".splat-video-").tempdir_in(beside);
        let folder = folder.with_context(|| format!("cannot write to {}: fix its permissions", beside.display()))?;
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &format!("{width}x{height}"), "-r", &fps.to_string(), "-i", "-", "-pix_fmt", "yuv420p"]);
        command.arg(folder.path().join(name)).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let ffmpeg = command.spawn().map_err(|error| match error.kind() {
            ErrorKind::NotFound => anyhow!(
                "`--video` needs ffmpeg, and there is no `ffmpeg` on the PATH: install it (`apt install ffmpeg`, `brew install ffmpeg`, or \
                 https://ffmpeg.org/download.html), or give `--out DIR` instead, for pictures"
            ),
            _ => anyhow::Error::from(error).context("cannot run `ffmpeg`: check that it may be executed"),
        })?;
        Ok(Self { ffmpeg: Running(ffmpeg), path, folder })
    }

    /// Adds a picture: RGB, 8 bits each. An error if ffmpeg has ended, with what it says.
    pub fn add(&mut self, rgb: &[u8]) -> Result<()> {
        let written = self.ffmpeg.0.stdin.as_mut().map(|pipe| pipe.write_all(rgb));
        match written {
            Some(Ok(())) => Ok(()),
            _ => self.end().and_then(|()| Err(anyhow!("`ffmpeg` ended before the video did"))),
        }
    }

    pub fn finish(mut self) -> Result<()> {
        self.end()?;
        let written = self.folder.path().join(self.path.file_name().unwrap_or_default());
        fs::rename(written, self.path).with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn end(&mut self) -> Result<()> {
        drop(self.ffmpeg.0.stdin.take());
        let mut said = String::new();
        if let Some(mut pipe) = self.ffmpeg.0.stderr.take() {
            // What is no text is not shown.
            _ = std::io::Read::read_to_string(&mut pipe, &mut said);
        }
        let status = self.ffmpeg.0.wait().context("cannot wait for `ffmpeg`")?;
        ensure!(status.success(), "`ffmpeg` cannot encode {} ({status}): {}", self.path.display(), said.trim());
        Ok(())
    }
}

#[cfg(test)]
mod tests;
