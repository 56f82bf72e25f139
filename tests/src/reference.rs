//! Reads the reference vectors: float64 renders and gradients computed with gsplat's PyTorch functions.

use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use splat_op::{CameraModel, Intrinsics, RenderOptions};

use crate::data::optional_data;
use crate::scene::{LossWeights, Named, RenderOutputs, Scene};

/// One reference vector, a file.
pub struct ReferenceVector {
    pub name: String,
    pub scene: Scene,
    pub weights: LossWeights,
    pub options: RenderOptions,
    pub expected: RenderOutputs,
}

/// Reads the vectors of this repository, and the larger vectors in the folder `reference` of `SPLAT_DATA_DIR` if it exists.
///
/// # Panics
/// If a folder holds no vector, or a vector that cannot be read.
pub fn read_vectors() -> Vec<ReferenceVector> {
    // Cargo sets the variable for a test that it runs; `benches/card.sh` sets it where the sources are in another place.
    let package = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    let mut vectors = read_folder(&Path::new(&package).join("reference"));
    if let Some(larger) = optional_data("reference") {
        let named =
            |vector: ReferenceVector| ReferenceVector { name: format!("SPLAT_DATA_DIR {}", vector.name), ..vector };
        vectors.extend(read_folder(&larger).into_iter().map(named));
    }
    vectors
}

fn read_folder(folder: &Path) -> Vec<ReferenceVector> {
    let entries = folder.read_dir().unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let entries = entries.map(|entry| entry.expect("a readable entry").path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|e| e == "safetensors")).collect();
    files.sort();
    assert!(!files.is_empty(), "no .safetensors file in {}", folder.display());
    files.iter().map(|file| read_vector(file)).collect()
}

fn read_vector(path: &Path) -> ReferenceVector {
    let name = path.file_stem().expect("found by its extension").to_string_lossy().into_owned();
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{name}: {error}"));
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
    let metadata = header.metadata().as_ref().unwrap_or_else(|| panic!("{name}: no metadata"));
    let params: Value = serde_json::from_str(&metadata["params"]).unwrap_or_else(|error| panic!("{name}: {error}"));
    let model = match params["camera"].as_str() {
        Some("pinhole") => CameraModel::Pinhole,
        Some("fisheye") => CameraModel::Fisheye,
        other => panic!("{name}: camera {other:?}"),
    };
    let file = SafeTensors::deserialize(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
    let values = |key: &str| -> Vec<f64> {
        let view = file.tensor(key).unwrap_or_else(|error| panic!("{name}: {key}: {error}"));
        assert_eq!(view.dtype(), Dtype::F64, "{name}: {key}");
        view.data().chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect()
    };
    let number = |key: &str| params[key].as_f64().unwrap_or_else(|| panic!("{name}: no `{key}`"));
    let k = values("K");
    let intrinsics =
        Intrinsics::pinhole(number("width") as usize, number("height") as usize, [k[0], k[4]], [k[2], k[5]])
            .with_lens(model, [0.0; 8]);
    let scene = Scene {
        means: values("means"),
        quats: values("quats"),
        scales: values("scales"),
        opacities: values("opacities"),
        sh: values("sh"),
        background: values("background"),
        pose: values("viewmat")[..12].to_vec(),
        intrinsics,
    };
    let options = RenderOptions::standard()
        .with_blur(number("eps2d"))
        .with_near(number("near"))
        .with_jacobian_margin(0.3)
        .with_antialias(params["antialias"].as_bool().unwrap_or_else(|| panic!("{name}: no `antialias`")))
        .with_alpha_min(number("alpha_min"))
        .with_alpha_max(number("alpha_max"))
        .with_transmittance_min(number("t_min"))
        .with_depth(true);
    let degree = number("sh_degree") as usize;
    assert_eq!(scene.coefficients(), (degree + 1) * (degree + 1), "{name}: SH coefficients");
    let named = |name, columns| Named { name, columns, values: values(name) };
    // The operation's poses have no last row.
    let pose = Named { name: "g_viewmat", columns: 4, values: values("g_viewmat")[..12].to_vec() };
    let expected = RenderOutputs {
        stages: vec![named("out_means2d", 2), named("out_depths", 1), named("out_conics", 3), named("out_colors", 3)],
        pictures: vec![named("out_image", 3), named("out_alpha", 1), named("out_depth", 1)],
        gradients: vec![
            named("g_means", 3),
            named("g_quats", 4),
            named("g_scales", 3),
            named("g_opacities", 1),
            named("g_sh", 3 * scene.coefficients()),
            named("g_means2d", 2),
            pose,
            named("g_background", 3),
        ],
    };
    let weights = LossWeights { image: values("w_image"), alpha: values("w_alpha"), depth: values("w_depth") };
    ReferenceVector { name, scene, weights, options, expected }
}
