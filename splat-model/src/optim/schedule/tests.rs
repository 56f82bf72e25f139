use super::*;

fn assert_close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1e-300), "{found} instead of {expected}");
}

#[test]
fn the_rate_of_the_centres_falls_geometrically() {
    let rates = LearningRates::default();
    for (done, expected) in [(0.0, 1.6e-4), (0.5, 1.6e-5), (0.25, 1.6e-4 * 0.01f64.powf(0.25)), (1.0, 1.6e-6)] {
        assert_close(rates.after(done).means, expected);
    }
}

#[test]
fn rates_of_batches_grow_with_the_root() {
    let rates = LearningRates::default();
    assert_eq!(rates.for_batch(1), rates);
    let of = |rates: LearningRates| {
        [rates.means, rates.scales, rates.rotations, rates.sh_dc, rates.sh_rest, rates.opacities]
    };
    for (four, one) in of(rates.for_batch(4)).into_iter().zip(of(rates)) {
        assert_close(four, 2.0 * one);
    }
    assert_eq!(rates.for_batch(4).means_final_share, rates.means_final_share);
}

#[test]
fn short_runs_have_higher_rates_that_fall_and_long_ones_the_published_rates() {
    let published = LearningRates::default();
    assert_eq!(LearningRates::for_steps(PUBLISHED_STEPS), published);
    assert_eq!(LearningRates::for_steps(90_000), published);
    assert_eq!(LearningRates { means: published.means, ..published.after(0.7) }, published);
    let quarter = LearningRates::for_steps(PUBLISHED_STEPS / 4);
    for (share, factor) in [(0.0, 2.0), (0.5, 1.0), (1.0, 0.5)] {
        let rates = quarter.after(share);
        assert_close(rates.means, 2.0 * published.means * 0.01_f64.powf(share));
        let of = |rates: LearningRates| [rates.scales, rates.rotations, rates.sh_dc, rates.sh_rest, rates.opacities];
        of(rates).into_iter().zip(of(published)).for_each(|(now, was)| assert_close(now, factor * was));
    }
    assert_eq!(quarter.means_final_share, published.means_final_share);
    assert_close(LearningRates::for_steps(1).scales, 3.0 * published.scales);
    assert_close(LearningRates::for_steps(0).scales, 3.0 * published.scales);
}

#[test]
fn degrees_of_a_short_run_rise_by_eighths() {
    assert_eq!([0, 7, 2_000, 8_000, 30_000].map(sh_every_for), [1, 1, 250, 1_000, 1_000]);
}

#[test]
fn sh_degree_rises_by_one_per_thousand_steps() {
    let degrees = [0, 999, 1_000, 2_500, 3_000, 50_000].map(|step| sh_degree_at(step, STEPS_PER_SH_DEGREE, 3));
    assert_eq!(degrees, [0, 0, 1, 2, 3, 3]);
    assert_eq!(sh_degree_at(0, 0, 2), 2);
}

#[test]
fn extent_is_the_padded_radius_of_the_cameras() {
    let centres = [DVec3::new(-1.0, 0.0, 0.0), DVec3::new(3.0, 0.0, 0.0)];
    assert_close(scene_extent(&centres), 2.2);
    let far = DVec3::new(4e6, 5e6, 1e3);
    assert!((scene_extent(&centres.map(|centre| centre + far)) - 2.2).abs() < 1e-8);
}

#[test]
fn the_near_plane_shrinks_with_small_scenes_alone() {
    assert_eq!([near_plane(1e3), near_plane(1.0)], [0.01; 2]);
    assert_close(near_plane(4e-3), 4e-5);
}

#[test]
fn extent_falls_back_to_one() {
    assert_eq!(scene_extent(&[]), 1.0);
    assert_eq!(scene_extent(&[DVec3::new(0.1, 0.2, 0.3)]), 1.0);
    assert_eq!(scene_extent(&[DVec3::new(0.1, 1e6, 0.3); 7]), 1.0);
    let ulp_apart = [DVec3::new(0.1, 1e6, 0.3), DVec3::new(0.1, 1e6 * (1.0 + f64::EPSILON), 0.3)];
    assert_eq!(scene_extent(&ulp_apart), 1.0);
    assert_eq!(scene_extent(&[DVec3::NAN, DVec3::ONE]), 1.0);
}
