//! `splat mesh`: a scene's surface as triangles.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::builder::RangedU64ValueParser;
use clap::value_parser;
use splat_model::capture::View;
use splat_model::formats::write_mesh;
use splat_model::gaussians::Gaussians;
use splat_model::mesh::{MeshOptions, of_splats};

use crate::accuracy::ModelArgs;
use crate::device::DeviceName;
use crate::inputs::Inputs;
use crate::output::prepare_file;
use crate::{input, progress};

/// Options of `splat mesh`.
#[derive(Clone, Debug, clap::Args)]
pub struct MeshArgs {
    /// Scene whose surface to extract, in any format that `convert` reads
    pub scene: PathBuf,
    /// Capture from whose cameras the surface is seen; its photographs are not read
    #[arg(long, value_name = "CAPTURE")]
    pub capture: PathBuf,
    /// Mesh to write, binary glTF (.glb) with colours
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Side of a voxel, scene units; smaller shows more and takes more memory [default: the width of a pixel on the surface]
    #[arg(long, value_name = "SIZE")]
    pub voxel: Option<f64>,
    /// Distance from the surface up to which depths are averaged, voxels; more is smoother
    #[arg(long, value_name = "VOXELS", default_value_t = MeshOptions::default().truncation)]
    pub truncation: f64,
    /// Drop connected pieces of fewer triangles
    #[arg(long, value_name = "TRIANGLES", default_value_t = MeshOptions::default().min_component)]
    pub min_component: usize,
    /// Close the surface: what no view has seen is empty
    #[arg(long)]
    pub watertight: bool,
    /// Use at most this many views, evenly in name order
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub views: usize,
    /// Render depth with this longer side at most, px
    #[arg(long, value_name = "PX", default_value_t = 800, value_parser = value_parser!(u32).range(16..))]
    pub max_side: u32,
    /// Device to render on: auto, cpu, flex, ndarray, gpu, gpu:N and what else `splat devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    pub device: DeviceName,
}

/// Writes the mesh and prints its size. An error if the scene or the capture cannot be read, an option is out of range, the views show no
/// surface, the voxels do not fit into memory, or the file is one of those that are read or cannot be written.
pub fn run(args: &MeshArgs) -> Result<()> {
    let is_glb = args.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("glb"));
    ensure!(is_glb, "{} does not end in .glb, the format of meshes: rename it", args.out.display());
    let (device, _) = args.device.resolve()?;
    let capture = input::capture(&args.capture)?;
    let (rows, trained, _) = input::rows("SCENE", &args.scene, Some(&capture))?;
    prepare_file(&args.out, &Inputs::of([&args.scene]).and_capture(&capture))?;
    let render = ModelArgs::default().or(&trained).config().render_options(input::extent(&capture));
    let count = capture.views.len().min(args.views);
    let views = (0..count).map(|i| &capture.views[i * capture.views.len() / count]);
    let camera = |view: &View| (view.intrinsics_within(Some(args.max_side)), view.cam_from_world);
    let cameras: Vec<_> = views.map(camera).collect();
    let MeshArgs { voxel, truncation, min_component, watertight, .. } = *args;
    let options = MeshOptions { voxel, truncation, min_component, watertight, ..MeshOptions::default() };
    let splats = Gaussians::from_own_rows(rows, &device)?.splats();
    let counter = progress::counter("fusing views", count);
    let mesh = of_splats(&splats, &cameras, &render, &options, || counter.inc(1))
        .with_context(|| format!("cannot make a mesh of {}", args.scene.display()))?;
    counter.finish_and_clear();
    write_mesh(&args.out, &mesh, capture.world_frame()).context("cannot write the mesh")?;
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    progress::say(&format!("{}: {vertices} vertices, {triangles} triangles, from {count} views", args.out.display()));
    Ok(())
}
