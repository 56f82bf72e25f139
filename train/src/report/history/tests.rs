use super::*;

/// Scores of one view, as an earlier version wrote them.
const SCORES: &str = r#"{"psnr": 20.0, "ssim": 0.5, "psnr_corrected": 21.0, "ssim_corrected": 0.6, "views": [
        {"name": "a.png", "psnr": 20.0, "ssim": 0.5, "psnr_corrected": 21.0, "ssim_corrected": 0.6}]}"#;

fn run(steps: usize, history: History, until: usize) -> History {
    let mut recorder = Recorder::new(steps, history, 0.0);
    let done = recorder.history.points.last().map_or(0, |point| point.step);
    for step in done + 1..=until {
        recorder.add(step as f64, 1);
        if recorder.is_due(step) {
            recorder.keep(step, 10 * step);
        }
    }
    recorder.history
}

#[test]
fn short_runs_have_every_step_and_long_ones_even_means() {
    let short = run(7, History::default(), 7);
    assert_eq!(short.points.iter().map(|point| point.step).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7]);
    let long = run(1001, History::default(), 1001);
    assert_eq!(long.points.len(), 201, "every fifth and the last");
    let (first, last) = (long.points[0], long.points[200]);
    assert_eq!((first.step, first.loss, first.splats), (5, 3.0, 50));
    assert_eq!((last.step, last.loss), (1001, 1001.0));
    assert!(run(30_000, History::default(), 30_000).points.len() <= POINTS + 1);
}

#[test]
fn a_run_in_two_parts_has_the_history_of_one() {
    let without_times =
        |history: History| history.points.iter().map(|p| (p.step, p.loss, p.splats)).collect::<Vec<_>>();
    let first = run(1000, History::default(), 500);
    assert_eq!(without_times(run(1000, first, 1000)), without_times(run(1000, History::default(), 1000)));
}

#[test]
fn time_goes_on_where_it_was_and_stands_still_while_scores_are_taken() {
    let mut recorder = Recorder::new(9, History::default(), 100.0);
    assert!((100.0..101.0).contains(&recorder.seconds()));
    std::thread::sleep(Duration::from_millis(30));
    let scores: Scores = serde_json::from_str(SCORES).unwrap();
    let score = recorder.keep_score(2, &scores, Duration::from_millis(30));
    assert_eq!((score.psnr, score.ssim, score.lpips, score.views), (20.0, 0.5, None, 1));
    assert!((100.0..100.025).contains(&score.seconds), "{score:?}");
    // Nor does the clock go back.
    let score = recorder.keep_score(2, &scores, Duration::from_secs(3600));
    assert!(score.seconds >= 100.0, "{score:?}");
    for seconds in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(Recorder::new(9, History::default(), seconds).seconds() < 1.0);
    }
}

#[test]
fn what_is_written_is_read_again() {
    let mut history = run(3, History::default(), 3);
    history.scores.push(HistoryScore { step: 2, seconds: 0.5, psnr: 20.0, ssim: 0.9, lpips: Some(0.25), views: 4 });
    let text = serde_json::to_string(&history).unwrap();
    assert_eq!(serde_json::from_str::<History>(&text).unwrap(), history);
    history.points[0].loss = f64::NAN;
    let text = serde_json::to_string(&history).unwrap();
    assert!(serde_json::from_str::<History>(&text).unwrap().points[0].loss.is_nan());
}
