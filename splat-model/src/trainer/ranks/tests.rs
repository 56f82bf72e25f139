use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use burn::tensor::{Device, Gradients as Remaining, Tensor};
use glam::DVec3;
use splat_op::Rendered;

use super::testing::together;
use super::*;
use crate::capture::{CaptureError, Photo, Photograph};
use crate::density::rows::Trained;
use crate::density::{AdaptiveConfig, DensityConfig, Division, McmcConfig};
use crate::effects::background::Backdrop;
use crate::effects::depth::{DepthConfig, DepthSample};
use crate::effects::exposure::ExposureConfig;
use crate::effects::grid::GridConfig;
use crate::effects::optics::OpticsConfig;
use crate::effects::pose::PoseConfig;
use crate::effects::{Effect, EffectContext, Leaf, Learned, RenderInput};
use crate::state::{State, StateError};
use crate::trainer::testing::{HEIGHT, WIDTH, photos, points};
use crate::trainer::{LossInputs, Resolution, TrainConfig, Trainer};

/// Each strategy with a schedule for a few dozen steps.
fn strategies() -> [DensityConfig; 4] {
    let adaptive = AdaptiveConfig {
        every: 5,
        from: 5,
        until_share: 0.9,
        grad_threshold: 1e-5,
        reset_every: 14,
        max_splats: 45,
        ..AdaptiveConfig::default()
    };
    let mcmc =
        McmcConfig { every: 5, from: 5, growth: 1.2, max_splats: 60, dead_opacity: 0.3, ..McmcConfig::default() };
    [
        adaptive.into(),
        AdaptiveConfig { absolute: true, ..adaptive }.into(),
        AdaptiveConfig { division: Division::LongAxis, growth: Some(0.2), ..adaptive }.into(),
        mcmc.into(),
    ]
}

fn config(batch: usize) -> TrainConfig {
    let resolution = Resolution { coarsest_divisor: 2, full_from: 0.5 };
    TrainConfig { steps: 22, sh_every: 6, density: strategies()[0], batch, resolution, ..TrainConfig::default() }
}

/// With every effect that has parameters or state.
fn with_effects(batch: usize) -> TrainConfig {
    TrainConfig {
        exposure: Some(ExposureConfig::default()),
        grid: Some(GridConfig::default()),
        poses: Some(PoseConfig::default()),
        optics: OpticsConfig { motion: true, rolling: true },
        depth: Some(DepthConfig::default()),
        smoothing: true,
        antialias: true,
        backdrop: Backdrop::Environment { degree: 1 },
        ..config(batch)
    }
}

fn trainer_of(photos: Vec<Photo>, config: &TrainConfig) -> Trainer {
    let samples = vec![vec![DepthSample { at: [0.5, 0.5], depth: 3.0 }], vec![], vec![], vec![]];
    Trainer::new(photos, &points(), config.clone(), &Device::flex()).unwrap().with_depths(samples)
}

fn trainer(config: &TrainConfig) -> Trainer {
    trainer_of(photos(config.background), config)
}

/// The losses of the steps up to step `until`, and the state after them.
fn trained(mut trainer: Trainer, until: usize) -> (Vec<u32>, State) {
    let mut losses = Vec::new();
    while trainer.steps_done() < until {
        losses.push(trainer.step().unwrap().loss.into_scalar::<f32>().to_bits());
    }
    (losses, trainer.save().unwrap())
}

/// Compares whole runs on each of these numbers of ranks with the run alone.
#[track_caller]
fn assert_same(make: impl Fn() -> Trainer + Sync, numbers: &[usize], what: &str) {
    let steps = make().config().steps;
    let alone = trained(make(), steps);
    for &count in numbers {
        let all = together(count, |ranks| trained(make().with_ranks(ranks), steps));
        assert!(all.iter().all(|one| *one == alone), "{what} on {count} ranks");
    }
}

