//! The files as written: the value of each field, valid or not.
//!
//! Values are stored while they are read, because a tree of the whole file would take up to a hundred times its
//! size. A value of the wrong type is kept as such, so that the error can name its frame.

use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::CORRECT;
use crate::capture::CaptureError;
use crate::capture::colmap::quoted;

/// The expected form of a `transform_matrix`.
pub(super) const MATRIX: &str = "3 or 4 rows of 4 finite numbers, the fourth 0 0 0 1";

/// A field's value; `null` counts as absent.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Field<T> {
    #[default]
    Absent,
    Is(T),
    /// A value of another type, as messages show it.
    Wrong(Box<str>),
}

impl<T> Field<T> {
    fn is_right(&self) -> bool {
        matches!(self, Self::Is(_))
    }
}

/// A file.
#[derive(Debug, Default)]
pub(super) struct File {
    /// The frames up to the first without a path or a matrix, which are required.
    pub frames: Field<Vec<TransformsFrame>>,
    pub lenses: LensFields,
    /// `ply_file_path`
    pub points: Field<String>,
    pub lists: super::SplitLists,
}

/// One of `frames`.
#[derive(Debug, Default)]
pub(super) struct TransformsFrame {
    /// `file_path`
    pub path: Field<String>,
    /// `transform_matrix`
    pub matrix: Field<Matrix>,
    /// `mask_path`
    pub mask: Field<String>,
    /// None if the frame has no lens fields.
    pub lens: Option<Box<LensFields>>,
}

/// Four rows; a missing last row is 0 0 0 1.
pub(super) type Matrix = [MatrixRow; 4];
type MatrixRow = [f64; 4];

/// The numbers that describe a lens.
const NUMBERS: [&str; 16] = [
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "camera_angle_x",
    "camera_angle_y",
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "k4",
    "k5",
    "k6",
];

/// The lens fields of a file or a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LensFields {
    numbers: [Field<f64>; NUMBERS.len()],
    /// `camera_model`
    pub model: Field<String>,
    /// `is_fisheye`
    pub fisheye: Field<bool>,
}

impl LensFields {
    /// One of the numbers, by its field.
    pub fn number(&self, field: &str) -> &Field<f64> {
        let slot = NUMBERS.iter().position(|&known| known == field);
        slot.map_or(&Field::Absent, |slot| &self.numbers[slot])
    }

    fn knows(field: &str) -> bool {
        NUMBERS.contains(&field) || ["camera_model", "is_fisheye"].contains(&field)
    }

    /// Stores the value of a known field.
    fn take<'de, A: MapAccess<'de>>(&mut self, field: &str, map: &mut A) -> Result<(), A::Error> {
        match NUMBERS.iter().position(|&known| known == field) {
            Some(slot) => self.numbers[slot] = map.next_value()?,
            None if field == "camera_model" => self.model = map.next_value()?,
            None => self.fisheye = map.next_value()?,
        }
        Ok(())
    }
}

/// Reads a file.
pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<File, CaptureError> {
    // Some editors begin files with a byte order mark.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    serde_json::from_slice(bytes).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        let reason = error.to_string();
        let reason = reason.split(" at line ").next().unwrap_or_default();
        CaptureError::Entry {
            file: file.to_owned(),
            place: format!("line {line}, column {column}"),
            field: "text",
            found: excerpt(bytes, line, column).into(),
            expected: format!("JSON, with numbers that are finite ({})", quoted(reason)).into(),
            fix: CORRECT,
        }
    })
}

/// The text from an error's position up to the next separator.
fn excerpt(bytes: &[u8], line: usize, column: usize) -> String {
    const MOST: usize = 24;
    let line = bytes.split(|&byte| byte == b'\n').nth(line.saturating_sub(1)).unwrap_or_default();
    let rest = &line[column.saturating_sub(1).min(line.len())..];
    let ends = |byte: u8| byte.is_ascii_whitespace() || b",]}".contains(&byte);
    // The separator itself may be the error.
    let length = 1 + rest.iter().skip(1).position(|&byte| ends(byte)).unwrap_or(rest.len());
    match &rest[..length.min(MOST).min(rest.len())] {
        [] => "the end of the line".into(),
        text => quoted(&String::from_utf8_lossy(text)),
    }
}

/// A value of a field, built from JSON.
trait JsonValue: Sized {
    fn from_number(_: f64) -> Option<Self> {
        None
    }
    fn from_text(_: &str) -> Option<Self> {
        None
    }
    fn from_truth(_: bool) -> Option<Self> {
        None
    }
    fn from_list<'de, A: SeqAccess<'de>>(list: A) -> Result<Field<Self>, A::Error> {
        drain(list)?;
        Ok(Field::Wrong("a list".into()))
    }
}

fn drain<'de, A: SeqAccess<'de>>(mut list: A) -> Result<usize, A::Error> {
    let mut count = 0;
    while list.next_element::<IgnoredAny>()?.is_some() {
        count += 1;
    }
    Ok(count)
}

impl JsonValue for f64 {
    fn from_number(number: f64) -> Option<Self> {
        Some(number)
    }
}

impl JsonValue for bool {
    fn from_truth(truth: bool) -> Option<Self> {
        Some(truth)
    }
}

impl JsonValue for String {
    fn from_text(text: &str) -> Option<Self> {
        Some(text.to_owned())
    }
}

impl JsonValue for Vec<String> {
    fn from_list<'de, A: SeqAccess<'de>>(mut list: A) -> Result<Field<Self>, A::Error> {
        let mut texts = Vec::new();
        while let Some(text) = list.next_element::<Field<String>>()? {
            match text {
                Field::Is(text) => texts.push(text),
                Field::Absent => return drain(list).map(|_| Field::Wrong("a list with null".into())),
                Field::Wrong(found) => {
                    return drain(list).map(|_| Field::Wrong(format!("a list with {found}").into()));
                }
            }
        }
        Ok(Field::Is(texts))
    }
}

