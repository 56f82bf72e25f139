use std::cell::RefCell;
use std::rc::Rc;

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_op::{CameraModel, render_view};

use super::*;
use crate::capture::Photo;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{Gaussians, values_of};
use crate::loss::photometric;
use crate::optim::LearningRates;
use crate::trainer::testing::{HEIGHT, WIDTH, photos, points};
use crate::trainer::{Seen, TrainConfig, Trainer};

const SIZE: [usize; 2] = [8 * WIDTH, 8 * HEIGHT];

#[test]
fn strips_are_of_one_height_and_reach_the_borders() {
    let camera = Intrinsics::centred(100, 200, 90.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut seen = [0_usize; 200];
    for _ in 0..2000 {
        let strip = Strip::draw(0.25, &camera, &mut rng).unwrap();
        assert!(strip.rows == 50 && strip.from <= 150 && strip.share() == 0.25);
        seen[strip.from..strip.from + strip.rows].iter_mut().for_each(|count| *count += 1);
    }
    assert!(seen.iter().all(|count| (200..900).contains(count)), "{seen:?}");
    let few = Strip::draw(1e-3, &camera, &mut rng).unwrap();
    assert_eq!((few.rows, few.share()), (SMALLEST_SIDE, SMALLEST_SIDE as f64 / 200.0));
}

#[test]
fn of_a_whole_picture_nothing_is_drawn() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let before = rng.clone();
    assert_eq!(Strip::draw(1.0, &Intrinsics::centred(100, 200, 90.0), &mut rng), None);
    assert_eq!(Strip::draw(0.5, &Intrinsics::centred(100, SMALLEST_SIDE, 90.0), &mut rng), None);
    assert_eq!(rng, before);
}

/// The rows that a picture has there, and the gradients of a loss on them, through a lens too.
#[test]
fn a_strip_shows_what_the_whole_picture_has_there() {
    let device = Device::flex().autodiff();
    for model in [CameraModel::Pinhole, CameraModel::OpenCv, CameraModel::Fisheye] {
        let mut intrinsics = Intrinsics { model, ..Intrinsics::centred(96, 120, 70.0) };
        if model != CameraModel::Pinhole {
            intrinsics.distortion[0] = 0.08;
        }
        let pose = DAffine3::from_translation(DVec3::new(0.1, -0.2, 3.0));
        let camera = Camera::new(intrinsics, &pose, &device);
        let background = Some(Tensor::from_floats([0.3, 0.2, 0.1], &device));
        let extras = Extras { background, ..Extras::default() };
        let options = RenderOptions::standard();
        let strip = Strip { from: 37, rows: 41, of: 120 };
        let of = |whole: bool| {
            let gaussians = Gaussians::from_rows(&random_rows(60, 1, 4), &device).unwrap();
            let splats = gaussians.splats();
            let picture = match whole {
                true => render_view(&splats, &camera, &extras, &options).unwrap().colour.narrow(0, 37, 41),
                false => strip.render(&splats, &camera, &extras, &options).unwrap().colour,
            };
            let grads = picture.clone().square().sum().backward();
            let [means, scales] =
                [&gaussians.means, &gaussians.log_scales].map(|param| param.val().grad(&grads).unwrap());
            [
                values_of(picture.inner()),
                values_of(means),
                values_of(scales),
                values_of(gaussians.sh.val().grad(&grads).unwrap()),
            ]
        };
        for (found, expected) in of(false).iter().zip(of(true)) {
            let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() <= 2e-4 * largest, "{model:?}: {found} instead of {expected}");
            }
        }
    }
}

/// Photographs whose red says which row it is, and which a mask cuts in two.
fn striped() -> Vec<Photo> {
    let stripe = |mut photo: Photo| {
        photo = photo.resized(SIZE[0], SIZE[1]);
        for (i, pixel) in photo.rgb.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *pixel = [(i / SIZE[0]) as u8, 100, 0];
        }
        photo.mask = Some((0..SIZE[0] * SIZE[1]).map(|i| i % SIZE[0] < 200).collect());
        photo
    };
    photos([0.0; 3]).into_iter().map(stripe).collect()
}

#[test]
fn a_step_sees_the_same_rows_of_render_photograph_and_mask() {
    let rows = Rc::new(RefCell::new(Vec::new()));
    let record = rows.clone();
    let loss = move |seen: &Seen| {
        let [height, width, _] = seen.image.dims();
        assert_eq!(([height, width, 3], seen.alpha.dims()), (seen.truth.image().dims(), [height, width, 1]));
        let truth = values_of(seen.truth.image());
        let row = |y: usize| (255.0 * truth[3 * y * width]).round() as usize;
        assert!((0..height).all(|y| row(y) == row(0) + y), "not the rows one below the other");
        // The picture there, rendered as a whole.
        let photo = striped().into_iter().find(|photo| photo.name == seen.view).unwrap();
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &Device::flex().autodiff());
        let whole = render_view(seen.splats, &camera, &Extras::default(), &options()).unwrap().colour;
        let (whole, shown) =
            (values_of(whole.narrow(0, row(0), height).inner()), values_of(seen.image.clone().inner()));
        let mut lit = 0;
        for (i, (found, expected)) in shown.iter().zip(&whole).enumerate() {
            let counts = i / 3 % width < 200;
            assert!((found - if counts { *expected } else { 0.0 }).abs() < 1e-4, "{i}: {found} instead of {expected}");
            assert!(counts || truth[i] == 0.0);
            lit += usize::from(counts && *found > 0.05);
        }
        assert!(lit > 500, "{lit}");
        record.borrow_mut().push((row(0), height));
        photometric(seen.image.clone(), seen.truth, 0.2)
    };
    let config = TrainConfig { steps: 6, pixel_share: 0.25, sh_degree: 0, ..TrainConfig::default() };
    let trainer = Trainer::new(striped(), &points(), config, &Device::flex()).unwrap();
    let mut trainer = trainer.with_loss(loss);
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    let rows = rows.borrow();
    assert!(rows.iter().all(|(_, height)| *height == SIZE[1] / 4));
    assert!(rows.iter().any(|(from, _)| *from != rows[0].0), "{rows:?}");
}

/// As a run renders the photographs of `testing`.
fn options() -> RenderOptions {
    let config = TrainConfig::default();
    Trainer::new(striped(), &points(), config, &Device::flex()).unwrap().render_options()
}

#[test]
fn a_run_on_half_of_the_pixels_learns_the_scene() {
    let large = || photos([0.0; 3]).iter().map(|photo| photo.resized(SIZE[0], SIZE[1])).collect::<Vec<_>>();
    let learning_rates = LearningRates { sh_dc: 0.05, opacities: 0.1, scales: 0.02, ..LearningRates::default() };
    let config = TrainConfig { steps: 40, pixel_share: 0.5, learning_rates, ..TrainConfig::default() };
    let mut trainer = Trainer::new(large(), &points(), config, &Device::flex()).unwrap();
    let losses: Vec<f32> = (0..40).map(|_| trainer.step().unwrap().loss.into_scalar()).collect();
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    assert!(mean(&losses[32..]) < 0.8 * mean(&losses[..8]), "{losses:?}");
}
