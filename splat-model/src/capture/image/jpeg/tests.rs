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

/// Pictures of both kinds.
fn whole() -> Vec<Vec<u8>> {
    let encoded =
        [(96, 70, 90), (17, 9, 30), (80, 61, 50)].map(|(width, height, quality)| encoded(width, height, quality));
    BY_PILLOW.map(|bytes| bytes.to_vec()).into_iter().chain(encoded).collect()
}

#[test]
fn whole_pictures_pass_with_anything_behind_them() {
    for bytes in whole() {
        assert!(has_end(&bytes));
        // Phones append a video, or further pictures.
        for behind in [&b"\0\0\0\x18ftypmp42"[..], &bytes, &[0xff; 9], &[0; 4096]] {
            assert!(has_end(&[&bytes, behind].concat()));
        }
        let (data, end) = bytes.split_at(bytes.len() - 2);
        assert!(has_end(&[data, &[0xff, 0xff], end].concat()), "fill bytes");
        assert!(has_end(&[data, &[0; 9], end].concat()), "a few bytes that belong to nothing");
    }
}

#[test]
fn a_cut_is_found_wherever_it_is() {
    for bytes in whole() {
        for length in 0..bytes.len() {
            assert!(!has_end(&bytes[..length]), "{length} of {} bytes", bytes.len());
        }
    }
}

/// EXIF holds a small picture, whose end is not that of the photograph.
#[test]
fn a_picture_in_a_segment_ends_nothing() {
    let small = encoded(17, 9, 30);
    let length = (small.len() as u16 + 2).to_be_bytes();
    let exif = [&[0xff, 0xe1], &length[..], &small].concat();
    for bytes in whole() {
        let with_small = [&bytes[..2], &exif, &bytes[2..]].concat();
        assert!(has_end(&with_small));
        assert!(!has_end(&with_small[..with_small.len() - 2]));
    }
}

#[test]
fn damage_ends_in_a_verdict() {
    for bytes in whole().into_iter().take(2) {
        for at in 0..bytes.len() {
            for value in [0, 0xff, bytes[at] ^ 0x10, bytes[at].wrapping_add(1)] {
                let mut spoilt = bytes.clone();
                spoilt[at] = value;
                let _ = has_end(&spoilt);
            }
        }
    }
    for bytes in [&b""[..], b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xda", b"\xff\xd8\xff\xda\xff\xff"] {
        assert!(!has_end(bytes));
    }
    assert!(has_end(b"\xff\xd8\xff\xd9"));
}
