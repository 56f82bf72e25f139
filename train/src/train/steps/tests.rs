use super::*;

#[test]
fn checkpoints_are_due_by_steps_and_by_time() {
    let (short, long) = (Duration::from_secs(119), Duration::from_secs(120));
    let due = |every| [(6, short), (7, short), (6, long)].map(|(step, since)| is_checkpoint_due(every, step, since));
    assert_eq!(due(None), [false, false, true]);
    assert_eq!(due(Some(7)), [false, true, true]);
    assert_eq!(due(Some(0)), [false; 3]);
}

/// Steps take a second each. Returns the steps at which scores were taken, each of which took `each_s`, and the share of the time that they took.
fn taken(steps: usize, each_s: f64) -> (Vec<usize>, f64) {
    let mut taken = Vec::new();
    for step in 1..=steps {
        if scores_by_itself(step, steps, each_s * (taken.len() + 1) as f64, step as f64) {
            taken.push(step);
        }
    }
    let share = each_s * taken.len() as f64 / steps as f64;
    (taken, share)
}

#[test]
fn scores_are_taken_at_ten_steps_while_they_take_a_fiftieth_of_the_time() {
    assert_eq!(taken(2_000, 4.0).0, (1..=10).map(|tenth| 200 * tenth).collect::<Vec<_>>());
    assert_eq!(taken(505, 1.0).0, [51, 101, 152, 202, 253, 303, 354, 404, 455, 505]);
    assert_eq!(taken(2_000, 8.0).0, [400, 800, 1_200, 1_600, 2_000]);
    assert_eq!(taken(2_000, 40.1).0, [0; 0]);
    for (steps, each_s) in [(1_500, 4.0), (30_000, 100.0), (100, 0.3), (7, 0.1)] {
        let (taken, share) = taken(steps, each_s);
        assert!(!taken.is_empty() && share <= SCORING_SHARE, "{steps} {each_s}: {taken:?} {share}");
    }
}
