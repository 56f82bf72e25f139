use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use burn::tensor::{Distribution, TensorData};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use tempfile::TempDir;

use super::*;
use crate::FileError;

/// Tensors by name: shape and values.
pub(crate) type NamedTensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Random weights, scaled so that features keep their magnitude.
pub(crate) fn tensors(net: Net) -> NamedTensors {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut tensors = NamedTensors::new();
    let mut add = |name: String, shape: Vec<usize>, range: std::ops::Range<f32>| {
        let values = (0..shape.iter().product()).map(|_| rng.random_range(range.clone())).collect();
        tensors.insert(name, (shape, values));
    };
    let mut channels = 3;
    for (tap, slice) in net.slices().into_iter().enumerate() {
        for layer in slice {
            let NetworkLayer { convolution: Some((number, out)), side, .. } = *layer else {
                continue;
            };
            let bound = (6.0 / (channels * side * side) as f32).sqrt();
            let name = |what| format!("net.slice{}.{number}.{what}", tap + 1);
            add(name("weight"), vec![out, channels, side, side], -bound..bound);
            add(name("bias"), vec![out], -0.1..0.1);
            channels = out;
        }
        add(format!("lin{tap}.model.1.weight"), vec![1, channels, 1, 1], 0.0..0.2);
    }
    tensors
}

/// Writes tensors to a file, and returns it with its folder.
fn file(tensors: &NamedTensors) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let views = tensors.iter().map(|(name, (shape, values))| {
        (name, TensorView::new(Dtype::F32, shape.clone(), bytemuck::cast_slice(values)).unwrap())
    });
    safetensors::serialize_to_file(views, None, &path).unwrap();
    (folder, path)
}

pub(crate) fn read(tensors: &NamedTensors) -> Result<Lpips, FileError> {
    let (_folder, path) = file(tensors);
    Lpips::read(&path, &Device::flex())
}

fn noise(height: usize, width: usize) -> Tensor<3> {
    Tensor::random([height, width, 3], Distribution::Uniform(0.0, 1.0), &Device::flex())
}

#[test]
fn a_picture_in_parts_has_the_value_of_the_whole() {
    // Parts of the least size, at most one grid cell wide, and one that leaves a remainder.
    for (net, height, width, most) in
        [(Net::Alex, 40, 333, 80 + 96 + 16), (Net::Alex, 230, 45, 208), (Net::Vgg, 20, 260, 224)]
    {
        let whole = read(&tensors(net)).unwrap();
        let in_parts = Lpips { most, ..whole.clone() };
        assert!(parts(net, height.max(width), most).len() > 1);
        let (image, truth) = (noise(height, width), noise(height, width));
        let expected = whole.distance(image.clone(), truth.clone()).unwrap();
        let found = in_parts.distance(image, truth).unwrap();
        // The features are the same; their sums are in another order.
        assert!((found / expected - 1.0).abs() < 1e-6 && expected > 1e-3, "{net:?}: {found}, {expected}");
    }
}

#[test]
fn equal_pictures_are_at_no_distance_and_others_are() {
    let lpips = read(&tensors(Net::Alex)).unwrap();
    let (image, other) = (noise(48, 40), noise(48, 40));
    assert_eq!(lpips.distance(image.clone(), image.clone()), Ok(0.0));
    let found = lpips.distance(image.clone(), other.clone()).unwrap();
    assert!(found > 1e-3);
    assert_eq!(lpips.distance(other, image.clone()), Ok(found));
    // Values outside the range of a screen are clamped.
    assert_eq!(lpips.distance(image.clone() * 0.0 + 7.0, image.clone() * 0.0 + 1.0), Ok(0.0));
}

#[test]
fn what_is_not_finite_is_no_number() {
    let lpips = read(&tensors(Net::Alex)).unwrap();
    for value in [f32::NAN, f32::INFINITY] {
        let mut values = vec![0.5; 40 * 40 * 3];
        values[1234] = value;
        let broken = Tensor::from_data(TensorData::new(values, [40, 40, 3]), &Device::flex());
        assert!(lpips.distance(broken, noise(40, 40)).unwrap().is_nan());
    }
}

