//! Compares LPIPS with the authors' package on every device. `tests/lpips/reference.py` computed the values, with weights and
//! pictures by the formulas in this file.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::Value;
use splat_model::metrics::lpips::Lpips;
use splat_op::is_gpu;
use splat_tests::devices;

const REFERENCE: &str = include_str!("../lpips/reference.json");

/// Relative tolerance. The longest sums of products have 512 · 3 · 3 terms, whose random roundings of 2⁻²⁴ grow with the square root
/// of their number. A value is a mean over many such sums. The package's own f32 is within 4e-7 of its f64.
const TOLERANCE: f64 = 68.0 / (1 << 24) as f64;

/// Largest picture on a GPU, because a driver in software is slow.
const MOST_PIXELS_ON_A_GPU: usize = 128 * 128;

/// Largest picture on `ndarray`, which this workspace compiles without optimisation.
const MOST_PIXELS_ON_NDARRAY: usize = 40 * 40;

/// Hashes an index to 0 to 2²⁴ − 1.
fn mixed(seed: u32, i: usize) -> u32 {
    let mut x = (i as u32).wrapping_mul(0x9E37_79B9).wrapping_add(seed);
    x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    (x ^ (x >> 16)) >> 8
}

/// Hashes a name by FNV-1a.
fn seed_of(name: &str) -> u32 {
    name.bytes().fold(0x811C_9DC5, |seed, byte| (seed ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

fn weights(name: &str, shape: &[usize]) -> Vec<u8> {
    let (seed, count) = (seed_of(name), shape.iter().product());
    let bound = match shape.len() {
        4 => (6.0 / shape[1..].iter().product::<usize>() as f64).sqrt(),
        _ => 0.1,
    };
    let value = |i: usize| match name.starts_with("lin") {
        true => mixed(seed, i) as f32 / (1 << 24) as f32 * 0.2,
        false => (mixed(seed, i) as f32 / (1 << 23) as f32 - 1.0) * bound as f32,
    };
    (0..count).flat_map(|i| value(i).to_le_bytes()).collect()
}

/// Writes the file of a network, with an additional tensor that readers must ignore.
fn write(shapes: &Value, path: &Path) {
    let shapes: BTreeMap<String, Vec<usize>> = serde_json::from_value(shapes.clone()).unwrap();
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = shapes
        .into_iter()
        .map(|(name, shape)| (weights(&name, &shape), name, shape))
        .map(|(w, n, s)| (n, s, w))
        .collect();
    tensors.push(("scaling_layer.shift".into(), vec![1, 3, 1, 1], vec![0; 12]));
    let views =
        tensors.iter().map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    safetensors::serialize_to_file(views, None, path).unwrap();
}

/// Creates two pictures, `[H, W, 3]`, with byte values.
fn pictures(pair: &str, height: usize, width: usize, device: &Device) -> [Tensor<3>; 2] {
    let noise = |seed: u32, i: usize, levels: u32| i64::from(mixed(seed, i) % levels);
    let place = |i: usize| (i as i64 / 3 / width as i64, i as i64 / 3 % width as i64, i as i64 % 3);
    let truth = |i: usize| {
        let (y, x, c) = place(i);
        (3 * x + 2 * y + 40 * c + noise(1, i, 48)) % 256
    };
    let image = |i: usize| match pair {
        "equal" => truth(i),
        "noisy" => (truth(i) + noise(2, i, 61) - 30).clamp(0, 255),
        "other" => (5 * place(i).0 + noise(3, i, 200)) % 256,
        other => panic!("no pair {other}"),
    };
    let tensor = |of: &dyn Fn(usize) -> i64| {
        let values: Vec<f32> = (0..3 * height * width).map(|i| of(i) as f32 / 255.0).collect();
        Tensor::from_data(TensorData::new(values, [height, width, 3]), device)
    };
    [tensor(&image), tensor(&truth)]
}

#[test]
fn values_are_those_of_the_authors_package() {
    let reference: Value = serde_json::from_str(REFERENCE).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for (net, shapes) in reference["networks"].as_object().unwrap() {
        let path = folder.path().join(format!("{net}.safetensors"));
        write(shapes, &path);
        for (device_name, device) in devices() {
            let (most_pixels, fewest_cases) = match () {
                () if is_gpu(&device) => (MOST_PIXELS_ON_A_GPU, 4),
                () if device_name == "ndarray" => (MOST_PIXELS_ON_NDARRAY, 2),
                () => (usize::MAX, 5),
            };
            let mut compared = 0;
            for case in reference["cases"]
                .as_array()
                .unwrap()
                .iter()
                .filter(|case| case["net"] == **net && case["input"] == "-1..1")
            {
                let [height, width] = ["height", "width"].map(|key| case[key].as_u64().unwrap() as usize);
                if height * width > most_pixels {
                    continue;
                }
                let lpips = Lpips::read(&path, &device).unwrap();
                assert_eq!(lpips.net().name(), net);
                let [image, truth] = pictures(case["pair"].as_str().unwrap(), height, width, &device);
                let found = lpips.distance(image, truth).unwrap();
                let expected = case["f64"].as_f64().unwrap();
                let error = (found - expected).abs();
                println!("{device_name} {net} {height} x {width}: {found} {:.1e}", error / expected);
                assert!(error <= TOLERANCE * expected, "{device_name}: {found}, expected {case}");
                compared += 1;
            }
            assert!(compared >= fewest_cases, "{device_name}: {compared} cases");
        }
    }
}
