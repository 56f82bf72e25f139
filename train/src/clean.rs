//! `splat clean`: removes splats that do a scene no good, and reports what each kind cost.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use burn::tensor::Device;
use splat_model::capture::{Capture, Photo};
use splat_model::cleanup::{Contribution, ISOLATED, isolated};
use splat_model::effects::background::Background;
use splat_model::evaluate::evaluate;
use splat_model::formats::{self, SceneFile};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_op::RenderOptions;

use crate::background::ShowArgs;
use crate::convert::{describe_file, format_of};
use crate::input::PhotoArgs;
use crate::inputs::Inputs;
use crate::output::prepare_file;
use crate::{input, progress};

/// Options of `splat clean`. Splats that cannot be rendered are always removed. With a capture and no choice of what to remove, those
/// that no view shows and floaters are.
#[derive(Clone, Debug, clap::Args)]
pub struct CleanArgs {
    /// Scene to clean, in any format that `convert` reads; it stays as it is
    pub scene: PathBuf,
    /// File to write, replacing an existing one; its name gives the format, as for `convert`
    pub out: PathBuf,
    /// Capture whose cameras say what is seen, and on whose held-out photographs the cost is measured
    #[arg(long, value_name = "CAPTURE")]
    pub capture: Option<PathBuf>,
    /// Remove splats whose centres are outside the box between two corners, in the coordinates of the scene file
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    pub crop: Option<CropBox>,
    /// Remove splats that no view of the capture shows: they change no pixel by half a level of 255
    #[arg(long, requires = "capture")]
    pub unseen: bool,
    /// Remove floaters: splats three times as far from their neighbours as the closest quarter of these is from theirs, and never the
    /// front of a view
    #[arg(long, requires = "capture")]
    pub floaters: bool,
    /// Keep at most this many splats: those that contribute most to the pictures of all views
    #[arg(long, value_name = "N", requires = "capture", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_splats: Option<u32>,
    #[command(flatten)]
    pub photos: PhotoArgs,
    #[command(flatten)]
    pub show: ShowArgs,
}

/// A box along the axes of the scene file, between any two opposite corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CropBox([[f32; 3]; 2]);

impl FromStr for CropBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        let corners: Option<[f32; 6]> = numbers.and_then(|numbers| numbers.try_into().ok());
        let [a, b, c, d, e, f] = corners
            .filter(|corners| corners.iter().all(|x| !x.is_nan()))
            .ok_or("expected the six coordinates of two corners, such as -1,-1,-1,1,1,1")?;
        Ok(Self([[a.min(d), b.min(e), c.min(f)], [a.max(d), b.max(e), c.max(f)]]))
    }
}

impl CropBox {
    fn holds(&self, mean: &[f32; 3]) -> bool {
        let Self([low, high]) = self;
        (0..3).all(|axis| mean[axis] >= low[axis] && mean[axis] <= high[axis])
    }
}

/// A capture with what renders of it need.
struct CleanupJudge<'a> {
    capture: &'a Capture,
    /// The scene, with positions relative to the origin of the capture.
    rows: GaussianRows,
    /// Photographs on which the cost is measured.
    photos: Vec<Photo>,
    background: Background,
    options: RenderOptions,
    device: Device,
    max_side: Option<u32>,
}

impl<'a> CleanupJudge<'a> {
    fn new(args: &CleanArgs, capture: &'a Capture, scene: &SceneFile) -> Result<Self> {
        let (device, _) = args.show.device.resolve()?;
        let background = args.show.background(&args.scene, &scene.trained)?;
        let mut rows = scene.rows.clone();
        input::move_means(&mut rows, (scene.origin - capture.origin).to_array());
        let (split, _) = args.photos.split(capture);
        let all: Vec<usize> = (0..capture.views.len()).collect();
        let judged = if split.test.is_empty() { &all } else { &split.test };
        let photos = input::photographs(capture, judged, args.photos.max_side, false)?;
        let options = args.show.model.or(&scene.trained).config().render_options(input::extent(capture));
        Ok(Self { capture, rows, photos, background, options, device, max_side: args.photos.max_side })
    }

    fn some(&self, kept: &[usize]) -> GaussianRows {
        input::selected(&self.rows, kept.iter().copied(), self.rows.sh_degree)
    }

    /// Mean PSNR of the photographs, dB.
    fn psnr(&self, kept: &[usize]) -> Result<f64> {
        let splats = Gaussians::from_rows(&self.some(kept), &self.device)?.splats();
        Ok(evaluate(&splats, &self.photos, &self.background, &self.options, |_, _| ())?.psnr)
    }

    fn contribution(&self, kept: &[usize]) -> Result<Contribution> {
        let views = &self.capture.views;
        let counter = progress::counter("rendering the views", views.len());
        let cameras = views.iter().map(|view| (view.intrinsics_within(self.max_side), view.cam_from_world));
        Ok(Contribution::of(&self.some(kept), cameras, &self.options, &self.device, || counter.inc(1))?)
    }
}

