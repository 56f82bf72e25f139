use burn::tensor::TensorData;

use super::*;
use crate::capture::testing::assert_says;
use crate::capture::{Observation, Tracks};
use crate::gaussians::values_of;
use splat_demo::{self as demo, DemoOptions};

fn depths(samples: Vec<DepthSample>, every: usize) -> Depths {
    let weight = Falling { from: 2.0, to: 1.0 };
    Depths::new(DepthConfig { weight, every }, vec![samples, vec![]], &Device::flex())
}

fn at(view: usize) -> EffectContext<'static> {
    EffectContext { view, step: 1, steps: 10, verdict: None }
}

fn tracked(values: &[f32], size: [usize; 3]) -> Tensor<3> {
    let tensor = Tensor::from_data(TensorData::new(values.to_vec(), size), &Device::flex());
    Tensor::from_inner(tensor).require_grad()
}

#[test]
fn the_error_is_relative_and_counts_where_something_is_drawn() {
    let sample = |x: f32, y: f32, depth: f32| DepthSample { at: [x, y], depth };
    // Pixels 0 and 3 of four, one of them barely covered, and two without samples.
    let samples = vec![
        sample(0.2, 0.1, 2.0),
        sample(0.9, 0.6, 4.0),
        sample(0.7, 0.2, 5.0),
        sample(1.0, 0.0, 1.0),
        sample(0.5, 0.5, -1.0),
    ];
    let mut depths = depths(samples, 1);
    let depth = tracked(&[1.2, 0.1, 9.0, 3.0], [2, 2, 1]);
    let alpha = tracked(&[0.8, 0.4, 1.0, 1.0], [2, 2, 1]);
    let loss = depths.miss(depth.clone(), alpha.clone(), at(0)).unwrap();
    // |1.2/0.8 − 2|/2 = 1/4 and |3 − 4|/4 = 1/4.
    assert!((loss.clone().inner().into_scalar::<f32>() - 2.0 * 0.25).abs() < 1e-6);
    let gradients = loss.backward();
    let gradient = values_of(depth.grad(&gradients).unwrap());
    let expected = [-1.0 / (0.8 * 2.0), 0.0, 0.0, -0.25];
    assert!(gradient.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{gradient:?}");
    // A higher alpha has the effect of a smaller depth.
    let gradient = values_of(alpha.grad(&gradients).unwrap());
    let expected = [1.2 / (0.8 * 0.8 * 2.0), 0.0, 0.0, 0.75];
    assert!(gradient.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{gradient:?}");
    assert!(depths.supervises(at(0)) && !depths.supervises(at(1)) && !depths.supervises(at(7)));
    assert!(depths.miss(depth.clone(), alpha.clone(), at(1)).is_none());
    // At another picture size, samples map to other pixels.
    let small = |values: &[f32]| tracked(values, [1, 1, 1]);
    let loss = depths.miss(small(&[2.0]), small(&[1.0]), at(0)).unwrap().inner().into_scalar::<f32>();
    assert!((loss - 2.0 * (0.0 + 0.5 + 0.6) / 3.0).abs() < 1e-6, "{loss}");
}

#[test]
fn one_of_so_many_steps_is_supervised_with_as_many_times_the_weight() {
    let known = DepthSample { at: [0.5, 0.5], depth: 2.0 };
    let small = |value: f32| tracked(&[value], [1, 1, 1]);
    let loss = |every: usize, step: usize| {
        let at = EffectContext { step, ..at(0) };
        let miss = depths(vec![known], every).miss(small(1.0), small(1.0), at);
        miss.map(|miss| miss.inner().into_scalar::<f32>())
    };
    let always: Vec<_> = (1..=9).map(|step| loss(1, step).unwrap()).collect();
    assert_eq!(always, (1..=9).map(|step| loss(0, step).unwrap()).collect::<Vec<_>>());
    for step in 1..=9 {
        match loss(3, step) {
            Some(loss) if step % 3 == 0 => assert!((loss / always[step - 1] - 3.0).abs() < 1e-6, "step {step}"),
            loss => assert!(loss.is_none() && step % 3 > 0, "step {step}: {loss:?}"),
        }
    }
}

#[test]
fn maps_tell_depths() {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 64, height: 48, views: 4, points: 500, depth: true, ..DemoOptions::default() };
    demo::write(folder.path(), &options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    let (tracks, maps) = (from_tracks(&capture, &[2]), from_maps(&capture, &[2], |_| {}).unwrap().unwrap());
    assert!(maps[0].len() > 1000, "{}", maps[0].len());
    // At the positions of tracks the map has the tracks' depth, except at depth discontinuities.
    let at = |sample: &DepthSample| {
        let pixel = sample.at.iter().zip([64.0, 48.0]).map(|(at, side)| (at * side).floor());
        let place: Vec<f32> = pixel.zip([64.0, 48.0]).map(|(pixel, side)| (pixel + 0.5) / side).collect();
        maps[0].iter().find(|map| (map.at[0] - place[0]).hypot(map.at[1] - place[1]) < 1e-4)
    };
    let misses = tracks[0].iter().filter_map(|sample| Some((at(sample)?.depth / sample.depth - 1.0).abs()));
    let mut misses: Vec<f32> = misses.collect();
    misses.sort_by(f32::total_cmp);
    assert!(misses.len() > 50 && misses[misses.len() / 2] < 0.01, "{:?}", misses.get(misses.len() / 2));
}

/// A capture of four photographs of 64 × 48 px with depth maps.
fn capture_with_maps() -> (tempfile::TempDir, Capture) {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 64, height: 48, views: 4, points: 500, depth: true, ..DemoOptions::default() };
    demo::write(folder.path(), &options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    (folder, capture)
}

/// Writes each map of the capture anew, with levels that grow with a quantity, a scale and shift for each, and a kind of file for each. Levels
/// of files of 8 bits are at most 255.
fn make_relative(folder: &Path, quantity: &str) {
    std::fs::write(folder.join("depth/depth.json"), format!("{{\"relative\": \"{quantity}\"}}")).unwrap();
    for (view, (scale, shift)) in [(70.0, 9.0), (9000.0, 4000.0), (0.7, 3.0), (12.0, -30.0)].into_iter().enumerate() {
        let file = folder.join(format!("depth/{view:04}.png"));
        let metric = image::open(&file).unwrap().into_luma16();
        metric.save(folder.join(format!("metric{view}.png"))).unwrap();
        let of = |level: u16| {
            let depth = f32::from(level) * 0.001;
            let value = if quantity == "depth" { depth / 10.0 } else { depth.recip() };
            if level == 0 { 0.0 } else { scale * value + shift }
        };
        let levels: Vec<f32> = metric.iter().map(|&level| of(level)).collect();
        assert!(levels.len() == 64 * 48 && (view > 1 || levels.iter().all(|&level| level < [255.0, 65535.0][view])));
        let new = |kind: &str| file.with_extension(kind);
        match view {
            0 => image::GrayImage::from_raw(64, 48, levels.iter().map(|l| l.round() as u8).collect())
                .unwrap()
                .save(&file),
            1 => image::ImageBuffer::<image::Luma<u16>, _>::from_raw(
                64,
                48,
                levels.iter().map(|l| l.round() as u16).collect::<Vec<_>>(),
            )
            .unwrap()
            .save(&file),
            2 => {
                std::fs::write(new("npy"), array("<f4", "48, 64", levels.iter().flat_map(|l| l.to_le_bytes())))
                    .unwrap();
                std::fs::remove_file(&file).unwrap();
                Ok(())
            }
            _ => {
                let pixels = levels.iter().flat_map(|&level| [level, -1.0, 7.0]).collect();
                std::fs::remove_file(&file).unwrap();
                image::Rgb32FImage::from_raw(64, 48, pixels).unwrap().save(new("exr"))
            }
        }
        .unwrap();
    }
}

/// The file of an array of NumPy.
fn array(kind: &str, shape: &str, values: impl IntoIterator<Item = u8>) -> Vec<u8> {
    let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}\n");
    let header = [&b"\x93NUMPY\x01\x00"[..], &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat();
    header.into_iter().chain(values).collect()
}

/// The depth of a sample of `map` at the same place as another.
fn beside(map: &[DepthSample], sample: &DepthSample) -> Option<f32> {
    map.iter().find(|known| known.at == sample.at).map(|known| known.depth)
}

#[test]
fn relative_maps_tell_the_depths_of_metric_ones() {
    for quantity in ["depth", "disparity"] {
        let (folder, capture) = capture_with_maps();
        let views = [0, 1, 2, 3];
        let metric = from_maps(&capture, &views, |said| panic!("{said}")).unwrap().unwrap();
        make_relative(folder.path(), quantity);
        let relative = from_maps(&capture, &views, |said| panic!("{said}")).unwrap().unwrap();
        for (view, samples) in relative.iter().enumerate() {
            let miss = |sample: &DepthSample| {
                let depth = beside(&metric[view], sample).unwrap();
                // Half a level of eight bits, relative to the depth.
                let level = if quantity == "depth" { 10.0 / 70.0 / depth } else { depth / 70.0 };
                (sample.depth / depth - 1.0).abs() - if view == 0 { 0.5 * level } else { 0.0 }
            };
            let worst = samples.iter().map(miss).fold(f32::NEG_INFINITY, f32::max);
            eprintln!("{quantity} {view}: {} of {} known, worst {worst:.4}", samples.len(), metric[view].len());
            let within = if view == 0 { 0.012 } else { 0.006 };
            assert!(samples.len() == metric[view].len() && worst < within, "{quantity}, view {view}: {worst}");
        }
    }
}

#[test]
fn a_fifth_of_the_points_may_be_wrong() {
    let (folder, capture) = capture_with_maps();
    make_relative(folder.path(), "disparity");
    let mut points = from_tracks(&capture, &[2]).remove(0);
    let map = depth_maps::load(&folder.path().join("depth/0002.npy")).unwrap();
    let solved = |quantity: Quantity, map: &DepthMap, points: &[DepthSample]| {
        let mut map = map.clone();
        quantity.solve(&mut map, points).map(|()| map)
    };
    let wrong =
        |points: &mut [DepthSample], factor: f32| points.iter_mut().step_by(5).for_each(|point| point.depth *= factor);
    let mut metric = image::open(folder.path().join("metric2.png")).unwrap().into_luma16();
    metric.iter_mut().for_each(|level| *level = (*level).max(1));
    for factor in [0.2, 0.5, 3.0, 50.0] {
        wrong(&mut points, factor);
        let found = solved(Quantity::Disparity, &map, &points).unwrap();
        wrong(&mut points, factor.recip());
        let pixels = found.iter().zip(metric.iter()).filter(|(depth, _)| depth.is_finite());
        let misses: Vec<f32> = pixels.map(|(depth, level)| (depth / (f32::from(*level) * 0.001) - 1.0).abs()).collect();
        let worst = misses.iter().copied().fold(0.0, f32::max);
        eprintln!("{factor}: {} known, worst {worst:.5}", misses.len());
        assert!(misses.len() > 2900 && worst < 0.01, "factor {factor}: {} known, worst {worst}", misses.len());
    }
    let said = |points: &[DepthSample]| solved(Quantity::Disparity, &map, points).unwrap_err();
    assert_says(&said(&points[..19]), &["19 sparse points", "expected 20"]);
    let turned = |point: &DepthSample| DepthSample { depth: (0.3 * point.depth).recip(), ..*point };
    let refused = &["the Disparity of its sparse points is -", "expected a factor above 0"];
    assert_says(&said(&points.iter().map(turned).collect::<Vec<_>>()), refused);
    let noisy = |(i, point): (usize, &DepthSample)| DepthSample {
        depth: point.depth * (2.0 * (i as f32 * 12.9898).sin()).exp(),
        ..*point
    };
    let refused = &["the Disparity of its sparse points", "expected a factor above 0, to 25%"];
    assert_says(&said(&points.iter().enumerate().map(noisy).collect::<Vec<_>>()), refused);
    let flat = DepthMap::from_pixel(64, 48, image::Luma([2.0]));
    assert_says(&solved(Quantity::Depth, &flat, &points).unwrap_err(), &["is 0.00e0 times a level"]);
}

#[test]
fn depths_far_beyond_the_points_are_not_used() {
    // Depths from 1 to 10 in the first rows, and points there.
    let depth = |i: usize| 1.0 + 9.0 * (i % 64) as f32 / 63.0;
    let mut map = DepthMap::from_fn(64, 4, |x, _| image::Luma([2.0 / depth(x as usize) + 0.1]));
    let point = |i: usize| DepthSample { at: [(i as f32 + 0.5) / 64.0, 0.1], depth: depth(i) };
    let points: Vec<DepthSample> = (0..64).map(point).collect();
    // Near, far, as far as infinity, behind the camera, and what is no number.
    let levels = [0.1 + 2.0 / 0.5, 0.1 + 2.0 / 30.0, 0.1, 0.05, 0.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    levels.iter().enumerate().for_each(|(x, &level)| map.put_pixel(x as u32, 3, image::Luma([level])));
    Quantity::Disparity.solve(&mut map, &points).unwrap();
    let known = |x: usize| Some(map.get_pixel(x as u32, 3).0[0]).filter(|depth| depth.is_finite());
    let found: Vec<Option<f32>> = (0..levels.len()).map(known).collect();
    assert_eq!(found, [None; 8]);
    assert!((0..64).all(|x| (map.get_pixel(x, 1).0[0] / depth(x as usize) - 1.0).abs() < 1e-4));
}

#[test]
fn photographs_without_enough_points_are_left_out_and_named() {
    let (folder, mut capture) = capture_with_maps();
    make_relative(folder.path(), "depth");
    let keep = |capture: &mut Capture, kept: &dyn Fn(usize, usize) -> bool| {
        let mut tracks = Tracks::default();
        for point in 0..capture.points.positions.len() {
            let seen = capture.tracks.of(point).iter().filter(|seen: &&Observation| kept(point, seen.view));
            tracks.push(seen.copied(), -1.0);
        }
        capture.tracks = tracks;
    };
    keep(&mut capture, &|point, view| view != 1 || point < 10);
    let said = std::cell::RefCell::new(Vec::new());
    let found = from_maps(&capture, &[3, 1], |line| said.borrow_mut().push(line.to_owned())).unwrap().unwrap();
    assert!(found[0].len() > 1000 && found[1].is_empty(), "{} and {}", found[0].len(), found[1].len());
    let said = said.into_inner();
    assert_eq!(said.len(), 1, "{said:?}");
    assert_says(
        &said[0],
        &["1 of 2 depth maps have no scale", "0001.png: ", "sparse points where its map is known, expected 20"],
    );
    keep(&mut capture, &|_, _| false);
    let error = from_maps(&capture, &[3, 1], |said| panic!("{said}")).unwrap_err().to_string();
    assert_says(
        &error,
        &["depth.json", "2 of 2 depth maps have", "0003.png: 0 sparse points", "--effects=-depth-supervision"],
    );
}

#[test]
fn bad_files_are_said() {
    let (folder, capture) = capture_with_maps();
    let said = || from_maps(&capture, &[2], |_| {}).unwrap_err().to_string();
    let [unit, png, npy] = ["depth.json", "0002.png", "0002.npy"].map(|name| folder.path().join("depth").join(name));
    std::fs::remove_file(&unit).unwrap();
    assert_says(&said(), &["depth.json", "0.001"]);
    let bad = [
        (r#"{"scale": -1}"#, "`scale` is -1"),
        (r#"{"scale": 1e999}"#, "number out of range"),
        ("{}", "neither a number `scale`"),
        (r#"{"relative": "height"}"#, "one of the words for `relative`"),
    ];
    for (text, part) in bad {
        std::fs::write(&unit, text).unwrap();
        assert_says(&said(), &["depth.json", part, r#"{"relative": "disparity"}"#]);
    }
    std::fs::write(&unit, r#"{"scale": 1}"#).unwrap();
    image::RgbImage::new(4, 4).save(&png).unwrap();
    assert_says(&said(), &["0002.png", "its pixels are Rgb8", "8 or 16 bits"]);
    std::fs::write(&png, "no picture").unwrap();
    assert_says(&said(), &["0002.png", "Expected grey PNG"]);
    std::fs::remove_file(&png).unwrap();
    let four = [0_u8; 4 * 4];
    let nested = [&b"\x93NUMPY\x01\x00\xff\xff"[..], &[b'('; 0xffff]].concat();
    let long = [&b"\x93NUMPY\x02\x00\xff\xff\xff\xff"[..], &[b'('; 99]].concat();
    let bad = [
        (array("<i4", "2, 2", four), "i4"),
        (array("<f4", "2, 3", four), "fill whole buffer"),
        (array("<f4", "4,", four), "shape is [4] in C's order"),
        (array("<f4", "1, 2, 2", four), "shape is [1, 2, 2]"),
        (array("<f4", "9223372036854775808, 2", four), "out of range"),
        (array("<f4", "18446744073709551615, 18446744073709551615", four), "0002.npy"),
        (array("<f4", "0, 0", []), "it is empty"),
        (nested, "no header of version 1"),
        ([&nested_header()[..], &four].concat(), "0002.npy"),
        (long, "no header of version 1"),
        (b"\x93NUM".to_vec(), "no header of version 1"),
    ];
    for (bytes, part) in bad {
        std::fs::write(&npy, bytes).unwrap();
        assert_says(&said(), &["0002.npy", part, "float16 or float32"]);
    }
    // Half precision, and what is not known.
    let values = [half::f16::from_f32(1.5), half::f16::NAN, half::f16::ZERO, half::f16::from_f32(2.5)];
    std::fs::write(&npy, array("<f2", "2, 2", values.into_iter().flat_map(half::f16::to_le_bytes))).unwrap();
    let found = from_maps(&capture, &[2], |_| {}).unwrap().unwrap().remove(0);
    let known = [([0.25, 0.25], 1.5), ([0.75, 0.75], 2.5)].map(|(at, depth)| DepthSample { at, depth });
    assert_eq!(found, known);
}

/// A header of 256 open brackets.
fn nested_header() -> Vec<u8> {
    [&b"\x93NUMPY\x01\x00\x00\x01"[..], &[b'('; 256]].concat()
}

#[test]
fn tracks_tell_depths() {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 64, height: 48, views: 4, points: 500, ..DemoOptions::default() };
    demo::write(folder.path(), &options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    let samples = from_tracks(&capture, &[1, 3]);
    assert_eq!(samples.len(), 2);
    assert!(samples.iter().all(|list| list.len() > 50), "{} and {}", samples[0].len(), samples[1].len());
    let observations = (0..capture.points.positions.len()).flat_map(|point| capture.tracks.of(point));
    assert_eq!(samples[1].len(), observations.filter(|observation| observation.view == 3).count());
    // Unprojecting a sample by its depth returns to a point.
    let view = &capture.views[3];
    for sample in samples[1].iter().take(20) {
        let px = glam::DVec2::new(f64::from(sample.at[0]) * 64.0, f64::from(sample.at[1]) * 48.0);
        let cam = view.intrinsics.cam_from_px(px) * f64::from(sample.depth);
        let world = view.cam_from_world.inverse().transform_point3(cam);
        let distance = |position: &[f32; 3]| glam::Vec3::from_array(*position).as_dvec3().distance(world);
        let nearest = capture.points.positions.iter().map(distance).fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-3, "{nearest}");
    }
}

impl Depths {
    /// The least of all known depths.
    pub(crate) fn least(&self) -> f64 {
        self.samples.iter().flatten().map(|sample| f64::from(sample.depth)).fold(f64::INFINITY, f64::min)
    }
}