#[test]
fn shares_are_consecutive_and_even_and_begin_at_rank_0() {
    let shares = |ranks, count| (0..ranks).map(|rank| share_of(rank, ranks, count)).collect::<Vec<_>>();
    assert_eq!(shares(2, 3), [0..2, 2..3]);
    assert_eq!(shares(3, 2), [0..1, 1..2, 2..2]);
    assert_eq!(shares(3, 8), [0..3, 3..6, 6..8]);
    assert_eq!(shares(4, 1), [0..1, 1..1, 1..1, 1..1]);
}

#[test]
fn sums_are_those_of_one_process_to_the_bit() {
    let part =
        |i: usize| (0..40_000).map(|j| ((i * 40_000 + j) as f32).sin() * 10f32.powi(i as i32)).collect::<Vec<_>>();
    let alone = Alone.sum((0..5).map(part).collect(), &[5], 40_000).unwrap();
    // Another order gives other bits, so the order matters.
    assert_ne!(Alone.sum((0..5).rev().map(part).collect(), &[5], 40_000).unwrap(), alone);
    for parts_of in [vec![2, 3], vec![0, 1, 4], vec![3, 0, 2], vec![1, 1, 1, 1, 1], vec![5, 0]] {
        let sums = together(parts_of.len(), |ranks| {
            let before: usize = parts_of[..ranks.rank()].iter().sum();
            let own = (before..before + parts_of[ranks.rank()]).map(part).collect();
            ranks.sum(own, &parts_of, 40_000).unwrap()
        });
        assert!(sums.iter().all(|sum| *sum == alone), "{parts_of:?}");
    }
}

#[test]
fn every_strategy_trains_the_same_scene_on_any_number_of_ranks() {
    for (i, density) in strategies().into_iter().enumerate() {
        // Uneven shares, and a rank without a view.
        let [batch, first, second] = [[3, 2, 4], [2, 3, 2], [5, 2, 3], [4, 3, 4], [3, 2, 3]][i];
        assert_same(|| trainer(&TrainConfig { density, ..config(batch) }), &[first, second], &format!("{density:?}"));
    }
}

#[test]
fn every_effect_trains_the_same_scene_on_any_number_of_ranks() {
    assert_same(|| trainer(&with_effects(3)), &[2, 3], "all effects");
    assert_same(|| trainer(&with_effects(2)), &[3], "all effects and an idle rank");
    for backdrop in [Backdrop::Random, Backdrop::Learned] {
        assert_same(|| trainer(&TrainConfig { backdrop, ..config(3) }), &[2], &format!("{backdrop:?}"));
    }
    let cut_out = || {
        let mut photos = photos([0.0; 3]);
        for (i, photo) in photos.iter_mut().enumerate() {
            photo.alpha = Some((0..WIDTH * HEIGHT).map(|px| (px * (i + 3)) as u8).collect());
            photo.mask = Some((0..WIDTH * HEIGHT).map(|px| px % (i + 5) != 0).collect());
        }
        trainer_of(photos, &TrainConfig { backdrop: Backdrop::Random, ..config(3) })
    };
    assert_same(cut_out, &[2], "masks and transparent parts");
}

/// An effect with a parameter that not every photograph has.
struct Filter {
    light: Learned<1>,
    lists: bool,
}

impl Filter {
    fn new(lists: bool) -> Self {
        Self { light: Learned::new(Tensor::zeros([1], &Device::flex())), lists }
    }
}

impl Effect for Filter {
    fn name(&self) -> &'static str {
        "filter"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        if at.view == 0 { image } else { image * (self.light.tracked() + 1.0).reshape([1, 1, 1]) }
    }

    fn leaves(&mut self, _: EffectContext) -> Vec<Leaf> {
        if self.lists { vec![self.light.leaf()] } else { Vec::new() }
    }

    fn step(&mut self, gradients: &mut Remaining, at: EffectContext) {
        self.light.step(gradients, 0.01, at.verdict);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.light.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.light.load(from)
    }
}