impl JsonValue for MatrixRow {
    fn from_list<'de, A: SeqAccess<'de>>(list: A) -> Result<Field<Self>, A::Error> {
        fixed(list, "numbers", 4, [0.0; 4])
    }
}

impl JsonValue for Matrix {
    fn from_list<'de, A: SeqAccess<'de>>(list: A) -> Result<Field<Self>, A::Error> {
        fixed(list, "rows", 3, [[0.0; 4], [0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, 1.0]])
    }
}

/// Reads a list of `least` to `N` values over those of `values`.
fn fixed<'de, T: JsonValue, A: SeqAccess<'de>, const N: usize>(
    mut list: A,
    what: &str,
    least: usize,
    mut values: [T; N],
) -> Result<Field<[T; N]>, A::Error>
where
    [T; N]: JsonValue,
{
    let (mut count, mut wrong) = (0, None);
    while let Some(value) = list.next_element::<Field<T>>()? {
        match (value, values.get_mut(count)) {
            (Field::Is(value), Some(slot)) => *slot = value,
            (Field::Is(_), None) => {}
            (Field::Absent, _) => wrong = wrong.or(Some("null".into())),
            (Field::Wrong(found), _) => wrong = wrong.or(Some(found)),
        }
        count += 1;
    }
    Ok(match wrong {
        Some(found) => Field::Wrong(found),
        None if count < least || count > N => Field::Wrong(format!("{count} {what}").into()),
        None => Field::Is(values),
    })
}

impl JsonValue for Vec<TransformsFrame> {
    fn from_list<'de, A: SeqAccess<'de>>(mut list: A) -> Result<Field<Self>, A::Error> {
        let mut frames = Vec::new();
        while let Some(frame) = list.next_element::<TransformsFrame>()? {
            let right = frame.path.is_right() && frame.matrix.is_right();
            frames.push(frame);
            if !right {
                drain(list)?;
                break;
            }
        }
        Ok(Field::Is(frames))
    }
}

impl<'de, T: JsonValue> Deserialize<'de> for Field<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(OfValue(PhantomData))
    }
}

struct OfValue<T>(PhantomData<T>);

/// The value, or what was found instead.
fn field<T>(value: Option<T>, found: impl fmt::Display) -> Field<T> {
    value.map_or_else(|| Field::Wrong(found.to_string().into()), Field::Is)
}

impl<'de, T: JsonValue> Visitor<'de> for OfValue<T> {
    type Value = Field<T>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a value")
    }
    fn visit_unit<E>(self) -> Result<Field<T>, E> {
        Ok(Field::Absent)
    }
    fn visit_bool<E>(self, truth: bool) -> Result<Field<T>, E> {
        Ok(field(T::from_truth(truth), truth))
    }
    fn visit_f64<E>(self, number: f64) -> Result<Field<T>, E> {
        Ok(field(T::from_number(number), number))
    }
    fn visit_i64<E>(self, number: i64) -> Result<Field<T>, E> {
        Ok(field(T::from_number(number as f64), number))
    }
    fn visit_u64<E>(self, number: u64) -> Result<Field<T>, E> {
        Ok(field(T::from_number(number as f64), number))
    }
    fn visit_str<E>(self, text: &str) -> Result<Field<T>, E> {
        Ok(field(T::from_text(text), quoted(text)))
    }
    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Field<T>, A::Error> {
        T::from_list(list)
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Field<T>, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Field::Wrong("an object".into()))
    }
}

/// An object whose fields are taken one by one.
trait JsonObject: Default {
    const WHAT: &str;
    /// Stores the value of any field.
    fn take<'de, A: MapAccess<'de>>(&mut self, field: &str, map: &mut A) -> Result<(), A::Error>;
}

impl JsonObject for File {
    const WHAT: &str = "an object with `frames`";

    fn take<'de, A: MapAccess<'de>>(&mut self, field: &str, map: &mut A) -> Result<(), A::Error> {
        match field {
            "frames" => self.frames = map.next_value()?,
            "ply_file_path" => self.points = map.next_value()?,
            _ if LensFields::knows(field) => self.lenses.take(field, map)?,
            _ => match super::LISTS.iter().position(|&known| known == field) {
                Some(list) => self.lists[list] = map.next_value()?,
                None => drop(map.next_value::<IgnoredAny>()?),
            },
        }
        Ok(())
    }
}

impl JsonObject for TransformsFrame {
    const WHAT: &str = "a frame, which is an object";

    fn take<'de, A: MapAccess<'de>>(&mut self, field: &str, map: &mut A) -> Result<(), A::Error> {
        match field {
            "file_path" => self.path = map.next_value()?,
            "transform_matrix" => self.matrix = map.next_value()?,
            "mask_path" => self.mask = map.next_value()?,
            _ if LensFields::knows(field) => self.lens.get_or_insert_default().take(field, map)?,
            _ => drop(map.next_value::<IgnoredAny>()?),
        }
        Ok(())
    }
}

struct OfObject<T>(PhantomData<T>);

impl<'de, T: JsonObject> Visitor<'de> for OfObject<T> {
    type Value = T;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(T::WHAT)
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<T, A::Error> {
        let mut object = T::default();
        while let Some(field) = map.next_key::<String>()? {
            object.take(&field, &mut map)?;
        }
        Ok(object)
    }
}

impl<'de> Deserialize<'de> for File {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(OfObject(PhantomData))
    }
}

impl<'de> Deserialize<'de> for TransformsFrame {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(OfObject(PhantomData))
    }
}
