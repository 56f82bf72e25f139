use burn::tensor::Device;

use super::*;
use crate::density::AdaptiveConfig;
use crate::gaussians::testing::random_rows;
use crate::trainer::TrainConfig;
use crate::trainer::testing::{photos, points, ring};

fn started(max_splats: usize, sh_degree: usize, scene: &GaussianRows) -> Trainer {
    let density = AdaptiveConfig { max_splats, ..AdaptiveConfig::default() };
    let config = TrainConfig { steps: 9, sh_degree, sh_every: 2, density: density.into(), ..TrainConfig::default() };
    let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    trainer.from_scene(scene, &points()).unwrap()
}

#[test]
fn a_run_starts_from_a_scene_and_from_points_while_there_is_room() {
    let scene = random_rows(20, 2, 5);
    // There are thirty points: of all, of every second, of none.
    for (most, from_points) in [(50, 30), (35, 15), (20, 0), (7, 0)] {
        let rows = started(most, 3, &scene).gaussians().to_rows();
        assert_eq!((rows.len(), rows.sh_degree), (from_points + 20, 2), "at most {most}");
        assert_eq!(rows.part(from_points..rows.len()), scene);
        let points = rows.part(0..from_points);
        assert!(points.sh_rest.iter().all(|value| *value == 0.0));
        assert!(points.logit_opacities.iter().all(|logit| (logit + 2.197).abs() < 1e-3), "{points:?}");
    }
}

#[test]
fn harmonics_grow_from_the_degree_of_the_scene() {
    let degrees = |of_scene, of_run| {
        let mut trainer = started(100, of_run, &random_rows(20, of_scene, 5));
        let first = trainer.gaussians().sh_degree();
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        [first, trainer.gaussians().sh_degree()]
    };
    assert_eq!([degrees(2, 3), degrees(3, 1), degrees(0, 2)], [[2, 3], [1, 1], [0, 2]]);
}

#[test]
fn a_start_without_points_is_random() {
    let start = |points: &PointCloud, most: usize| {
        let density = AdaptiveConfig { max_splats: most, ..AdaptiveConfig::default() };
        let config = TrainConfig { steps: 1, density: density.into(), ..TrainConfig::default() };
        Trainer::new(ring(16), points, config, &Device::flex()).unwrap().rows()
    };
    assert_eq!(start(&PointCloud::default(), 100).len(), 100, "at most as many as the run may have");
    assert_eq!(start(&PointCloud::default(), 30_000).len(), init::RANDOM_COUNT);
    let few = PointCloud { positions: points().positions[..5].to_vec(), colours: vec![[7; 3]; 5] };
    assert_eq!(start(&few, 100).len(), 5);
}
