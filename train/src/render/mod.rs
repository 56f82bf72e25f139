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
use splat_model::capture::{Capture, Cut, View, read_keyframes};
use splat_model::effects::background::Background;
use splat_model::gaussians::{Gaussians, values_of};
use splat_model::quantile::quantile;
use splat_op::{Intrinsics, RenderOptions, Splats};

use self::path::Video;
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
    /// Render along a path instead: `orbit`, once around what the cameras of the capture look at, as far away and as high as they are on
    /// average, or the keyframes that the page of `splat view` saved, or a camera_path.json of nerfstudio in the coordinates of the scene
    #[arg(long, value_name = "orbit|FILE", conflicts_with = "view")]
    pub path: Option<PathBuf>,
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
    /// What the pictures show
    #[arg(long, value_enum, default_value_t)]
    pub pass: Pass,
    /// File format of the pictures
    #[arg(long, value_enum, default_value_t)]
    pub format: PictureFormat,
    #[command(flatten)]
    pub show: ShowArgs,
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Pass {
    /// Colours over the background
    #[default]
    Colour,
    /// Mean depth along the camera's z axis in scene units, 0 where nothing is, as R, G and B. PNG and videos show m / (m + depth), times alpha,
    /// with the median m of the first picture
    Depth,
    /// Unit normals in the axes of the world, turned towards the camera, 0 where nothing is. PNG and videos show n / 2 + 0.5
    Normals,
}

/// File format of a picture. Colours are display-referred in all formats, as in photographs, and composited over
/// `--background`. Alpha is the share of the background that is hidden, so colours over black are premultiplied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PictureFormat {
    /// 8-bit RGB
    #[default]
    Png,
    /// 32-bit float RGBA, values as rendered: display-referred, not linear light
    Exr,
    /// NumPy array [height, width, 4], float32, RGBA, values as rendered
    Npy,
}

/// Renders the views, writes the pictures, and prints their paths. Returns the paths. An error if the capture or the
/// scene cannot be read, the view does not exist, or a picture is one of the files that are read or cannot be written.
pub fn run(args: &RenderArgs) -> Result<Vec<PathBuf>> {
    let (device, _) = args.show.device.resolve()?;
    let capture = input::capture(&args.capture)?;
    let views = views(args, &capture)?;
    let (rows, trained, _) = input::rows("--scene", &args.scene, Some(&capture))?;
    let background = args.show.background(&args.scene, &trained)?;
    let format = args.format.to_possible_value();
    let extension = format.as_ref().map_or("", |format| format.get_name());
    let names = pictures::names(views.iter().map(|view| view.name.as_str()), extension);
    let inputs = Inputs::of([&args.scene]).and_capture(&capture);
    let inputs = inputs.and(args.show.file()).and(&args.path);
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
    let options = options.with_expected_depth(args.pass == Pass::Depth).with_normals(args.pass == Pass::Normals);
    // Only depth needs a first picture.
    let mut middle = (args.pass != Pass::Depth).then_some(1.0);
    let splats = Gaussians::from_own_rows(rows, &device)?.splats();
    let counter = progress::counter("rendering", views.len());
    for (view, name) in views.iter().zip(&names) {
        let picture = Rgba::render(&splats, view, &background, &options)
            .with_context(|| format!("cannot render the view {:?}", view.name))?;
        middle = middle.or_else(|| picture.median_depth());
        if let Some(video) = &mut video {
            video.add(&picture.levels(args.pass, middle))?;
        }
        if let Some(out) = &out {
            out.write(name, |file| picture.write(args, middle, file))?;
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
    if let (Some(path), Some(first)) = (&args.path, capture.views.first()) {
        let lens = path::pinhole(&first.intrinsics);
        let cameras = if path.as_os_str() == "orbit" {
            let poses: Vec<DAffine3> = capture.views.iter().map(|view| view.cam_from_world.inverse()).collect();
            path::orbit(&poses, args.frames)?.into_iter().map(|pose| (lens, pose)).collect()
        } else {
            let keyframes = read_keyframes(path).context("`--path` is `orbit` or a file of keyframes")?;
            path::along(&keyframes, capture.origin, &lens, args.frames)
        };
        let view = |(i, (intrinsics, cam_from_world))| View {
            name: format!("{i:04}"),
            image_path: PathBuf::new(),
            intrinsics,
            cam_from_world,
            cut: Cut::Whole,
        };
        return Ok(cameras.into_iter().enumerate().map(view).collect());
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
    /// `[height, width, 4]`: the pass, then alpha.
    values: Vec<f32>,
}

impl Rgba {
    /// Renders the pass of which the options ask for the output.
    fn render(splats: &Splats, view: &View, background: &Background, options: &RenderOptions) -> Result<Self> {
        let Intrinsics { width, height, .. } = view.intrinsics;
        let picture = background.render(splats, &view.intrinsics, &view.cam_from_world, options)?;
        let depth = picture.expected_depth.map(|depth| depth.expand([height, width, 3]));
        let unit = |normals: Tensor<3>| normals.clone() / normals.square().sum_dim(2).sqrt().clamp_min(1e-10);
        let shown = depth.or(picture.normals.map(unit)).unwrap_or(picture.colour);
        Ok(Self { width, height, values: values_of(Tensor::cat(vec![shown, picture.alpha], 2)) })
    }

    /// The median depth of what is more opaque than not, scene units.
    fn median_depth(&self) -> Option<f64> {
        let opaque = self.values.as_chunks::<4>().0.iter().filter(|[.., alpha]| *alpha >= 0.5);
        quantile(&mut opaque.map(|&[depth, ..]| f64::from(depth)).collect::<Vec<_>>(), 0.5)
    }

    /// 8-bit RGB. `middle` is the depth that is shown as half.
    fn levels(&self, pass: Pass, middle: Option<f64>) -> Vec<u8> {
        let middle = middle.unwrap_or(1.0) as f32;
        let shown = |&[r, g, b, alpha]: &[f32; 4]| match pass {
            Pass::Colour => [r, g, b].map(level),
            Pass::Depth => [level(alpha * middle / (middle + r)); 3],
            Pass::Normals => [r, g, b].map(|value| level(0.5 * value + 0.5)),
        };
        self.values.as_chunks().0.iter().flat_map(shown).collect()
    }

    fn write(self, args: &RenderArgs, middle: Option<f64>, file: &mut BufWriter<File>) -> Result<()> {
        const LENGTH: &str = "a picture has four values per pixel";
        // The largest side of a camera fits a u32.
        let (width, height) = (self.width as u32, self.height as u32);
        match args.format {
            PictureFormat::Png => {
                let picture = RgbImage::from_raw(width, height, self.levels(args.pass, middle)).context(LENGTH)?;
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
