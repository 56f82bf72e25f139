use super::*;

#[test]
fn a_machine_is_about_as_fast_as_another() {
    let slowness = slowness().unwrap();
    // From a card's fast host to a busy core of a runner.
    assert!((0.02..50.0).contains(&slowness), "{slowness}");
}
