//! Frames of a video: the sharpest of each interval.
//!
//! The video is decoded twice: in grey and small to measure sharpness, then at full size for the chosen frames alone.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, bail, ensure};
use splat_model::effects::survey::sharpness_of_grey;

use super::cache::{IMAGES, IMAGES_PARTIAL, LOG, Workspace};
use super::failure;
use super::programs::Ffmpeg;
use super::stage::{self, Running};
use crate::progress::CountedProgress;
use crate::stop::{Interrupted, Stop};

/// Longer side of the pictures whose sharpness is measured, px. Blur that matters is wider than its pixels.
const MEASURED_SIDE: u32 = 960;

/// Frames of a video for each frame that is used, without `--frames`: half a second of 30 frames.
const USUAL_INTERVAL: usize = 15;

/// Fewest and most frames that are used without `--frames`. Exhaustive pairs of more would take hours on a CPU.
const USUAL: [usize; 2] = [60, 200];

/// Largest accepted side of a decoded picture, px, and of its header, bytes: beyond them the stream is not what was asked for.
const MAX_SIDE: usize = 16_384;

/// Writes the sharpest frame of each of `frames` equal intervals of a video to `images/` of the workspace, as JPEG, named by its number in
/// the video. Returns the number of frames written.
pub fn extract(
    workspace: &Workspace,
    ffmpeg: &Ffmpeg,
    video: &Path,
    frames: Option<usize>,
    stop: &Stop,
) -> Result<usize> {
    let sharpness = measure(ffmpeg, video, stop)?;
    let wanted = frames.unwrap_or((sharpness.len() / USUAL_INTERVAL).clamp(USUAL[0], USUAL[1]));
    let chosen = sharpest(&sharpness, wanted);
    let partial = workspace.join(IMAGES_PARTIAL);
    workspace.clear(&[IMAGES_PARTIAL])?;
    fs::create_dir_all(&partial).with_context(|| format!("cannot make {}", partial.display()))?;
    let select: Vec<String> = chosen.iter().map(|frame| format!("eq(n\\,{frame})")).collect();
    let mut command = Ffmpeg::reading(video);
    command.args(["-vf", &format!("select={}", select.join("+")), ffmpeg.every_frame, "passthrough"]);
    command.args(["-qmin", "1", "-q:v", "2"]).arg(partial.join("%06d.jpg"));
    let ended = stage::run(command, stop, "while the frames were decoded", &mut workspace.log()?, |_| ())?;
    if !ended.status.success() {
        return Err(failure::ended("ffmpeg", "decoding frames", &ended, &workspace.join(LOG)));
    }
    for (i, frame) in chosen.iter().enumerate() {
        let (from, to) = (partial.join(format!("{:06}.jpg", i + 1)), partial.join(format!("frame_{frame:06}.jpg")));
        // The second name has letters, so that no file is renamed twice.
        fs::rename(&from, &to)
            .with_context(|| format!("ffmpeg decoded the frame {frame} of {} once and not again", video.display()))?;
    }
    workspace.complete(&partial, IMAGES)?;
    Ok(chosen.len())
}

/// The index of the largest value in each of `wanted` equal parts, or of each value if there are fewer.
fn sharpest(sharpness: &[f64], wanted: usize) -> Vec<usize> {
    let parts = wanted.min(sharpness.len());
    let part = |i: usize| i * sharpness.len() / parts..(i + 1) * sharpness.len() / parts;
    let best = |i: usize| part(i).max_by(|&a, &b| sharpness[a].total_cmp(&sharpness[b]));
    (0..parts).filter_map(best).collect()
}

fn measure(ffmpeg: &Ffmpeg, video: &Path, stop: &Stop) -> Result<Vec<f64>> {
    let mut command = Ffmpeg::reading(video);
    let scale = format!(
        "scale=w='if(gt(iw,ih),min(iw,{MEASURED_SIDE}),-2)':h='if(gt(iw,ih),-2,min(ih,{MEASURED_SIDE}))':flags=area,format=gray"
    );
    command.args(["-vf", &scale, ffmpeg.every_frame, "passthrough", "-c:v", "pgm", "-f", "image2pipe", "-"]);
    let mut decoder = Decoder::start(command)?;
    let mut counted = CountedProgress::new("measuring sharpness");
    let mut sharpness = Vec::new();
    while let Some((size, grey)) = next_picture(&mut decoder.frames).context("cannot read what ffmpeg decodes")? {
        if let Some(signal) = stop.asked() {
            let message = "stopped while the sharpness of frames was measured: the same command begins again".into();
            return Err(Interrupted { signal, message }.into());
        }
        // A frame of one colour shows nothing.
        sharpness.push(sharpness_of_grey(&grey, size).unwrap_or(0.0));
        counted.set(sharpness.len(), None);
    }
    counted.finish();
    let said = decoder.end()?;
    ensure!(
        !sharpness.is_empty(),
        "ffmpeg finds no pictures in {}: {}. Name a video, or a folder of photographs",
        video.display(),
        if said.is_empty() { "it says nothing" } else { &said }
    );
    Ok(sharpness)
}

/// ffmpeg, while it decodes to a pipe.
struct Decoder {
    child: Running,
    frames: BufReader<std::process::ChildStdout>,
    said: Option<JoinHandle<String>>,
}

impl Decoder {
    fn start(mut command: Command) -> Result<Self> {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .context("cannot run `ffmpeg`")?;
        let (Some(frames), Some(mut errors)) = (child.stdout.take(), child.stderr.take()) else {
            bail!("ffmpeg has no output");
        };
        let said = thread::spawn(move || {
            let mut text = Vec::new();
            // A pipe that breaks ends the text.
            let _ = errors.read_to_end(&mut text);
            String::from_utf8_lossy(&text).lines().last().unwrap_or_default().to_owned()
        });
        Ok(Self { child: Running(child), frames: BufReader::with_capacity(1 << 20, frames), said: Some(said) })
    }

    /// Waits for the end, and returns the last line of the errors: a damaged end of a video is no reason to refuse the rest.
    fn end(&mut self) -> Result<String> {
        self.child.0.wait().context("cannot wait for `ffmpeg`")?;
        Ok(self.said.take().and_then(|said| said.join().ok()).unwrap_or_default())
    }
}

/// The next picture of a stream in the format PGM with 8 bits (<https://netpbm.sourceforge.net/doc/pgm.html>): size and pixels.
fn next_picture(stream: &mut impl BufRead) -> Result<Option<([usize; 2], Vec<u8>)>> {
    if stream.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut words = Vec::new();
    while words.len() < 4 {
        let mut word = Vec::new();
        // The limit holds back a stream of another kind.
        for byte in stream.by_ref().take(32).bytes() {
            match byte? {
                byte if byte.is_ascii_whitespace() => break,
                byte => word.push(byte),
            }
        }
        words.push(String::from_utf8_lossy(&word).into_owned());
    }
    let size = [&words[1], &words[2]].map(|word| word.parse().ok().filter(|side| (1..=MAX_SIDE).contains(side)));
    let ([Some(width), Some(height)], "P5", "255") = (size, words[0].as_str(), words[3].as_str()) else {
        bail!("expected a grey picture, found {words:?}");
    };
    let mut grey = vec![0; width * height];
    // A video that is cut off ends within a picture.
    Ok(stream.read_exact(&mut grey).is_ok().then_some(([width, height], grey)))
}

#[cfg(test)]
mod tests;
