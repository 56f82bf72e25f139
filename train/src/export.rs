//! `splat export`: a scene as one page with the viewer, for people who have neither this program nor a server.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, ensure};
use clap::value_parser;
use splat_model::capture::{Capture, View};
use splat_model::effects::background::Background;
use splat_model::formats::{self, Format, SceneFile};
use splat_model::gaussians::GaussianRows;

use crate::background::ShownBackground;
use crate::inputs::Inputs;
use crate::output::prepare_file;
use crate::view::{SceneSource, ShownScene, Viewer, Viewpoint};
use crate::{input, output, progress};

/// Number of views without `--view`, so that their buttons fit into a line.
const VIEWS: usize = 8;

/// Options of `splat export`.
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// Scene to export, in any format that `convert` reads
    pub scene: PathBuf,
    /// Page to write: one file that holds the viewer and the scene, and loads nothing from elsewhere
    #[arg(long, value_name = "FILE")]
    pub html: PathBuf,
    /// Capture whose photographs become views, with a button each
    #[arg(long, value_name = "CAPTURE")]
    pub views: Option<PathBuf>,
    /// Photograph of `--views` that becomes a view, with the text of its button after `=`; repeatable [default: eight photographs,
    /// evenly in name order]
    #[arg(long = "view", value_name = "PHOTO[=TEXT]", requires = "views")]
    pub view: Vec<String>,
    /// Title of the page [default: the name of the scene's file]
    #[arg(long)]
    pub title: Option<String>,
    /// Drop spherical harmonics above this degree, which makes the page smaller
    #[arg(long, value_name = "DEGREE", value_parser = value_parser!(u8).range(0..=3))]
    pub sh_degree: Option<u8>,
    /// Background: black, white or R,G,B from 0 to 1, or the background.json of a run that learned a colour [default: that of the scene's
    /// training]
    #[arg(long, value_name = "COLOUR")]
    pub background: Option<ShownBackground>,
}

/// Writes the page and prints its size. An error if the scene or the capture cannot be read, a view is not one of the
/// capture, or the page is one of the files that are read or cannot be written.
pub fn run(args: &ExportArgs) -> Result<()> {
    let capture = args.views.as_deref().map(input::capture).transpose()?;
    let viewpoints = capture.as_ref().map(|capture| viewpoints(capture, &args.view)).transpose()?.unwrap_or_default();
    let (rows, trained, _) = input::rows("SCENE", &args.scene, capture.as_ref())?;
    let Background::Colour(background) = ShownBackground::read(args.background.as_ref(), &args.scene, &trained)? else {
        return Err(anyhow!(
            "the page shows a background of one colour: give `--background` a colour such as black or 0.5,0.5,0.5"
        ));
    };
    let inputs = Inputs::of([&args.scene]).and(args.background.as_ref().and_then(ShownBackground::file));
    prepare_file(&args.html, &capture.iter().fold(inputs, Inputs::and_capture))?;
    let degree = rows.sh_degree.min(args.sh_degree.map_or(Format::Sog.sh_degree_max(), usize::from));
    let rows = input::selected(&rows, 0..rows.len(), degree);
    let shown = ShownScene::new(&rows, usize::MAX)
        .with_context(|| format!("{} cannot be shown: name another scene", args.scene.display()))?;
    let sog = compressed(rows)?;
    let viewer = Viewer {
        scene: &shown,
        source: SceneSource::Whole(&sog),
        viewpoints: &viewpoints,
        background,
        antialias: trained.antialias,
    };
    let name = output::last_name(&args.scene);
    let page = viewer.page(args.title.as_deref().unwrap_or(&name))?;
    output::write(&args.html, |file| Ok(file.write_all(page.as_bytes())?))?;
    progress::say(&format!(
        "{}: {} bytes, of which the scene has {}; {} splats of degree {}, {} views",
        args.html.display(),
        page.len(),
        sog.len().div_ceil(3) * 4,
        shown.splats,
        shown.sh_degree,
        viewpoints.len()
    ));
    Ok(())
}

/// The scene as SOG, the smallest of the formats that the viewer reads.
fn compressed(rows: GaussianRows) -> Result<Vec<u8>> {
    let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
    let path = folder.path().join("scene.sog");
    formats::write(&path, &SceneFile { rows, ..SceneFile::default() }, Format::Sog)
        .context("cannot compress the scene")?;
    fs::read(&path).context("cannot read the compressed scene")
}

/// The viewpoints of the wanted photographs, with the names of their buttons.
fn viewpoints(capture: &Capture, wanted: &[String]) -> Result<Vec<Viewpoint>> {
    let of = |view: &View| Viewpoint::of(&view.name, &view.intrinsics, &view.cam_from_world);
    if wanted.is_empty() {
        let count = capture.views.len().min(VIEWS);
        return Ok((0..count).map(|i| of(&capture.views[i * capture.views.len() / count])).collect());
    }
    let found = |name: &str| capture.views.iter().find(|view: &&View| view.name == name);
    let one = |wanted: &String| {
        // A photograph's name may hold the sign too.
        let named = found(wanted).map(|view| (view, wanted.as_str()));
        let named = named.or_else(|| wanted.split_once('=').and_then(|(name, text)| Some((found(name)?, text))));
        let (view, text) = named.ok_or_else(|| {
            let (folder, names) = (capture.folder.display(), input::some_names(capture));
            anyhow!(
                "{folder} has no view {wanted:?}: give `--view` one of its names ({names}), and after `=` the text of the button"
            )
        })?;
        ensure!(!text.is_empty(), "`--view {wanted}` has no text after `=`: add one, or leave the sign out");
        Ok(Viewpoint { name: text.to_owned(), ..of(view) })
    };
    wanted.iter().map(one).collect()
}
