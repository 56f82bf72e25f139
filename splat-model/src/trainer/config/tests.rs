use super::*;
use crate::effects::optics::OpticsConfig;

fn dials(dial: &str, value: &str) -> Setting {
    Setting::new([(dial, value)]).unwrap()
}

#[test]
fn rays_do_not_go_with_what_changes_ellipses() {
    let rays = TrainConfig { dials: dials("projection", "ray-max"), ..TrainConfig::default() };
    rays.check().unwrap();
    let optics = OpticsConfig { rolling: true, ..OpticsConfig::default() };
    let error = TrainConfig { optics, ..rays }.check().unwrap_err().to_string();
    assert!(error.contains("rolling shutters"), "{error}");
}