#[test]
fn an_effect_of_ones_own_lists_its_parameters_or_is_found_out() {
    assert_same(|| trainer(&config(3)).with_effect(Filter::new(true)), &[2, 3], "a custom effect");
    let ends = together(2, |ranks| {
        let mut trainer = trainer(&config(4)).with_effect(Filter::new(false)).with_ranks(ranks);
        trainer.step().unwrap_err().to_string()
    });
    assert!(ends.iter().all(|end| end.contains("effects/filter/") && end.contains("`Effect::leaves`")), "{ends:?}");
}

#[test]
fn a_run_goes_on_with_another_number_of_ranks() {
    for config in [config(3), with_effects(3), TrainConfig { density: strategies()[3], ..config(4) }] {
        let (losses, state) = trained(trainer(&config), config.steps);
        let (first, halfway) = trained(trainer(&config), 7);
        let go_on = |count, from: &State, until| {
            let mut ends = together(count, |ranks| {
                let mut trainer = trainer(&config).with_ranks(ranks);
                trainer.resume(from.clone()).unwrap();
                trained(trainer, until)
            });
            assert!(ends.windows(2).all(|two| two[0] == two[1]));
            ends.remove(0)
        };
        let (second, later) = go_on(2, &halfway, 13);
        let (third, end) = go_on(3, &later, config.steps);
        assert!([first, second, third].concat() == losses && end == state, "{config:?}");
        assert!(go_on(1, &later, config.steps).1 == state);
    }
}

#[test]
fn a_step_that_is_not_finite_ends_every_rank_with_the_error_of_one_process() {
    // In one view of step 3.
    let broken = |seen: &LossInputs| {
        let loss = seen.image.clone().mean();
        if seen.step == 3 && seen.view == "d" { loss * f32::NAN } else { loss }
    };
    let end = |mut trainer: Trainer| {
        let error = loop {
            match trainer.step() {
                Ok(report) => assert!(report.step < 3),
                Err(error) => break error,
            }
        };
        assert!(error.keeps_scene());
        (error.to_string(), trainer.gaussians().to_rows())
    };
    let make = || trainer(&config(4)).with_loss(broken);
    let alone = end(make());
    assert!(alone.0.contains("step 3, photograph `d`: the loss"), "{}", alone.0);
    for count in [2, 3, 4] {
        assert!(together(count, |ranks| end(make().with_ranks(ranks))).iter().all(|one| *one == alone));
    }
}

/// Photographs that are decoded on each use, and a count of those of this rank. One cannot be decoded any more.
fn read_again(lost: Option<&'static str>) -> (Vec<Photograph>, Arc<AtomicUsize>) {
    let count = Arc::new(AtomicUsize::new(0));
    let photograph = |photo: Photo| {
        let (again, counted) = (photo.clone(), Arc::clone(&count));
        Photograph::read_later((&photo).into(), &Arc::default(), move || {
            counted.fetch_add(1, Ordering::Relaxed);
            match lost == Some(again.name.as_str()) {
                true => Err(CaptureError::Changed { name: again.name.clone() }),
                false => Ok(again.clone()),
            }
        })
    };
    (photos([0.0; 3]).into_iter().map(photograph).collect(), count)
}

fn reading(lost: Option<&'static str>) -> (Trainer, Arc<AtomicUsize>) {
    let (photographs, count) = read_again(lost);
    let config = TrainConfig { cache_mib: 0, ..config(4) };
    (Trainer::of(photographs, &points(), config, &Device::flex()).unwrap(), count)
}

#[test]
fn a_rank_decodes_its_own_photographs_only() {
    let decoded = together(2, |ranks| {
        let (trainer, count) = reading(None);
        let mut trainer = trainer.with_ranks(ranks);
        (0..6).for_each(|_| _ = trainer.step().unwrap());
        count.load(Ordering::Relaxed)
    });
    // Two of four photographs per step. The last one stays until another is decoded, and may be the next.
    assert!(decoded.iter().all(|count| (6..=12).contains(count)), "{decoded:?}");
}

