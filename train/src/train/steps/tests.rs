use super::*;

#[test]
fn checkpoints_are_due_by_steps_and_by_time() {
    let (short, long) = (Duration::from_secs(119), Duration::from_secs(120));
    let due = |every| [(6, short), (7, short), (6, long)].map(|(step, since)| is_checkpoint_due(every, step, since));
    assert_eq!(due(None), [false, false, true]);
    assert_eq!(due(Some(7)), [false, true, true]);
    assert_eq!(due(Some(0)), [false; 3]);
}

#[test]
fn ten_scores_are_taken_where_they_cost_little() {
    let steps = |steps: usize, views: usize, share: f64| {
        (1..=steps).filter(|&step| scores_by_itself(step, steps, views, share)).collect::<Vec<_>>()
    };
    assert_eq!(steps(2_000, 9, 0.0), (1..=10).map(|tenth| 200 * tenth).collect::<Vec<_>>());
    assert_eq!(steps(505, 1, 0.02), [51, 101, 152, 202, 253, 303, 354, 404, 455, 505]);
    for (count, views, share) in [(1_999, 4, 0.0), (499, 1, 0.0), (30_000, 0, 0.0), (30_000, 4, 0.021)] {
        assert!(steps(count, views, share).is_empty(), "{count} {views} {share}");
    }
}
