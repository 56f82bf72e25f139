use splat_model::accuracy::Dial;

use super::super::reference::ReferenceRender;
use super::super::reference::tests::{photos, rows};
use super::*;

#[test]
fn black_points_have_one_gradient_in_both_float_types() {
    let mut rows = rows(20);
    rows.sh_rest.fill(0.0);
    // Value of a point that is black in this channel.
    rows.sh_dc.iter_mut().for_each(|colour| colour[1] = -1.772_453_8);
    let settled = off_the_clamp(&rows);
    assert!(settled.sh_dc.iter().zip(&rows.sh_dc).all(|(new, old)| new[0] == old[0] && new[1] < old[1]));
    let (photos, options) = (photos(), Dial::all_exact(RenderOptions::standard()));
    let moved = |rows: &GaussianRows| {
        let place = DeviceScene::in_f64(rows, &photos, [0.0; 3]).unwrap();
        let truth = ReferenceRender::new(&place, &photos, &options, || ()).unwrap();
        let green = truth.gradients[4].iter().skip(1).step_by(3);
        (green.fold(0.0_f64, |most, value| most.max(value.abs())), truth.pictures)
    };
    let ((before, theirs), (after, ours)) = (moved(&rows), moved(&settled));
    assert!(before > 1e-3 && after == 0.0, "{before}, {after}");
    for (ours, theirs) in ours.iter().flatten().zip(theirs.iter().flatten()) {
        assert!((ours - theirs).abs() < 1e-6);
    }
}
