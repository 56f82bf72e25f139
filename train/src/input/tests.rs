use super::*;

#[test]
fn a_scene_stored_far_away_arrives_near_zero() {
    let far = [4_000_000.5, -250_000.25, 12.0];
    let mut rows = GaussianRows { means: vec![far], ..GaussianRows::default() };
    move_means(&mut rows, [-4_000_000.0, 250_000.0, 0.0]);
    assert_eq!(rows.means, [[0.5, -0.25, 12.0]]);
}

#[test]
fn without_a_difference_nothing_changes() {
    let means = vec![[0.1, f32::NAN, -0.0]];
    let mut rows = GaussianRows { means: means.clone(), ..GaussianRows::default() };
    move_means(&mut rows, [0.0; 3]);
    assert_eq!(rows.means[0].map(f32::to_bits), means[0].map(f32::to_bits));
}
