//! `splat view`: shows a scene in the browser, to turn around and walk through.

pub mod page;
pub mod scene;
pub mod server;

use std::path::PathBuf;

use anyhow::{Context, Result};
use splat_model::ply::TrainedAs;

pub use self::page::{SceneSource, Viewer, document};
pub use self::scene::{ShownScene, Viewpoint};
pub use self::server::{LOCALHOST, ServedFile, Server, Site};
use crate::{input, output, progress};

/// Options of `splat view`.
#[derive(Clone, Debug, clap::Args)]
pub struct ViewArgs {
    /// Scene file, in any format that `convert` reads
    pub scene: PathBuf,
    /// Port of 127.0.0.1 to serve on; 0 chooses a free one
    #[arg(long, value_name = "P", default_value_t = 0)]
    pub port: u16,
}

/// Reads the scene, prints its address, and serves it until the process is ended (Ctrl-C). An error if the file is
/// missing or is not a scene, or the port is not available.
pub fn run(args: &ViewArgs) -> Result<()> {
    // An unavailable port is found before the scene is read, which may take long.
    let server = Server::bind(LOCALHOST, args.port, "--port")?;
    let pages = pages(args)?;
    progress::say(&server.url());
    progress::note(&format!("serving {} on this machine only; Ctrl-C ends it", args.scene.display()));
    server.serve(&pages[..])
}

fn pages(args: &ViewArgs) -> Result<[ServedFile; 2]> {
    const SCENE: &str = "/scene.ply";
    let (rows, TrainedAs { antialias, background, .. }, origin) = input::rows("SCENE", &args.scene, None)?;
    let scene = ShownScene::new(&rows, usize::MAX)
        .with_context(|| format!("{} cannot be shown: name another scene", args.scene.display()))?;
    drop(rows);
    let viewer =
        Viewer { scene: &scene, source: SceneSource::Url(SCENE, origin), viewpoints: &[], background, antialias };
    let name = output::last_name(&args.scene);
    let html = viewer.page(&name)?;
    Ok([
        ServedFile { path: "/", kind: "text/html; charset=utf-8", content: html.into_bytes() },
        ServedFile { path: SCENE, kind: "application/octet-stream", content: scene.ply },
    ])
}
