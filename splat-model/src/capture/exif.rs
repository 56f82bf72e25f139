//! EXIF of photographs: what a camera wrote down about itself.
//!
//! Tags: Exif 2.3 (CIPA DC-008-2012), sections 4.6.4 (`Make`, `Model`), 4.6.5 (`FocalLength`, `FocalLengthIn35mmFilm`)
//! and 4.6.6 (GPS). EXIF's orientation turns no picture: COLMAP and [`image::load`](super::image::load) both use pixels as they are stored, so
//! that photographs that a camera took upright and sideways share its lens.

use std::path::Path;

use exif::{In, Reader, Tag, Value};
use image::ImageDecoder;

use super::Result;
use super::image::header;

/// Diagonal of a frame of 35 mm film, 36 mm × 24 mm, to which `FocalLengthIn35mmFilm` refers.
const FILM_DIAGONAL_MM: f64 = 43.266_615;

/// The facts that reconstruction uses. A tag that is missing or makes no sense is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exif {
    /// Maker and model of the camera.
    pub camera: Option<String>,
    /// Focal length of the lens, mm. It says which photographs have the same zoom, but not how wide they are.
    pub focal_mm: Option<f64>,
    /// Focal length of the lens that shows as much on 35 mm film, mm.
    pub focal_35mm: Option<f64>,
    /// Where the photograph was taken.
    pub gps: Option<Gps>,
}

/// A position on WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gps {
    /// Degrees north.
    pub latitude_deg: f64,
    /// Degrees east.
    pub longitude_deg: f64,
    /// Metres above the sea, or above the ellipsoid: cameras differ.
    pub altitude_m: Option<f64>,
}

impl Exif {
    /// Reads the EXIF of a JPEG or PNG picture. Without EXIF, or with damaged EXIF, all is `None`.
    ///
    /// # Errors
    /// A [`CaptureError`](crate::capture::CaptureError) if the file cannot be opened or is not a picture.
    pub fn read(file: &Path) -> Result<Self> {
        let raw = header(file)?.exif_metadata().ok().flatten();
        Ok(raw.map(Self::parse).unwrap_or_default())
    }

    /// Parses the TIFF structure that holds the tags.
    fn parse(raw: Vec<u8>) -> Self {
        let mut reader = Reader::new();
        reader.continue_on_error(true);
        let fields = reader.read_raw(raw).or_else(|error| error.distill_partial_result(|_| ()));
        fields.map(|fields| Self::of(&fields)).unwrap_or_default()
    }

    fn of(fields: &exif::Exif) -> Self {
        let value = |tag| fields.get_field(tag, In::PRIMARY).map(|field| &field.value);
        let positive = |tag| value(tag).and_then(number).filter(|mm| (0.1..1e5).contains(mm));
        let camera: Vec<String> = [Tag::Make, Tag::Model].into_iter().filter_map(|tag| text(value(tag)?)).collect();
        Self {
            camera: (!camera.is_empty()).then(|| camera.join(" ")),
            focal_mm: positive(Tag::FocalLength),
            focal_35mm: positive(Tag::FocalLengthIn35mmFilm),
            gps: Gps::of(value),
        }
    }

    /// The focal length in pixels of a picture of this size, px. `FocalLengthIn35mmFilm` compares diagonals.
    pub fn focal_px(&self, [width, height]: [usize; 2]) -> Option<f64> {
        Some(self.focal_35mm? / FILM_DIAGONAL_MM * (width as f64).hypot(height as f64))
    }
}

impl Gps {
    fn of<'a>(value: impl Fn(Tag) -> Option<&'a Value>) -> Option<Self> {
        let angle = |tag, reference, negative: &str, most: f64| {
            let parts: Vec<f64> = numbers(value(tag)?);
            let &[degrees, minutes, seconds] = parts.as_slice() else { return None };
            let angle = degrees + minutes / 60.0 + seconds / 3600.0;
            let sign = if value(reference).and_then(text).as_deref() == Some(negative) { -1.0 } else { 1.0 };
            (0.0..=most).contains(&angle).then_some(sign * angle)
        };
        let below_sea = value(Tag::GPSAltitudeRef).and_then(|value| value.get_uint(0)) == Some(1);
        let altitude_m = value(Tag::GPSAltitude).and_then(number).filter(|metres| metres.abs() < 1e5);
        let gps = Self {
            latitude_deg: angle(Tag::GPSLatitude, Tag::GPSLatitudeRef, "S", 90.0)?,
            longitude_deg: angle(Tag::GPSLongitude, Tag::GPSLongitudeRef, "W", 180.0)?,
            altitude_m: altitude_m.map(|metres| if below_sea { -metres } else { metres }),
        };
        // Cameras without a fix write zeros.
        (gps.latitude_deg != 0.0 || gps.longitude_deg != 0.0).then_some(gps)
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Rational(parts) => parts.iter().map(exif::Rational::to_f64).collect(),
        other => (0..).map_while(|i| other.get_uint(i)).map(f64::from).collect(),
    }
}

fn number(value: &Value) -> Option<f64> {
    numbers(value).first().copied().filter(|number| number.is_finite())
}

fn text(value: &Value) -> Option<String> {
    let Value::Ascii(lines) = value else { return None };
    let text =
        String::from_utf8_lossy(lines.first()?).trim_matches(|c: char| c.is_whitespace() || c == '\0').to_owned();
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
pub(crate) mod tests;
