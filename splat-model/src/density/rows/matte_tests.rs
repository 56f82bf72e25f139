//! Rows in two groups. A scene in one group, in which rows are the same but for zeros, is what they are held to.

use burn::tensor::Device;

use super::tests::{all, all_tracked, numbers, random_gradients, step, walked};
use super::*;
use crate::gaussians::testing::{devices, random_rows};

/// What belongs to each row, in words: means, opacities, coefficients of degree 0, of all degrees (zeros for matte ones), each with
/// both moments.
fn by_row(scene: &Trained) -> Vec<Vec<f32>> {
    let (g, m) = (&scene.gaussians, &scene.moments);
    let count = g.len();
    let mut rows = vec![Vec::new(); count];
    let mut enter = |of: &[f32], first: usize, width: usize, full: usize| {
        for (row, values) in rows[first..].iter_mut().zip(of.chunks_exact(width)) {
            row.extend_from_slice(values);
            row.resize(row.len() + full - width, 0.0);
        }
    };
    let full = 3 * (g.sh_degree() + 1).pow(2);
    numbers(&g.means, &m.means).iter().for_each(|of| enter(of, 0, 3, 3));
    numbers(&g.rotations, &m.rotations).iter().for_each(|of| enter(of, 0, 4, 4));
    numbers(&g.log_scales, &m.log_scales).iter().for_each(|of| enter(of, 0, 3, 3));
    numbers(&g.logit_opacities, &m.logit_opacities).iter().for_each(|of| enter(of, 0, 1, 1));
    let matte = g.sh_matte.as_ref().zip(m.sh_matte.as_ref()).map(|(param, moments)| numbers(param, moments));
    for (i, of) in numbers(&g.sh, &m.sh).iter().enumerate() {
        enter(&of[..full * g.directional()], 0, full, full);
        if let Some(matte) = &matte {
            enter(&matte[i], g.directional(), 3, full);
        }
    }
    rows
}

/// The same row with zeros for the higher coefficients and their moments.
fn without_directions(row: &[f32], degree: usize) -> Vec<f32> {
    let (mut row, full) = (row.to_vec(), 3 * (degree + 1usize).pow(2));
    let first = row.len() - 3 * full;
    row[first..].chunks_exact_mut(full).for_each(|of| of[3..].fill(0.0));
    row
}

/// A scene with history of which rows 4 to 8 are matte, once 1, 2, 5, 6 and 8 of nine.
fn parted(device: &Device) -> Trained {
    let mut scene = walked(&random_rows(9, 2, 1), device);
    scene.make_matte(&[1, 2, 5, 6, 8]);
    scene
}

#[test]
fn rows_that_become_matte_keep_all_but_their_higher_coefficients() {
    for device in devices() {
        let mut scene = walked(&random_rows(9, 2, 1), &device);
        let before = by_row(&scene);
        assert_eq!(scene.make_matte(&[]), (0..9).collect::<Vec<u32>>());
        assert!(by_row(&scene) == before && scene.gaussians.sh_matte.is_none());

        let order = scene.make_matte(&[2, 5, 6]);
        assert_eq!(order, [0, 1, 3, 4, 7, 8, 2, 5, 6]);
        let expected = |order: &[u32], first: usize, before: &[Vec<f32>]| -> Vec<Vec<f32>> {
            let row = |(now, was): (usize, &u32)| match now < first {
                true => before[*was as usize].clone(),
                false => without_directions(&before[*was as usize], 2),
            };
            order.iter().enumerate().map(row).collect()
        };
        assert_eq!(by_row(&scene), expected(&order, 6, &before));
        assert_eq!(scene.gaussians.sh.val().dims(), [6, 9, 3]);
        assert_eq!(scene.gaussians.sh_matte.as_ref().unwrap().val().dims(), [3, 1, 3]);
        assert!(all_tracked(&scene.gaussians));

        // Others later come before those that are matte already.
        let before = by_row(&scene);
        let order = scene.make_matte(&[0, 5]);
        assert_eq!(order, [1, 2, 3, 4, 0, 5, 6, 7, 8]);
        assert_eq!(by_row(&scene), expected(&order, 4, &before));
        // And at last all of them.
        let order = scene.make_matte(&[0, 1, 2, 3]);
        assert_eq!((order.len(), scene.gaussians.directional(), scene.gaussians.sh_degree()), (9, 0, 2));
        let gradients = random_gradients(&scene.gaussians);
        step(&mut scene, gradients, 4);
        assert_eq!(scene.gaussians.to_rows().sh_rest, [0.0; 9 * 24]);
    }
}

