use super::shared::{LOOKS, locked};
use super::*;
use crate::view::server::Site;

fn shared() -> Shared {
    Shared::new("page".into(), 3, b"first".to_vec())
}

fn asked(shared: &Shared, path: &str) -> Vec<u8> {
    shared.get(path).map(|(_, content)| content.into_owned()).unwrap()
}

/// One Gaussian that can be drawn, at `x`.
fn rows(x: f32) -> GaussianRows {
    GaussianRows {
        means: vec![[x, 0.0, 0.0]],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[0.0; 3]],
        logit_opacities: vec![0.0],
        sh_dc: vec![[0.0; 3]],
        sh_rest: Vec::new(),
        sh_degree: 0,
        groups: Vec::new(),
    }
}

#[test]
fn nobody_looks_until_the_numbers_are_asked_for() {
    let shared = shared();
    assert_eq!(asked(&shared, "/"), b"page");
    assert_eq!(asked(&shared, "/scene.ply"), b"first");
    assert!(!shared.is_watched());
    assert_eq!(asked(&shared, "/status.json"), b"null");
    assert!(shared.is_watched());
    assert!(shared.get("/metrics.json").is_none());
}

#[test]
fn a_scene_is_encoded_once_and_when_it_is_asked_for() {
    let shared = shared();
    assert_eq!(asked(&shared, "/scene.ply"), b"first");
    shared.show_scene(7, rows(1.0));
    assert_eq!((shared.scene_step(), shared.take_encoding()), (7, Duration::ZERO));
    let ply = asked(&shared, "/scene.ply");
    assert!(ply.starts_with(b"ply") && shared.take_encoding() > Duration::ZERO);
    assert_eq!((asked(&shared, "/scene.ply"), shared.take_encoding()), (ply.clone(), Duration::ZERO));
    // Nothing of this scene can be drawn.
    shared.show_scene(8, rows(f32::NAN));
    assert_eq!(asked(&shared, "/scene.ply"), ply);
}

#[test]
fn results_are_taken_with_the_scene_that_is_loaded_after_them() {
    let shared = shared();
    let history = History::default();
    let show = |metrics: Option<&Metrics>| {
        let numbers = Status {
            step: 3,
            steps: 3,
            splats: 1,
            seconds: 0.0,
            left_s: 0.0,
            history: &history,
            scene: 3,
            worst: None,
            metrics,
        };
        shared.show(&numbers);
    };
    show(None);
    asked(&shared, "/status.json");
    asked(&shared, "/scene.ply");
    assert!(!shared.results_are_taken(), "no results yet");
    show(Some(&Metrics::default()));
    // This request was sent for an earlier status.
    asked(&shared, "/scene.ply");
    assert!(!shared.results_are_taken(), "no browser has the results");
    asked(&shared, "/status.json");
    assert!(!shared.results_are_taken(), "the scene was loaded before the results");
    asked(&shared, "/status.json");
    asked(&shared, "/scene.ply");
    asked(&shared, "/status.json");
    assert!(shared.results_are_taken());
}

#[test]
fn only_the_button_stops() {
    let shared = shared();
    assert!(!shared.act("/") && !shared.act("/status.json") && !shared.stops());
    assert!(!shared.is_watched());
    assert!(shared.act("/stop") && shared.stops());
    // A request for the numbers does not shorten the wait of whoever stopped the run.
    asked(&shared, "/status.json");
    let until = locked(&shared.watched_until).unwrap();
    assert!(shared.is_watched() && until > Instant::now() + LOOKS, "{:?}", until - Instant::now());
}

#[test]
fn an_update_is_a_small_share_of_the_time() {
    let mut pace = Pace::default();
    assert!(pace.is_due());
    pace.done(Duration::ZERO);
    assert!(!pace.is_due() && pace.due.unwrap() <= Instant::now() + BETWEEN);
    pace.done(Duration::from_millis(100));
    assert!(pace.due.unwrap() > Instant::now() + Duration::from_secs(9));
}

#[test]
fn a_run_is_served_to_this_machine_unless_a_host_is_named() {
    let of = |text: &str| address(text).map(|(host, port)| format!("{host} {port}"));
    for (text, expected) in
        [("0", "127.0.0.1 0"), ("7007", "127.0.0.1 7007"), ("0.0.0.0:1", "0.0.0.0 1"), ("[::1]:80", "::1 80")]
    {
        assert_eq!(of(text).unwrap(), expected);
    }
    for text in ["", "host", ":80", "host:", "70000", "host:-1"] {
        assert!(of(text).unwrap_err().contains("0.0.0.0:7007"), "{text}");
    }
}
