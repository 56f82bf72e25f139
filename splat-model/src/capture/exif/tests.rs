use std::fs::File;
use std::io::{BufWriter, Cursor};

use exif::experimental::Writer;
use exif::{Field, Rational};
use image::codecs::jpeg::JpegEncoder;
use image::{ImageEncoder, RgbImage};

use super::*;

fn field(tag: Tag, value: Value) -> Field {
    Field { tag, ifd_num: In::PRIMARY, value }
}

fn ascii(text: &str) -> Value {
    Value::Ascii(vec![text.as_bytes().to_vec()])
}

fn rationals(parts: &[f64]) -> Value {
    let part = |&part: &f64| Rational { num: (part * 1000.0).round() as u32, denom: 1000 };
    Value::Rational(parts.iter().map(part).collect())
}

fn raw(fields: &[Field]) -> Vec<u8> {
    let (mut writer, mut bytes) = (Writer::new(), Cursor::new(Vec::new()));
    fields.iter().for_each(|field| writer.push_field(field));
    writer.write(&mut bytes, false).unwrap();
    bytes.into_inner()
}

/// Writes a JPEG with these fields.
pub(crate) fn write_jpeg(file: &Path, picture: &RgbImage, fields: &[Field]) {
    let mut encoder = JpegEncoder::new_with_quality(BufWriter::new(File::create(file).unwrap()), 95);
    encoder.set_exif_metadata(raw(fields)).unwrap();
    encoder.write_image(picture, picture.width(), picture.height(), image::ExtendedColorType::Rgb8).unwrap();
}

/// The field of a rotation that turns the stored picture clockwise for showing.
pub(crate) fn turned() -> Field {
    field(Tag::Orientation, Value::Short(vec![6]))
}

pub(crate) fn place(latitude: [f64; 3], south: bool, longitude: [f64; 3], west: bool) -> Vec<Field> {
    vec![
        field(Tag::GPSLatitude, rationals(&latitude)),
        field(Tag::GPSLatitudeRef, ascii(if south { "S" } else { "N" })),
        field(Tag::GPSLongitude, rationals(&longitude)),
        field(Tag::GPSLongitudeRef, ascii(if west { "W" } else { "E" })),
    ]
}

#[test]
fn a_photograph_says_what_took_it_and_where() {
    let mut fields = place([33.0, 51.0, 25.2], true, [151.0, 12.0, 54.0], false);
    fields.extend([
        field(Tag::Make, ascii("Acme ")),
        field(Tag::Model, ascii("Phone 3")),
        field(Tag::FocalLength, rationals(&[4.25])),
        field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![26])),
        field(Tag::GPSAltitude, rationals(&[12.5])),
        field(Tag::GPSAltitudeRef, Value::Byte(vec![1])),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.jpg");
    write_jpeg(&file, &RgbImage::new(40, 30), &fields);
    let found = Exif::read(&file).unwrap();
    assert_eq!(found.camera.as_deref(), Some("Acme Phone 3"));
    assert_eq!((found.focal_mm, found.focal_35mm), (Some(4.25), Some(26.0)));
    let gps = found.gps.unwrap();
    assert!((gps.latitude_deg + 33.857).abs() < 1e-9 && (gps.longitude_deg - 151.215).abs() < 1e-9, "{gps:?}");
    assert_eq!(gps.altitude_m, Some(-12.5));
    // A square of film's diagonal has that diagonal in px as its focal length at 43.27 mm.
    let focal_px = found.focal_px([3000, 4000]).unwrap();
    assert!((focal_px - 26.0 / 43.2666 * 5000.0).abs() < 0.01, "{focal_px}");
}

#[test]
fn what_makes_no_sense_is_left_out() {
    let cases = [
        place([0.0; 3], false, [0.0; 3], false),
        place([91.0, 0.0, 0.0], false, [10.0, 0.0, 0.0], true),
        vec![field(Tag::GPSLatitude, rationals(&[1.0, 2.0]))],
        vec![field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))],
        vec![field(Tag::FocalLength, Value::Rational(vec![Rational { num: 1, denom: 0 }]))],
        vec![field(Tag::Make, ascii("  "))],
    ];
    for fields in cases {
        assert_eq!(Exif::parse(raw(&fields)), Exif::default(), "{fields:?}");
    }
}

#[test]
fn damage_is_no_error() {
    let good = raw(&place([1.0, 2.0, 3.0], false, [4.0, 5.0, 6.0], true));
    assert!(Exif::parse(good.clone()).gps.is_some());
    for length in 0..good.len() {
        Exif::parse(good[..length].to_vec());
    }
    for at in 0..good.len() {
        let mut broken = good.clone();
        broken[at] ^= 0xff;
        Exif::parse(broken);
    }
}