#[test]
fn an_edit_keeps_both_kinds_together_with_their_moments() {
    for device in devices() {
        let start = parted(&device);
        let before = by_row(&start);
        let (add, add_matte) = (random_rows(2, 2, 2), random_rows(3, 0, 3));
        let added = |rows: &GaussianRows| by_row(&Trained::new(Gaussians::from_rows(rows, &device).unwrap()));
        // Matte rows of degree 0 as rows of degree 2.
        let degree_2 = GaussianRows { sh_degree: 2, sh_rest: vec![0.0; 3 * 24], ..add_matte.clone() };
        for (keep, come, come_matte) in [
            (vec![7, 2, 8, 0, 5], true, true),
            (vec![7, 2, 8, 0, 5], false, false),
            (vec![3, 1], true, true),
            (vec![3, 1], true, false),
            (vec![4, 6], false, true),
            (vec![4, 6], true, false),
            (vec![], true, true),
            (vec![], false, false),
        ] {
            let none = || GaussianRows::default();
            let mut scene = start.clone();
            let edit = RowEdit {
                keep: keep.clone(),
                add: if come { add.clone() } else { none() },
                add_matte: if come_matte { add_matte.clone() } else { none() },
            };
            scene.edit(&edit).unwrap();
            let kept =
                |matte: bool| keep.iter().filter(move |row| (**row >= 4) == matte).map(|row| &before[*row as usize]);
            let mut expected: Vec<Vec<f32>> = kept(false).cloned().collect();
            expected.extend(if come { added(&add) } else { vec![] });
            let directional = expected.len();
            expected.extend(kept(true).cloned());
            expected.extend(if come_matte { added(&degree_2) } else { vec![] });
            let what = format!("{keep:?}, {come}, {come_matte}");
            assert!(by_row(&scene) == expected, "{what}");
            assert_eq!(scene.gaussians.directional(), directional, "{what}");
            assert_eq!(scene.gaussians.sh_matte.is_some(), directional < expected.len(), "{what}");
            assert!(all_tracked(&scene.gaussians), "{what}");
            let gradients = random_gradients(&scene.gaussians);
            step(&mut scene, gradients, 4);
        }
    }
}

#[test]
fn a_step_moves_matte_rows_as_if_they_had_zeros() {
    for device in devices() {
        let mut scene = parted(&device);
        let rows = scene.gaussians.to_rows();
        // The same in one group: its history is that of the parted one.
        let mut whole = Trained::new(Gaussians::from_rows(&rows, &device.clone().autodiff()).unwrap());
        let padded = |sh: &Tensor<3>, matte: &Tensor<3>| {
            let zeros = Tensor::zeros([matte.dims()[0], sh.dims()[1] - 1, 3], &sh.device());
            Tensor::cat(vec![sh.clone(), Tensor::cat(vec![matte.clone(), zeros], 1)], 0)
        };
        let matte = scene.moments.sh_matte.clone().unwrap();
        whole.moments = GaussianMoments {
            sh: Moments { m: padded(&scene.moments.sh.m, &matte.m), v: padded(&scene.moments.sh.v, &matte.v) },
            sh_matte: None,
            ..scene.moments.clone()
        };
        assert_eq!(by_row(&whole), by_row(&scene));
        for number in 4..=6 {
            let gradients = random_gradients(&scene.gaussians);
            let (sh, matte) = (gradients.sh.clone().unwrap(), gradients.sh_matte.clone().unwrap());
            let same = Gradients {
                means: gradients.means.clone(),
                rotations: gradients.rotations.clone(),
                log_scales: gradients.log_scales.clone(),
                logit_opacities: gradients.logit_opacities.clone(),
                sh: Some(padded(&sh, &matte)),
                sh_matte: None,
            };
            step(&mut scene, gradients, number);
            step(&mut whole, same, number);
        }
        assert_eq!(by_row(&whole), by_row(&scene));
        assert_ne!(scene.gaussians.to_rows().sh_dc, rows.sh_dc);
    }
}

#[test]
fn harmonics_grow_where_they_vary() {
    for device in devices() {
        let mut scene = parted(&device);
        let before = all(&scene);
        scene.grow_sh(3);
        assert_eq!(scene.gaussians.sh.val().dims(), [4, 16, 3]);
        assert_eq!(all(&scene).last(), before.last());
        assert_eq!(scene.gaussians.to_rows().sh_degree, 3);
        // So they do where nothing varies, for those who look.
        scene.make_matte(&[0, 1, 2, 3]);
        scene.grow_sh(4);
        assert_eq!((scene.gaussians.sh_degree(), scene.gaussians.to_rows().sh_rest.len()), (4, 9 * 72));
    }
}
