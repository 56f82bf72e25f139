use super::*;

#[test]
fn a_stray_moves_neither_middle_nor_radius() {
    let ring = |count: usize| (0..count).map(|i| DVec3::new((i as f64).cos(), (i as f64).sin(), 7.0) * 3.0);
    for count in [3, 4, 5, 9, 10, 17, 40] {
        let clean = Spread::of(&ring(count).collect::<Vec<_>>()).unwrap();
        for stray in [DVec3::splat(1e6), DVec3::new(-2e4, 0.0, 0.0), DVec3::NAN] {
            let mut centres: Vec<DVec3> = ring(count).collect();
            centres.insert(count / 2, stray);
            let found = Spread::of(&centres).unwrap();
            let moved = found.middle.distance(clean.middle) + (found.radius - clean.radius).abs();
            assert!(moved < 1e-9 && !found.holds(stray), "{count} and {stray}: {found:?} instead of {clean:?}");
        }
    }
    assert!(Spread::of(&[]).is_none() && Spread::of(&[DVec3::NAN]).is_none());
}

#[test]
fn few_cameras_and_uneven_ones_all_count() {
    let of = |along: &[f64]| Spread::of(&along.iter().map(|x| DVec3::X * *x).collect::<Vec<_>>()).unwrap().radius;
    assert_eq!([of(&[4.0]), of(&[-1.0, 3.0]), of(&[2.0; 5])], [0.0, 2.0, 0.0]);
    assert_eq!([of(&[0.0, 1.0, 5.0]), of(&[0.0, 0.1, 0.3, 1.0, 1.2, 3.6])], [3.0, 3.6 - 6.2 / 6.0]);
}
