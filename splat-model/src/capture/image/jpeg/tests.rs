use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};

use super::*;

/// 40 × 27 px with half the colours along each axis, codes of its own, and a restart marker after every two units, by Pillow 13: progressive
/// in ten scans, and sequential.
const BY_PILLOW: [&[u8]; 2] = [include_bytes!("progressive.jpg"), include_bytes!("sequential.jpg")];

fn encoded(width: u32, height: u32, quality: u8) -> Vec<u8> {
    let noise = |x: u32, y: u32| (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503).rotate_left(7)) >> 13;
    let picture =
        RgbImage::from_fn(width, height, |x, y| Rgb([noise(x, y) as u8, (3 * x + y) as u8, (x * y / 8) as u8]));
    let mut bytes = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality)).unwrap();
    bytes
}

/// Pictures of both kinds, with their sizes.
fn whole() -> Vec<(Vec<u8>, [usize; 2])> {
    let by_pillow = BY_PILLOW.map(|bytes| (bytes.to_vec(), [40, 27]));
    let encoded = [(96, 70, 90), (17, 9, 30), (80, 61, 50)]
        .map(|(width, height, quality)| (encoded(width, height, quality), [width as usize, height as usize]));
    by_pillow.into_iter().chain(encoded).collect()
}

/// Where the data of the first scan begin.
fn data_from(bytes: &[u8]) -> usize {
    bytes.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap() + 14
}

#[test]
fn whole_pictures_pass_with_anything_behind_them() {
    for (bytes, size) in whole() {
        assert_eq!(check(&bytes, size), Ok(()));
        assert_eq!(
            check(&bytes[..bytes.len() - 1], size).is_ok(),
            bytes[..].windows(2).all(|pair| pair != [0xff, 0xc2])
        );
        // Phones append a video, or further pictures.
        for behind in [&b"\0\0\0\x18ftypmp42"[..], &bytes, &[0xff; 9], &[0; 4096]] {
            assert_eq!(check(&[&bytes, behind].concat(), size), Ok(()));
        }
        let (data, end) = bytes.split_at(bytes.len() - 2);
        assert_eq!(check(&[data, &[0xff, 0xff], end].concat(), size), Ok(()), "fill bytes");
        assert_eq!(check(&[data, &[0; 9], end].concat(), size), Ok(()), "a few bytes that belong to nothing");
        assert!(check(&[data, &[0; 90], end].concat(), size).unwrap_err().contains("are wrong after 100%"));
    }
}

#[test]
fn a_cut_is_found_wherever_it_is() {
    for (bytes, size) in whole() {
        for length in data_from(&bytes)..bytes.len() - 3 {
            let message = check(&bytes[..length], size).expect_err(&format!("{length} of {} bytes", bytes.len()));
            assert!(message.contains("cut short"), "{message}");
            // The marker of the end, as some programs append it.
            let ended = check(&[&bytes[..length], &[0xff, 0xd9]].concat(), size);
            assert!(ended.is_err(), "{length} of {} bytes and the end", bytes.len());
        }
    }
    let (bytes, size) = whole().swap_remove(2);
    let message = check(&bytes[..bytes.len() * 3 / 10], size).unwrap_err();
    assert!(message.contains("after 1") || message.contains("after 2"), "the share of the picture: {message}");
}

#[test]
fn a_hole_is_found() {
    for (bytes, size) in whole().into_iter().filter(|(bytes, _)| bytes.len() > 3000) {
        let from = data_from(&bytes);
        let length = (bytes.len() - from) / 3;
        for start in [from + 9, from + length / 2, from + length] {
            let mut spoilt = bytes.clone();
            spoilt[start..start + length].fill(0);
            assert!(check(&spoilt, size).is_err(), "zeros from {start}");
            let lacking = [&bytes[..start], &bytes[start + length..]].concat();
            assert!(check(&lacking, size).is_err(), "nothing from {start}");
        }
    }
}

/// Damage anywhere ends in a verdict, and what is not understood is left to the decoder.
#[test]
fn nothing_panics() {
    for (bytes, size) in whole().into_iter().take(2) {
        assert_eq!(check(&bytes, [size[0] + 1, size[1]]), Ok(()), "another size");
        for at in 0..bytes.len() {
            for value in [0, 0xff, bytes[at] ^ 0x10, bytes[at].wrapping_add(1)] {
                let mut spoilt = bytes.clone();
                spoilt[at] = value;
                let _ = check(&spoilt, size);
            }
        }
    }
    for bytes in [&b""[..], b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xda", b"\xff\xd8\xff\xd9"] {
        let _ = check(bytes, [8, 8]);
    }
}
