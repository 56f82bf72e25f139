//! Valid inputs, so small that most mutations change something relevant.

use std::fs;
use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};
use splat_demo::write_model;
use splat_model::capture::{Cut, PointCloud, View};
use splat_model::gaussians::{GaussianRows, GroupOptions, GroupRows};
use splat_model::ply;
use splat_op::{CameraModel, Intrinsics};

/// Returns Gaussians that can all be rendered.
pub fn rows(count: usize, sh_degree: usize) -> GaussianRows {
    let rest = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
    let value = |i: usize| (i as f32 * 0.37).sin();
    GaussianRows {
        means: (0..count).map(|i| [value(i), value(i + 1), value(i + 2)]).collect(),
        rotations: (0..count).map(|i| [1.0, value(i), 0.0, 0.5]).collect(),
        log_scales: vec![[-2.0; 3]; count],
        logit_opacities: (0..count).map(value).collect(),
        sh_dc: vec![[0.1, 0.2, 0.3]; count],
        sh_rest: (0..count * rest).map(value).collect(),
        sh_degree,
        groups: Vec::new(),
    }
}

/// Returns scenes of every encoding, several SH degrees and several number types.
pub fn scenes() -> Vec<Vec<u8>> {
    let binary = |count: usize, degree: usize, origin: DVec3| {
        let mut file = Vec::new();
        ply::write_to(&mut file, &rows(count, degree), origin).expect("into memory");
        file
    };
    let mut seeds = vec![
        binary(3, 0, DVec3::ZERO),
        binary(1, 1, DVec3::new(4e6, -2.5, 1e-3)),
        binary(2, 4, DVec3::ZERO),
        binary(0, 0, DVec3::ZERO),
        binary(40, 0, DVec3::ZERO),
    ];
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let header = |format: &str, rows: usize, of: &dyn Fn(usize) -> &'static str| {
        let properties: String =
            names.split(' ').enumerate().map(|(i, name)| format!("property {} {name}\n", of(i))).collect();
        format!("ply\nformat {format} 1.0\nelement vertex {rows}\n{properties}end_header\n")
    };
    let ascii = header("ascii", 2, &|_| "float") + &"0.5 1 -2 0 0 0 1.5 -3 -3 -3 1 0 0 0\n".repeat(2);
    seeds.push(ascii.into_bytes());
    // Limits of valid values, as converters write them: opacities of 1 and 0, and flat splats.
    let flat = GaussianRows {
        logit_opacities: vec![f32::INFINITY, f32::NEG_INFINITY, 1.0],
        log_scales: vec![[-2.0, -2.0, f32::NEG_INFINITY], [-2.0; 3], [-2.0; 3]],
        ..rows(3, 0)
    };
    let mut file = Vec::new();
    ply::write_to(&mut file, &flat, DVec3::ZERO).expect("into memory");
    seeds.push(file);
    // Further groups of parameters.
    let group = |name: &str, width: usize| {
        let values = (0..2 * width).map(|i| i as f32).collect();
        GroupRows { name: name.into(), width, values, options: GroupOptions::default() }
    };
    let mut file = Vec::new();
    let groups = vec![group("features", 3), group("label", 1), group("odd_2", 1)];
    ply::write_to(&mut file, &GaussianRows { groups, ..rows(2, 1) }, DVec3::ZERO).expect("into memory");
    seeds.push(file);
    // A file with another element, which has a list, before the Gaussians, and with numbers of all types.
    let types = ["double", "float", "int", "uint", "short", "ushort", "char", "uchar"];
    let before = "element face 2\nproperty list uchar int vertex_indices\n";
    let mixed = header("ascii", 1, &|i| types[i % 8]).replace("element vertex", &format!("{before}element vertex"));
    let mixed = mixed.replace("1.0\n", "1.0\ncomment splat origin 1 2.5 -3e6\nobj_info made by hand\n");
    seeds.push((mixed + "3 0 1 2\n0\n1 2 3 4 5 6 7 8 9 1 2 3 4 5\n").into_bytes());
    let mut big = header("binary_big_endian", 2, &|_| "float").into_bytes();
    (0..28).for_each(|i| big.extend((i as f32).to_be_bytes()));
    seeds.push(big);
    let mut bytes = header("binary_little_endian", 3, &|_| "uchar").into_bytes();
    bytes.extend([7; 42]);
    seeds.push(bytes);
    seeds
}

/// A COLMAP model of three photographs and four points in both encodings: `cameras`, `images` and `points3D`.
pub struct SeedModel {
    pub binary: [Vec<u8>; 3],
    pub text: [Vec<u8>; 3],
}

/// Writes the model and reads its bytes.
pub fn model(folder: &Path) -> SeedModel {
    let view = |i: usize| View {
        name: format!("{i:02}.png"),
        image_path: folder.join("images"),
        intrinsics: match i {
            2 => {
                let distortion = [0.1, -0.05, 1e-3, -2e-3, 0.0, 0.0, 0.0, 0.0];
                Intrinsics::centred(40, 30, 51.0).with_lens(CameraModel::OpenCv, distortion)
            }
            _ => Intrinsics::centred(40, 30, 50.0),
        },
        cam_from_world: DAffine3::from_rotation_translation(
            DQuat::from_rotation_y(0.3 * i as f64),
            DVec3::new(0.1, -0.2, 4.0 + i as f64),
        ),
        cut: Cut::Whole,
    };
    let points = PointCloud {
        positions: (0..4).map(|i| [i as f32, 0.5, -1.0]).collect(),
        colours: (0..4).map(|i| [i, 100, 255]).collect(),
    };
    write_model(folder, &[0, 1, 2].map(view), &points, &Default::default()).expect("the folder can be written to");
    let read = |name: &str| fs::read(folder.join("sparse/0").join(name)).expect("written above");
    // The last photograph gets two keypoints, and the last point gets two observations in it
    // and one elsewhere.
    let [cameras, mut images, mut points] = ["cameras.bin", "images.bin", "points3D.bin"].map(read);
    images.truncate(images.len() - 8);
    images.extend(2_u64.to_le_bytes());
    for point in [4, u64::MAX] {
        images.extend([1.5_f64.to_le_bytes(), 2.5_f64.to_le_bytes(), point.to_le_bytes()].concat());
    }
    points.truncate(points.len() - 8);
    points.extend(3_u64.to_le_bytes());
    points.extend([3_u32, 0, 3, 1, 77, 0].map(u32::to_le_bytes).concat());
    let text = [
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 40 30 50 50.5 20 15\n2 SIMPLE_PINHOLE 40 30 51 20 15\n\
         3 SIMPLE_RADIAL 40 30 51 20 15 0.1\n",
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n1 1 0 0 0 0.1 -0.2 4 1 00.png\n10.5 11.5 -1 3 4 2\n\
         2 0.9 0 0.1 0 0 0 4 1 sub/01.png\n\n3 0.8 0.1 0 0 1e3 0 4 2 02 with blanks.png\n1 2 3\n",
        "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n1 0 0.5 -1 0 100 255 0.7 1 0 2 0\n2 1e-3 2 3 9 8 7 -1\n",
    ];
    SeedModel { binary: [cameras, images, points], text: text.map(|text| text.as_bytes().to_vec()) }
}

/// Returns JSON files that the program writes and reads again.
pub fn json() -> Vec<Vec<u8>> {
    let config = serde_json::to_string_pretty(&splat_model::trainer::TrainConfig::default()).expect("plain data");
    [&config, r#"{"steps": 5}"#, "{}"].map(|text| text.as_bytes().to_vec()).to_vec()
}
