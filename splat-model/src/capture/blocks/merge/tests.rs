use super::*;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{GroupOptions, GroupRows};

fn halves() -> [Bounds; 2] {
    Bounds::everything(glam::DMat3::from_rotation_z(0.7)).cut(0, 0.25)
}

fn kept(cell: &Bounds, rows: &GaussianRows) -> GaussianRows {
    let mut kept = GaussianRows::like(rows);
    keep(cell, rows, &mut kept);
    kept
}

/// Two blocks that end with the same scene merge to a scene of the same optical depth at every Gaussian.
#[test]
fn parts_of_a_gaussian_add_up_to_it() {
    let mut rows = random_rows(300, 1, 3);
    for (i, log) in rows.log_scales.iter_mut().enumerate() {
        *log = [(0.01 * i as f32).ln_1p() - 2.0; 3];
    }
    let depth = |rows: &GaussianRows, i: usize| f64::from(rows.logit_opacities[i].exp()).ln_1p();
    let parts = halves().map(|cell| kept(&cell, &rows));
    let mut cut = 0;
    for i in 0..rows.len() {
        let found: Vec<f64> = (parts.iter())
            .flat_map(|part| (0..part.len()).filter(|&k| part.means[k] == rows.means[i]).map(|k| depth(part, k)))
            .collect();
        cut += usize::from(found.len() == 2);
        let (sum, whole) = (found.iter().sum::<f64>(), depth(&rows, i));
        assert!((sum / whole - 1.0).abs() < 2.0 * NEGLIGIBLE, "Gaussian {i}: {sum} of {whole}");
    }
    assert!(cut > 10 && cut < 290, "{cut} lie across the border");
}

/// Small Gaussians belong to the cell that holds their centres, and are not changed, nor are their further groups.
#[test]
fn small_gaussians_are_kept_as_they_are() {
    let mut rows = random_rows(200, 1, 4);
    rows.log_scales.fill([-12.0; 3]);
    let values = (0..400).map(|i| i as f32).collect();
    rows.groups = vec![GroupRows { name: "features".into(), width: 2, values, options: GroupOptions::default() }];
    let [below, above] = halves();
    let inside = |cell: &Bounds| {
        (0..rows.len()).filter(|&i| cell.contains(Vec3::from(rows.means[i]).as_dvec3())).collect::<Vec<_>>()
    };
    for cell in [below, above] {
        let expected = inside(&cell);
        let found = kept(&cell, &rows);
        assert!(!expected.is_empty() && found.len() == expected.len());
        for (now, &was) in expected.iter().enumerate() {
            assert_eq!((found.means[now], found.logit_opacities[now]), (rows.means[was], rows.logit_opacities[was]));
            assert_eq!(found.groups[0].values[2 * now..][..2], rows.groups[0].values[2 * was..][..2]);
        }
    }
}

#[test]
fn opacities_of_any_size_can_be_shared() {
    for logit in [-80.0_f32, -10.0, 0.0, 5.0, 80.0] {
        let half = thinned(logit, 0.5);
        let depth = |logit: f32| f64::from(logit).max(0.0) + (-f64::from(logit).abs()).exp().ln_1p();
        assert!(half.is_finite() && (2.0 * depth(half) / depth(logit) - 1.0).abs() < 1e-4, "{logit}: {half}");
    }
    let mut rows = random_rows(1, 0, 5);
    rows.rotations[0] = [0.0; 4];
    assert_eq!(kept(&halves()[0], &rows).len(), 0, "what cannot be rendered is not kept");
}