#[test]
fn pictures_without_features_are_refused() {
    let lpips = read(&tensors(Net::Alex)).unwrap();
    for (height, width) in [(30, 64), (64, 30), (1, 1)] {
        let error = lpips.distance(noise(height, width), noise(height, width)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains(&format!("{width} x {height}")) && message.contains("31 px"), "{message}");
    }
    assert!(lpips.distance(noise(31, 31), noise(31, 31)).is_ok());
}

/// The error message for a file after a change to its tensors.
fn refusal(change: impl FnOnce(&mut NamedTensors)) -> String {
    let mut tensors = tensors(Net::Alex);
    change(&mut tensors);
    let message = read(&tensors).expect_err("the weights are wrong").to_string();
    assert!(message.contains("weights.safetensors") && message.contains("docs/METRICS.md"), "{message}");
    message
}

#[test]
fn wrong_weights_are_named() {
    let has = |message: String, parts: &[&str]| {
        parts.iter().for_each(|part| assert!(message.contains(part), "{part:?} is missing: {message}"));
    };
    has(
        refusal(|tensors| _ = tensors.remove("net.slice3.6.bias")),
        &["`net.slice3.6.bias`", "alex", "missing", "[384]"],
    );
    has(refusal(|tensors| _ = tensors.remove("lin4.model.1.weight")), &["`lin4.model.1.weight`", "[1, 256, 1, 1]"]);
    let flat = |tensors: &mut NamedTensors| {
        _ = tensors.insert("net.slice2.3.weight".into(), (vec![192, 1600], vec![0.0; 192 * 1600]))
    };
    has(refusal(flat), &["`net.slice2.3.weight`", "[192, 1600]", "[192, 64, 5, 5]"]);
    has(
        refusal(|tensors| tensors.get_mut("net.slice5.10.weight").unwrap().1[7] = f32::NAN),
        &["NaN as value 7", "finite"],
    );
    has(
        refusal(|tensors| tensors.get_mut("lin0.model.1.weight").unwrap().1[63] = -0.5),
        &["-0.5 as value 63", "negative"],
    );
    has(refusal(NamedTensors::clear), &["no tensors", "net.slice1.0.weight"]);
    let renamed = |tensors: &mut NamedTensors| {
        let first = tensors.remove("net.slice1.0.weight").unwrap();
        tensors.insert("features\u{1b}[2J.0.weight".into(), first);
    };
    has(refusal(renamed), &["no `net.slice1.0.weight`", "`features\u{fffd}[2J.0.weight`", "vgg"]);
    let squeeze = |tensors: &mut NamedTensors| {
        _ = tensors.insert("lin5.model.1.weight".into(), (vec![1, 512, 1, 1], vec![0.0; 512]))
    };
    has(refusal(squeeze), &["squeeze"]);
    let other = |tensors: &mut NamedTensors| {
        _ = tensors.insert("net.slice1.0.weight".into(), (vec![64, 3, 7, 7], vec![0.0; 64 * 3 * 49]))
    };
    has(refusal(other), &["[64, 3, 7, 7]", "alex", "vgg"]);
}

#[test]
fn other_types_and_other_files_are_refused() {
    let (folder, path) = file(&tensors(Net::Alex));
    let read = || Lpips::read(&path, &Device::flex());
    let says = |part: &str| read().is_err_and(|error| error.to_string().contains(part));
    let whole = fs::read(&path).unwrap();
    for length in [0, 7, 8, 9, 500, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        assert!(says("docs/METRICS.md"), "{length}");
    }
    fs::write(&path, [whole.as_slice(), &[0]].concat()).unwrap();
    assert!(says("docs/METRICS.md"));
    // The header claims more bytes than the file holds.
    fs::write(&path, [&u64::MAX.to_le_bytes(), whole.as_slice()].concat()).unwrap();
    assert!(says("docs/METRICS.md"));
    let half = [0_u8; 64 * 3 * 11 * 11 * 2];
    let view = TensorView::new(Dtype::F16, vec![64, 3, 11, 11], &half).unwrap();
    safetensors::serialize_to_file([("net.slice1.0.weight", view)], None, &path).unwrap();
    let message = read().unwrap_err().to_string();
    assert!(message.contains("F16") && message.contains("F32"), "{message}");
    fs::remove_file(&path).unwrap();
    assert!(says("could not read the weights of LPIPS"));
    fs::create_dir(&path).unwrap();
    assert!(says("could not read the weights of LPIPS"));
    drop(folder);
}
