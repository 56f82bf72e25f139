//! `splat render`: renders a scene from the cameras of a capture, or along a path.

mod path;

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};
use burn::tensor::Tensor;
use clap::builder::RangedU64ValueParser;
use clap::{ValueEnum, value_parser};
use glam::DAffine3;
use image::{ImageFormat, RgbImage, Rgba32FImage};
use npyz::WriterBuilder;
use splat_model::capture::{Capture, Cut, View};
use splat_model::effects::background::Background;
use splat_model::gaussians::{Gaussians, values_of};
use splat_op::{RenderOptions, Splats};

use self::path::{CameraPath, Video};
use crate::accuracy::AccuracyArgs;
use crate::background::ShowArgs;
use crate::inputs::Inputs;
use crate::output::{OutputFolder, prepare_file};
use crate::report::pictures::{self, level};
use crate::{input, progress};

/// Value of `--view` for all views.
const ALL: &str = "all";

/// Options of `splat render`.
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArgs {
    /// Scene file, in any format that `convert` reads
    #[arg(long, value_name = "FILE")]
    pub scene: PathBuf,
    /// Capture whose cameras to render from; its photographs are needed only if nothing else gives their sizes
    #[arg(long, value_name = "CAPTURE")]
    pub capture: PathBuf,
    /// Name of a photograph in the capture, or `all`
    #[arg(long, value_name = "NAME", required_unless_present = "path")]
    pub view: Option<String>,
    /// Render along a path instead, by cameras that are no photographs'
    #[arg(long, value_enum, value_name = "PATH", conflicts_with = "view")]
    pub path: Option<CameraPath>,
    /// Number of pictures of `--path`
    #[arg(long, value_name = "N", default_value_t = 240, value_parser = RangedU64ValueParser::<usize>::new().range(1..=100_000))]
    pub frames: usize,
    /// Pictures a second of `--video`
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = value_parser!(u32).range(1..=1000))]
    pub fps: u32,
    /// Folder for the pictures, which are named after the photographs
    #[arg(long, value_name = "DIR", required_unless_present = "video")]
    pub out: Option<PathBuf>,
    /// Write the pictures of `--path` as a video such as orbit.mp4 with the installed ffmpeg
    #[arg(long, value_name = "FILE", requires = "path", conflicts_with_all = ["out", "format"])]
    pub video: Option<PathBuf>,
    /// File format of the pictures
    #[arg(long, value_enum, default_value_t)]
    pub format: PictureFormat,
    #[command(flatten)]
    pub show: ShowArgs,
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
}

/// File format of a picture. Values are display-referred in all formats, as in photographs, and composited over
/// `--background`. Alpha is the share of the background that is hidden, so colours over black are premultiplied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PictureFormat {
    /// 8-bit RGB over the background
    #[default]
    Png,
    /// 32-bit float RGBA over the background, values as rendered: display-referred, not linear light
    Exr,
    /// NumPy array [height, width, 4], float32, RGBA over the background, values as rendered
    Npy,
}

