use splat_model::accuracy::Setting;
use splat_op::{Projection, RenderOptions};

use super::*;

/// Every training dial is turned in at least one run.
#[test]
fn every_dial_of_the_training_is_turned_somewhere() {
    let base = TrainConfig { steps: 100, ..TrainConfig::default() };
    let turned = |differs: fn(&TrainConfig, &TrainConfig) -> bool| {
        WAYS.iter().filter(|way| differs(&way.of(&base), &base)).map(|way| way.name).collect::<Vec<_>>()
    };
    assert!(turned(|a, b| a.steps != b.steps).contains(&"half the steps"));
    assert!(turned(|a, b| a.resolution != b.resolution).contains(&"quarters first"));
    assert!(turned(|a, b| a.moment_bits != b.moment_bits) == ["moments of 16 bits", "moments of 8 bits"]);
    assert!(turned(|a, b| a.sh_every != b.sh_every).contains(&"harmonics by quarters"));
    assert!(turned(|a, b| a == b) == ["standard"] && WAYS[0].of(&base) == base);
}

#[test]
fn a_scene_along_rays_stays_one() {
    let choice = Setting::new([("projection", "ray-max")]).unwrap();
    let base = TrainConfig { dials: choice, ..TrainConfig::default() };
    for way in WAYS {
        let config = way.of(&base);
        assert_eq!(config.dials.apply(RenderOptions::standard()).projection, Projection::RayMax, "{}", way.name);
        config.check().unwrap();
    }
}