/// Rows that are left, and the score that they have.
struct KeptRows<'a> {
    rows: Vec<usize>,
    judge: Option<&'a CleanupJudge<'a>>,
    psnr: Option<f64>,
}

impl KeptRows<'_> {
    /// Keeps the rows at the places for which `keeps` holds, and prints how many were removed and what that cost.
    fn retain(&mut self, what: &str, keeps: impl Fn(usize, usize) -> bool) -> Result<()> {
        let before = self.rows.len();
        let mut places = 0..before;
        self.rows.retain(|&row| places.next().is_some_and(|place| keeps(place, row)));
        let removed = before - self.rows.len();
        ensure!(!self.rows.is_empty(), "no splat would be left: all of the last {removed} {what}");
        let mut cost = String::new();
        if let (Some(judge), Some(psnr)) = (self.judge, self.psnr) {
            let now = if removed > 0 { judge.psnr(&self.rows)? } else { psnr };
            cost = format!(": {:+.3} dB", now - psnr);
            self.psnr = Some(now);
        }
        progress::say(&format!("removed {removed} that {what}{cost}"));
        Ok(())
    }
}

/// Writes the scene without the splats that are to be removed, and prints what each kind cost. An error if the scene or the capture cannot
/// be read, there is nothing to remove by, no splat would be left, the file is one of those that are read, or cannot be written.
pub fn run(args: &CleanArgs) -> Result<()> {
    let format = format_of(&args.out)?;
    ensure!(
        args.crop.is_some() || args.capture.is_some(),
        "nothing says what to remove: give `--box`, or `--capture` to find splats that no view shows and floaters"
    );
    let (mut scene, found) = formats::read(&args.scene).context("cannot read the scene")?;
    scene.rows.check()?;
    let capture = args.capture.as_deref().map(input::capture).transpose()?;
    let inputs = Inputs::of([&args.scene]).and(args.show.file());
    prepare_file(&args.out, &capture.iter().fold(inputs, Inputs::and_capture))?;
    let judge = capture.as_ref().map(|capture| CleanupJudge::new(args, capture, &scene)).transpose()?;
    progress::say(&describe_file(&args.scene, found, scene.rows.len(), scene.rows.sh_degree)?);

    let all: Vec<usize> = (0..scene.rows.len()).collect();
    let psnr = judge.as_ref().map(|judge| judge.psnr(&all)).transpose()?;
    let mut kept = KeptRows { rows: all, judge: judge.as_ref(), psnr };
    if scene.rows.unusable() > 0 {
        kept.retain("cannot be rendered", |_, row| scene.rows.is_usable(row))?;
    }
    if let Some(crop) = &args.crop {
        kept.retain("are outside the box", |_, row| crop.holds(&scene.rows.means[row]))?;
    }
    if let Some(judge) = &judge {
        by_views(args, judge, &mut kept)?;
    }
    let photos = judge.as_ref().map_or(0, |judge| judge.photos.len());
    if let (Some(before), Some(after)) = (psnr, kept.psnr) {
        progress::say(&format!("PSNR of {photos} photographs: {before:.3} dB before, {after:.3} dB after"));
    }
    scene.rows = input::selected(&scene.rows, kept.rows, scene.rows.sh_degree);
    let written = formats::write(&args.out, &scene, format).context("cannot write the cleaned scene")?;
    progress::say(&describe_file(&args.out, format, written.rows.len(), written.rows.sh_degree)?);
    Ok(())
}

/// Removes what the views of the capture decide.
fn by_views(args: &CleanArgs, judge: &CleanupJudge, kept: &mut KeptRows) -> Result<()> {
    let by_default = args.crop.is_none() && args.max_splats.is_none() && !args.unseen && !args.floaters;
    if args.unseen || by_default {
        let contribution = judge.contribution(&kept.rows)?;
        kept.retain("no view shows", |place, _| !contribution.is_unseen(place))?;
    }
    if args.floaters || by_default {
        let contribution = judge.contribution(&kept.rows)?;
        let alone = isolated(&judge.some(&kept.rows), ISOLATED);
        kept.retain("float in free space", |place, _| !alone[place] || contribution.is_front[place])?;
    }
    if let Some(most) = args.max_splats.map(|most| most as usize).filter(|most| *most < kept.rows.len()) {
        let total = judge.contribution(&kept.rows)?.total_px;
        let mut places: Vec<usize> = (0..total.len()).collect();
        places.sort_by(|&a, &b| total[b].total_cmp(&total[a]));
        let mut stays = vec![false; total.len()];
        places[..most].iter().for_each(|&place| stays[place] = true);
        kept.retain("contribute least", |place, _| stays[place])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
