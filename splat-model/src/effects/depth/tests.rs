use super::*;
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
    let (tracks, maps) = (from_tracks(&capture, &[2]), from_maps(&capture, &[2]).unwrap().unwrap());
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
    std::fs::write(folder.path().join("depth/depth.json"), "{\"scale\": -1}").unwrap();
    let error = from_maps(&capture, &[2]).unwrap_err().to_string();
    assert!(error.contains("depth.json") && error.contains("-1"), "{error}");
    std::fs::remove_file(folder.path().join("depth/depth.json")).unwrap();
    let error = from_maps(&capture, &[2]).unwrap_err().to_string();
    assert!(error.contains("depth.json") && error.contains("0.001"), "{error}");
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
