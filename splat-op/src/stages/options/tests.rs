use super::*;

#[test]
fn without_a_cut_there_is_a_most_of_pairs_and_the_message_names_it() {
    let uncut = RenderOptions::exact().with_alpha_min(0.0);
    // A picture of 32,768 × 32,768 px.
    let tiles = 2048 * 2048;
    assert_eq!(uncut.check_uncut(16, tiles), Ok(()));
    let message = uncut.check_uncut(17, tiles).expect_err("one too many").to_string();
    for part in
        ["`alpha_min`", "17 Gaussians", "71303168 pairs", &MAX_UNCULLED_INTERSECTIONS.to_string(), "fewer Gaussians"]
    {
        assert!(message.contains(part), "`{part}` is missing: {message}");
    }
    assert!(uncut.check_uncut(usize::MAX, 2).is_err(), "a product beyond all numbers");
    assert_eq!(RenderOptions::exact().check_uncut(usize::MAX, tiles), Ok(()), "with a cut the lists tell");
}

#[test]
fn every_field_has_a_builder_that_sets_it_alone() {
    let built = RenderOptions::standard()
        .with_blur(0.1)
        .with_near(0.2)
        .with_far(9.0)
        .with_radius_clip(1.5)
        .with_jacobian_margin(0.4)
        .with_antialias(true)
        .with_sh_degree(Some(1))
        .with_projection(Projection::RayMax)
        .with_alpha_min(0.01)
        .with_alpha_max(0.9)
        .with_transmittance_min(0.02)
        .with_accumulation(Accumulation::Ordered)
        .with_lists(ListLength::Expected)
        .with_depth(true)
        .with_expected_depth(true)
        .with_normals(true)
        .with_radii(true)
        .with_visible(true);
    let expected = RenderOptions {
        blur: 0.1,
        near: 0.2,
        far: 9.0,
        radius_clip: 1.5,
        jacobian_margin: 0.4,
        antialias: true,
        sh_degree: Some(1),
        projection: Projection::RayMax,
        alpha_min: 0.01,
        alpha_max: 0.9,
        transmittance_min: 0.02,
        accumulation: Accumulation::Ordered,
        lists: ListLength::Expected,
        depth: true,
        expected_depth: true,
        normals: true,
        radii: true,
        visible: true,
    };
    assert_eq!(built, expected);
}

#[test]
fn presets_differ_in_their_cuts_alone() {
    let standard = RenderOptions::standard();
    for preset in [RenderOptions::fast(), RenderOptions::exact()] {
        assert_eq!(preset.check(), Ok(()));
        let RenderOptions { alpha_min, transmittance_min, .. } = preset;
        assert!(alpha_min != standard.alpha_min && transmittance_min != standard.transmittance_min);
        assert_eq!(standard.with_alpha_min(alpha_min).with_transmittance_min(transmittance_min), preset);
    }
}