#[test]
fn the_failure_of_a_rank_is_told_to_all() {
    let ends = together(4, |ranks| {
        let rank = ranks.rank();
        let error = reading(Some("d")).0.with_ranks(ranks).step().unwrap_err();
        (rank, matches!(error, TrainError::OtherRank { .. }), error.keeps_scene(), error.to_string())
    });
    let failed = ends.iter().find(|(_, of_another, ..)| !of_another).expect("a rank has the photograph");
    for (rank, of_another, keeps_scene, message) in &ends {
        assert!(*keeps_scene && message.contains("the photograph d has changed"), "{message}");
        assert_eq!(*of_another, *rank != failed.0);
        assert_eq!(message.starts_with(&format!("rank {}: ", failed.0)), *of_another, "{message}");
    }
}

#[test]
fn a_rank_that_is_gone_is_an_error_of_the_others() {
    let ends = together(3, |ranks| {
        if ranks.rank() == 1 {
            return None;
        }
        Some(trainer(&config(3)).with_ranks(ranks).step().unwrap_err().to_string())
    });
    // The rank that fails first hears of rank 1, and the other of either.
    let ends: Vec<String> = ends.into_iter().flatten().collect();
    assert!(ends.iter().all(|end| end.contains("is gone")), "{ends:?}");
    assert!(ends.iter().any(|end| end.contains("rank 1 is gone")), "{ends:?}");
}

#[test]
fn ranks_of_another_run_are_refused_before_the_first_step() {
    let refused = |make: &(dyn Fn(usize) -> Trainer + Sync)| {
        let ends = together(3, |ranks| {
            let mut trainer = make(ranks.rank()).with_ranks(ranks);
            let error = trainer.step().unwrap_err();
            assert_eq!(trainer.steps_done(), 0);
            assert!(matches!(error, TrainError::RanksDiffer { rank: 2, .. }), "{error}");
            error.to_string()
        });
        assert!(ends.iter().all(|end| *end == ends[0]));
        ends[0].clone()
    };
    let odd = |rank: usize, other: TrainConfig| if rank == 2 { other } else { config(3) };
    let error = refused(&|rank| trainer(&odd(rank, TrainConfig { seed: 5, ..config(3) })));
    assert!(error.contains("`seed` is 5 on rank 2, and 0 on rank 0"), "{error}");
    let other_photos = |rank: usize, change: fn(&mut Vec<Photo>)| {
        let mut photos = photos([0.0; 3]);
        if rank == 2 {
            change(&mut photos);
        }
        Trainer::new(photos, &points(), config(3), &Device::flex()).unwrap()
    };
    let error = refused(&|rank| other_photos(rank, |photos| photos[1].name = "x".into()));
    assert!(error.contains("photograph 2 is x (32 x 24) on rank 2, and a (32 x 24) on rank 0"), "{error}");
    let error = refused(&|rank| other_photos(rank, |photos| drop(photos.pop())));
    assert!(error.contains("photograph 4 is missing on rank 2"), "{error}");
    let error =
        refused(&|rank| other_photos(rank, |photos| photos[0].cam_from_world.translation += DVec3::splat(1e-9)));
    assert!(error.contains("cameras"), "{error}");
    let error = refused(&|rank| {
        let mut trainer = trainer(&config(3));
        if rank == 2 {
            let mut rows = trainer.scene.gaussians.to_rows();
            rows.means[7][1] += 1e-3;
            let device = Device::flex().autodiff();
            trainer.scene = Trained::new(crate::gaussians::Gaussians::from_rows(&rows, &device).unwrap());
        }
        trainer
    });
    assert!(error.contains("`scene/means/values`"), "{error}");
    let versions = together(2, |ranks| {
        let version = format!("0.{}", ranks.rank());
        agree(&*ranks, &[("the version".into(), version)]).unwrap_err().to_string()
    });
    assert!(
        versions.iter().all(|error| error.contains("the version is 0.1 on rank 1, and 0.0 on rank 0")),
        "{versions:?}"
    );
}