/// Renders the views, writes the pictures, and prints their paths. Returns the paths. An error if the capture or the
/// scene cannot be read, the view does not exist, or a picture is one of the files that are read or cannot be written.
pub fn run(args: &RenderArgs) -> Result<Vec<PathBuf>> {
    let (device, _) = args.show.device.resolve()?;
    let capture = input::capture(&args.capture)?;
    let views = views(args, &capture)?;
    let (rows, trained) = input::rows("--scene", &args.scene, Some(&capture))?;
    let background = args.show.background(&args.scene, &trained)?;
    let format = args.format.to_possible_value();
    let extension = format.as_ref().map_or("", |format| format.get_name());
    let names = pictures::names(views.iter().map(|view| view.name.as_str()), extension);
    let inputs = Inputs::of([&args.scene]).and_capture(&capture);
    let inputs = inputs.and(args.show.file());
    let mut video = match &args.video {
        Some(path) => {
            prepare_file(path, &inputs)?;
            Some(Video::begin(path, &views[0].intrinsics, args.fps)?)
        }
        None => None,
    };
    let out = args.out.as_ref().map(|out| OutputFolder::prepare(out, inputs, &names, &[])).transpose()?;
    let base = args.show.model.or(&trained).config().render_options(input::extent(&capture));
    let options = args.accuracy.accuracy.setting().apply(base);
    let splats = Gaussians::from_own_rows(rows, &device)?.splats();
    let counter = progress::counter("rendering", views.len());
    for (view, name) in views.iter().zip(&names) {
        let picture = Rgba::render(&splats, view, &background, &options)
            .with_context(|| format!("cannot render the view {:?}", view.name))?;
        if let Some(video) = &mut video {
            video.add(&picture.levels())?;
        }
        if let Some(out) = &out {
            out.write(name, |file| picture.write(args.format, file))?;
        }
        counter.inc(1);
    }
    counter.finish_and_clear();
    video.map_or(Ok(()), Video::finish)?;
    let pictures = out.iter().flat_map(|out| names.iter().map(|name| out.join(name)));
    let paths: Vec<PathBuf> = pictures.chain(args.video.clone()).collect();
    for path in &paths {
        progress::say(&path.display().to_string());
    }
    Ok(paths)
}

/// Returns the views of the path, or the view with the name that was given, or all views. A photograph with the name "all" takes precedence.
fn views(args: &RenderArgs, capture: &Capture) -> Result<Vec<View>> {
    if let (Some(CameraPath::Orbit), Some(first)) = (args.path, capture.views.first()) {
        let poses: Vec<DAffine3> = capture.views.iter().map(|view| view.cam_from_world.inverse()).collect();
        let (intrinsics, image_path) = (path::pinhole(&first.intrinsics), PathBuf::new());
        let view = |(i, cam_from_world)| View {
            name: format!("{i:04}"),
            image_path: image_path.clone(),
            intrinsics,
            cam_from_world,
            cut: Cut::Whole,
        };
        return Ok(path::orbit(&poses, args.frames)?.into_iter().enumerate().map(view).collect());
    }
    let name = args.view.as_deref().unwrap_or(ALL);
    match capture.views.iter().find(|view| view.name == name) {
        Some(view) => Ok(vec![view.clone()]),
        None if name == ALL => Ok(capture.views.clone()),
        None => {
            let (folder, names) = (capture.folder.display(), input::some_names(capture));
            Err(anyhow!("{folder} has no view {name:?}: give `--view` one of its names ({names}) or `all`"))
        }
    }
}

/// A render on the host.
struct Rgba {
    width: usize,
    height: usize,
    /// `[height, width, 4]`: colour over the background, then alpha.
    values: Vec<f32>,
}

impl Rgba {
    fn render(splats: &Splats, view: &View, background: &Background, options: &RenderOptions) -> Result<Self> {
        let picture = background.render(splats, &view.intrinsics, &view.cam_from_world, options)?;
        let values = values_of(Tensor::cat(vec![picture.colour, picture.alpha], 2));
        Ok(Self { width: view.intrinsics.width, height: view.intrinsics.height, values })
    }

    /// 8-bit RGB.
    fn levels(&self) -> Vec<u8> {
        self.values.as_chunks().0.iter().flat_map(|&[r, g, b, _]: &[f32; 4]| [r, g, b].map(level)).collect()
    }

    fn write(self, format: PictureFormat, file: &mut BufWriter<File>) -> Result<()> {
        const LENGTH: &str = "a picture has four values per pixel";
        // The largest side of a camera fits a u32.
        let (width, height) = (self.width as u32, self.height as u32);
        match format {
            PictureFormat::Png => {
                let picture = RgbImage::from_raw(width, height, self.levels()).context(LENGTH)?;
                picture.write_to(file, ImageFormat::Png)?;
            }
            PictureFormat::Exr => {
                let picture = Rgba32FImage::from_raw(width, height, self.values).context(LENGTH)?;
                picture.write_to(file, ImageFormat::OpenExr)?;
            }
            PictureFormat::Npy => {
                let shape = [self.height as u64, self.width as u64, 4];
                let mut array = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
                array.extend(self.values)?;
                array.finish()?;
            }
        }
        Ok(())
    }
}
