use super::*;
use splat_demo::{self as demo, DemoOptions};

fn of(options: DemoOptions) -> ShutterEvidence {
    let folder = tempfile::tempdir().unwrap();
    let small = DemoOptions { width: 96, height: 72, views: 6, points: 1500, ..options };
    demo::write(folder.path(), &small).unwrap();
    evidence(&Capture::load(folder.path()).unwrap()).unwrap()
}

#[test]
fn rows_and_poses_are_told_apart() {
    let rolling = of(DemoOptions { rolling: true, ..DemoOptions::default() });
    assert!(rolling.left_by_rows < 0.2 && rolling.left_by_poses > 0.5, "{rolling:?}");
    let poses = of(DemoOptions { poses: true, ..DemoOptions::default() });
    assert!(poses.left_by_poses < 0.2 && poses.left_by_rows > 0.5, "{poses:?}");
}

/// Checks both models to rounding: directions that a camera with a known twist would observe.
#[test]
fn what_each_explains_is_nothing_but_rounding() {
    let observations = |twist: [f64; 6], rolls: bool| {
        let observation = |i: usize| {
            let wave = |rate: f64| (rate * (i as f64 + 1.0)).sin();
            let columns = columns(DVec3::new(1.5 * wave(1.3), 1.2 * wave(2.1), 4.0 + wave(0.7)));
            let row = 0.5 * wave(1.7);
            let share = if rolls { row } else { 1.0 };
            ShutterObservation { columns, miss: columns.iter().zip(twist).map(|(c, by)| share * by * *c).sum(), row }
        };
        (0..60).map(observation).collect::<Vec<ShutterObservation>>()
    };
    let twist = [0.02, -0.01, 0.015, 0.03, 0.02, -0.05];
    for rolls in [false, true] {
        let mut observations = observations(twist, rolls);
        let given: f64 = observations.iter().map(|observation| observation.miss.length()).sum();
        let [poses, rows] = [left(&observations, |_| 1.0), left(&observations, |observation| observation.row)];
        let (right, other) = if rolls { (rows, poses) } else { (poses, rows) };
        assert!(right < 1e-9 * given && other > 0.3 * given, "{right} and {other} of {given}");
        // One of ten observations is wrong, which plain least squares would follow.
        for observation in observations.iter_mut().step_by(10) {
            observation.miss += DVec3::new(0.5, -0.3, 0.0);
        }
        let left =
            if rolls { left(&observations, |observation| observation.row) } else { left(&observations, |_| 1.0) };
        let nonsense = 6.0 * DVec3::new(0.5, -0.3, 0.0).length();
        assert!((left / nonsense - 1.0).abs() < 0.05, "{left} of {nonsense}");
    }
}

/// There is no evidence without tracks, from few observations (six numbers explain them), or from a point at the
/// camera's centre.
#[test]
fn nothing_is_said_without_tracks() {
    let folder = tempfile::tempdir().unwrap();
    let small = DemoOptions { width: 32, height: 24, views: 3, points: 0, ..DemoOptions::default() };
    demo::write(folder.path(), &small).unwrap();
    assert!(evidence(&Capture::load(folder.path()).unwrap()).is_none());
    demo::write(folder.path(), &DemoOptions { points: FEWEST - 1, poses: true, ..small }).unwrap();
    assert!(evidence(&Capture::load(folder.path()).unwrap()).is_none());
    demo::write(folder.path(), &DemoOptions { points: 100, poses: true, ..small }).unwrap();
    let mut capture = Capture::load(folder.path()).unwrap();
    let seen = |point: &usize| capture.tracks.of(*point).iter().any(|observation| observation.view == 1);
    let point = (0..100).find(seen).unwrap();
    capture.points.positions[point] = capture.views[1].cam_from_world.inverse().translation.as_vec3().to_array();
    let found = evidence(&capture).unwrap();
    assert!(found.left_by_poses.is_finite() && found.left_by_rows.is_finite(), "{found:?}");
}
