use super::*;
use crate::gaussians::values_of;
use crate::metrics::{LARGEST_PSNR_DB, lpips};
use crate::trainer::testing::{HEIGHT, WIDTH, photos, scene};

#[test]
fn a_scene_scores_full_marks_on_its_own_renders() {
    let device = Device::flex();
    for background in [[0.0; 3], [0.2, 0.5, 0.9]] {
        let photos = photos(background);
        let scores = evaluate(
            &scene(&device).splats(),
            &photos,
            &Background::Colour(background),
            &RenderOptions::standard(),
            |_, _| {},
        )
        .unwrap();
        // Photographs hold bytes. Errors that are uniform over the width of a level give 58.9 dB, and uniform areas give less.
        assert!(scores.views.iter().all(|view| view.psnr > 58.0 && view.ssim > 0.999), "{scores:?}");
    }
    // Gaussians of the background's colour give values that bytes represent exactly, so nothing is lost.
    let background = [51.0 / 255.0, 102.0 / 255.0, 1.0];
    let mut photos = photos([0.0; 3]);
    photos.iter_mut().for_each(|photo| photo.rgb = [51, 102, 255].repeat(WIDTH * HEIGHT));
    let colours = Tensor::<1>::from_floats(background, &device).unsqueeze::<2>().repeat_dim(0, 30);
    let splats = Splats { colour: splat_op::Colour::Features(colours), ..scene(&device).splats() };
    let scores =
        evaluate(&splats, &photos, &Background::Colour(background), &RenderOptions::standard(), |_, _| {}).unwrap();
    assert!(scores.views.iter().all(|view| view.psnr == LARGEST_PSNR_DB), "{scores:?}");
    assert_eq!(scores.psnr, LARGEST_PSNR_DB);
    assert!((scores.ssim - 1.0).abs() < 1e-5, "{}", scores.ssim);
}

#[test]
fn names_and_order_are_those_of_the_photographs() {
    let device = Device::flex();
    let photos = photos([0.0; 3]);
    let mut looked = Vec::new();
    let splats = scene(&device).splats();
    // The background differs from that of the photographs, so that views differ in their scores.
    let scores =
        evaluate(&splats, &photos, &Background::Colour([0.5; 3]), &RenderOptions::standard(), |comparison, score| {
            assert_eq!(comparison.photo.name, score.name);
            assert_eq!(comparison.image.dims(), [HEIGHT, WIDTH, 3]);
            let truth = values_of(comparison.truth.clone());
            assert!(truth.iter().zip(&comparison.photo.rgb).all(|(value, byte)| *value == f32::from(*byte) / 255.0));
            looked.push(score.clone());
        });
    let scores = scores.unwrap();
    assert_eq!(scores.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), ["c", "a", "d", "b"]);
    assert_eq!(looked, scores.views);
    let mean = |of: fn(&ViewScore) -> f64| scores.views.iter().map(of).sum::<f64>() / 4.0;
    assert!(
        (scores.psnr - mean(|view| view.psnr)).abs() < 1e-12 && (scores.ssim - mean(|view| view.ssim)).abs() < 1e-12
    );
    assert!(scores.psnr < 20.0 && scores.views[0].psnr != scores.views[1].psnr, "{scores:?}");
}

#[test]
fn renders_are_clamped_as_a_picture_file_would() {
    let device = Device::flex();
    let splats = scene(&device).splats();
    let bright = Tensor::<2>::full([30, 3], 5.0, &device);
    let splats = Splats { colour: splat_op::Colour::Features(bright), ..splats };
    let mut largest = 0.0;
    evaluate(&splats, &photos([0.0; 3]), &Background::Colour([0.0; 3]), &RenderOptions::standard(), |comparison, _| {
        largest = values_of(comparison.image.clone()).into_iter().fold(largest, f32::max);
    })
    .unwrap();
    assert_eq!(largest, 1.0);
}

#[test]
fn lpips_is_a_number_or_a_reason() {
    let device = Device::flex();
    let mut photos = photos([0.0; 3]);
    let lpips = lpips::tests::read(&lpips::tests::tensors(lpips::Net::Vgg)).unwrap();
    let splats = scene(&device).splats();
    let scores = |photos: &[Photo], lpips| {
        let each = photos.iter().map(Ok::<_, SplatError>);
        // The background differs from that of the photographs, so that the renders differ from them.
        evaluate_each(&splats, each, &Background::Colour([0.5; 3]), &RenderOptions::standard(), lpips, |_, _| {})
            .unwrap()
    };
    let all = scores(&photos, Some(&lpips));
    let values: Vec<f64> = all.views.iter().map(|view| view.lpips.unwrap()).collect();
    assert!(values.iter().all(|value| *value > 1e-4), "{values:?}");
    assert_eq!((all.lpips, all.lpips_missing), (Some(values.iter().sum::<f64>() / 4.0), None));
    assert_eq!(all.lpips_net.as_deref(), Some("vgg"));
    // A mask that excludes nothing has no effect.
    photos[1].mask = Some(vec![true; WIDTH * HEIGHT]);
    photos[2].mask = Some((0..WIDTH * HEIGHT).map(|i| i > 3).collect());
    let some = scores(&photos, Some(&lpips));
    assert_eq!(some.views.iter().map(|view| view.lpips.is_some()).collect::<Vec<_>>(), [true, true, false, true]);
    assert_eq!(some.lpips, None);
    assert!(some.views[2].lpips_missing.as_ref().unwrap().contains("mask"));
    let reason = some.lpips_missing.unwrap();
    assert!(reason.contains("1 of 4") && reason.contains("d: a mask"), "{reason}");
    let none = scores(&photos, None);
    assert!(none.lpips.is_none() && none.lpips_net.is_none() && none.lpips_missing.unwrap().contains("--lpips"));
    assert!(none.views.iter().all(|view| view.lpips.is_none() && view.lpips_missing.is_some()));
    assert_eq!(scores(&[], Some(&lpips)).lpips_missing.as_deref(), Some("there are no views"));
}
