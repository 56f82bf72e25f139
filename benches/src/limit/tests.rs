use super::*;

const MACHINE: Machine = Machine { bandwidth: 1e9, operations: Some(1e9) };

/// A picture of 10 pixels with 5 Gaussians, 4 of them visible.
const SIZES: Sizes =
    Sizes { splats: 5.0, visible: 4.0, pixels: 10.0, intersections: 6.0, contributions: 30.0, degree: 3 };

#[test]
fn bytes_are_those_counted_by_hand() {
    let bytes = |kind| SIZES.work(kind).bytes;
    // Five centres, and 8 further parameters and 7 columns of four Gaussians.
    assert_eq!(bytes(PassKind::Project), 4.0 * (5.0 * 3.0 + 4.0 * (8.0 + 7.0)));
    // 48 harmonics, centre, colour.
    assert_eq!(bytes(PassKind::Sh), 4.0 * 4.0 * 54.0);
    assert_eq!(bytes(PassKind::Intersect), 4.0 * (4.0 * 7.0 + 6.0));
    // Ellipses, colours, lists; four planes.
    assert_eq!(bytes(PassKind::Rasterize), 4.0 * (4.0 * 10.0 + 6.0 + 40.0));
    assert_eq!(bytes(PassKind::RasterizeBackward), 4.0 * (4.0 * 10.0 * 2.0 + 6.0 + 40.0));
    assert_eq!(bytes(PassKind::Loss), 4.0 * 90.0);
    // 59 parameters: three arrays read, three written, and the gradients of the visible Gaussians.
    assert_eq!(bytes(PassKind::Adam), 4.0 * 59.0 * (5.0 * 6.0 + 4.0));
}

#[test]
fn operations_are_those_counted_by_hand() {
    let operations = |kind| SIZES.work(kind).operations;
    assert_eq!(PROJECT, 179.0);
    assert_eq!(PROJECT_BACKWARD, 438.0);
    // Only the centre of the invisible Gaussian is transformed.
    assert_eq!(operations(PassKind::Project), 4.0 * 179.0 + 18.0);
    // Direction 13, basis 43, 48 fused multiply-adds, 3 clamps.
    assert_eq!(operations(PassKind::Sh), 4.0 * (13.0 + 43.0 + 96.0 + 3.0));
    assert_eq!(operations(PassKind::Rasterize), 30.0 * (35.0 + 7.0));
    // A comparison per doubling, a box, and an ellipse against a tile.
    assert_eq!(operations(PassKind::Intersect), 4.0 * (2.0 + 39.0) + 6.0 * 16.0);
    // Six windowed maps of 32 operations, 32 others.
    assert_eq!(operations(PassKind::Loss), 10.0 * 3.0 * (6.0 * 32.0 + 32.0));
    assert_eq!(operations(PassKind::RasterizeBackward), 30.0 * 63.0 + 4.0 * 9.0);
    // The colour again 152, the harmonics 48, the basis' gradient from 16 dot products 80 and its derivative 105, the direction 14.
    assert_eq!(operations(PassKind::ShBackward), 4.0 * (152.0 + 48.0 + 80.0 + 105.0 + 14.0));
    assert_eq!(operations(PassKind::Adam), 59.0 * 5.0 * 10.0);
}

#[test]
fn a_degree_of_zero_has_no_direction() {
    let zero = Sizes { degree: 0, ..SIZES };
    assert_eq!(zero.work(PassKind::Sh).bytes, 4.0 * 4.0 * 9.0);
    assert_eq!(zero.work(PassKind::ShBackward).operations, 4.0 * (13.0 + 6.0 + 3.0));
}

#[test]
fn work_grows_with_what_it_is_made_of() {
    for kind in PassKind::PARTS.into_iter().chain([PassKind::Step]) {
        let more = |sizes: Sizes| {
            let (less, more) = (SIZES.work(kind), sizes.work(kind));
            more.bytes >= less.bytes && more.operations >= less.operations
        };
        assert!(more(Sizes { splats: 6.0, ..SIZES }), "{kind:?}");
        assert!(more(Sizes { splats: 6.0, visible: 5.0, ..SIZES }), "{kind:?}");
        assert!(more(Sizes { pixels: 11.0, ..SIZES }), "{kind:?}");
        assert!(more(Sizes { intersections: 7.0, ..SIZES }), "{kind:?}");
        assert!(more(Sizes { contributions: 31.0, ..SIZES }), "{kind:?}");
        assert!(SIZES.work(kind).bytes > 0.0 && SIZES.work(kind).operations > 0.0, "{kind:?}");
    }
    for degree in 0..4 {
        let [lower, higher] = [degree, degree + 1].map(|degree| Sizes { degree, ..SIZES }.work(PassKind::Step));
        assert!(higher.bytes > lower.bytes && higher.operations > lower.operations, "{degree}");
    }
}

#[test]
fn the_longer_of_moving_and_computing_limits() {
    let work = LeastWork { bytes: 2e9, operations: 3e9 };
    assert_eq!(work.seconds(&MACHINE), 3.0);
    assert_eq!(work.seconds(&Machine { operations: Some(1e10), ..MACHINE }), 2.0);
    assert_eq!(work.seconds(&Machine { operations: None, ..MACHINE }), 2.0);
}

#[test]
fn a_step_is_limited_by_each_of_its_parts() {
    let parts: f64 = PassKind::PARTS.into_iter().map(|part| SIZES.limit(part, &MACHINE)).sum();
    assert_eq!(SIZES.limit(PassKind::Step, &MACHINE), parts);
    // Some parts are bound by memory and others by arithmetic.
    assert!(parts > SIZES.work(PassKind::Step).seconds(&MACHINE));
}

#[test]
fn this_machine_has_rates_that_machines_have() {
    let Machine { bandwidth, operations } = Machine::measure();
    assert!((1e8..1e13).contains(&bandwidth), "{bandwidth} bytes per second");
    assert!(operations.is_some_and(|rate| (1e8..1e14).contains(&rate)), "{operations:?} operations per second");
}
