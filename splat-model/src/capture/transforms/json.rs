//! The files as written: the value of each known field, valid or not.
//!
//! Other fields are skipped while they are read, because a tree of the whole file would take up to a hundred times its
//! size. A value of the wrong type is kept as such, so that the error can name its frame.

use std::fmt;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::LISTS;
use crate::capture::CaptureError;
use crate::capture::read::quoted;

/// The expected form of a `transform_matrix`.
pub(super) const MATRIX: &str = "3 or 4 rows of 4 finite numbers, the fourth 0 0 0 1";

/// The fields that describe a lens, of a file or of a frame.
const LENS: [&str; 16] = [
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "k4",
    "k5",
    "k6",
    "is_fisheye",
    "camera_model",
];
/// The other fields.
const OTHERS: [&str; 7] =
    ["camera_angle_x", "camera_angle_y", "frames", "ply_file_path", "file_path", "transform_matrix", "mask_path"];

/// A value. Each method gives the value as one type, or what was found instead, as messages show it.
#[derive(Debug)]
pub(super) enum Value {
    Null,
    Truth(bool),
    Number(f64),
    Text(String),
    List(Vec<Value>),
    /// The known fields of a file or a frame; nothing of other objects.
    Object(Fields),
}

/// The known fields of an object, by name.
#[derive(Debug, Default)]
pub(super) struct Fields(Vec<(&'static str, Value)>);

impl Fields {
    /// The value of a field; `null` where there is none.
    pub fn get(&self, name: &str) -> &Value {
        // The last of two equal names counts, as in other readers of JSON.
        self.0.iter().rfind(|(known, _)| *known == name).map_or(&Value::Null, |(_, value)| value)
    }
}

impl Value {
    pub fn truth(&self) -> Result<bool, String> {
        if let Self::Truth(truth) = self { Ok(*truth) } else { Err(self.shown()) }
    }

    pub fn number(&self) -> Result<f64, String> {
        if let Self::Number(number) = self { Ok(*number) } else { Err(self.shown()) }
    }

    pub fn text(&self) -> Result<&str, String> {
        if let Self::Text(text) = self { Ok(text) } else { Err(self.shown()) }
    }

    pub fn list(&self) -> Result<&[Self], String> {
        if let Self::List(list) = self { Ok(list) } else { Err(self.shown()) }
    }

    pub fn fields(&self) -> Result<&Fields, String> {
        if let Self::Object(fields) = self { Ok(fields) } else { Err(self.shown()) }
    }

    pub fn texts(&self) -> Result<Vec<&str>, String> {
        let texts = self.list()?.iter().map(|value| value.text().map_err(|found| format!("a list with {found}")));
        texts.collect()
    }

    /// Four rows; a missing last row is 0 0 0 1.
    pub fn matrix(&self) -> Result<[[f64; 4]; 4], String> {
        let mut rows = self.list()?.iter().map(Self::row).collect::<Result<Vec<_>, _>>()?;
        if rows.len() == 3 {
            rows.push([0.0, 0.0, 0.0, 1.0]);
        }
        rows.try_into().map_err(|rows: Vec<_>| format!("{} rows", rows.len()))
    }

    fn row(&self) -> Result<[f64; 4], String> {
        let numbers = self.list()?.iter().map(Self::number).collect::<Result<Vec<_>, _>>()?;
        numbers.try_into().map_err(|numbers: Vec<_>| format!("{} numbers", numbers.len()))
    }

    fn shown(&self) -> String {
        match self {
            Self::Null => "null".into(),
            Self::Truth(truth) => truth.to_string(),
            Self::Number(number) => number.to_string(),
            Self::Text(text) => quoted(text),
            Self::List(_) => "a list".into(),
            Self::Object(_) => "an object".into(),
        }
    }
}

/// Reads a file.
pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<Fields, CaptureError> {
    let mut input = serde_json::Deserializer::from_slice(bytes);
    let read = Expected::File.deserialize(&mut input).and_then(|value| input.end().map(|()| value));
    match read {
        Ok(Value::Object(fields)) => Ok(fields),
        Ok(_) => Ok(Fields::default()),
        Err(error) => {
            let (line, column) = (error.line(), error.column());
            let reason = error.to_string();
            let reason = reason.split(" at line ").next().unwrap_or_default();
            Err(CaptureError::Entry {
                file: file.to_owned(),
                place: format!("line {line}, column {column}"),
                field: "text",
                found: excerpt(bytes, line, column).into(),
                expected: format!("JSON, with numbers that are finite ({})", quoted(reason)).into(),
                fix: "Correct the file, or export it again",
            })
        }
    }
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

/// What is expected at a place. A file and its frames have to be objects; any other value is kept as it is.
#[derive(Clone, Copy)]
enum Expected {
    File,
    Frames,
    Frame,
    Anything,
}

impl<'de> DeserializeSeed<'de> for Expected {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        match self {
            Self::File | Self::Frame => deserializer.deserialize_map(self),
            Self::Frames | Self::Anything => deserializer.deserialize_any(self),
        }
    }
}

impl<'de> Visitor<'de> for Expected {
    type Value = Value;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::File => "an object with `frames`",
            Self::Frame => "a frame, which is an object",
            Self::Frames | Self::Anything => "a value",
        })
    }
    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }
    fn visit_bool<E>(self, truth: bool) -> Result<Value, E> {
        Ok(Value::Truth(truth))
    }
    fn visit_f64<E>(self, number: f64) -> Result<Value, E> {
        Ok(Value::Number(number))
    }
    fn visit_i64<E>(self, number: i64) -> Result<Value, E> {
        Ok(Value::Number(number as f64))
    }
    fn visit_u64<E>(self, number: u64) -> Result<Value, E> {
        Ok(Value::Number(number as f64))
    }
    fn visit_str<E>(self, text: &str) -> Result<Value, E> {
        Ok(Value::Text(text.to_owned()))
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let each = if let Self::Frames = self { Self::Frame } else { Self::Anything };
        let mut values = Vec::new();
        while let Some(value) = list.next_element_seed(each)? {
            values.push(value);
        }
        Ok(Value::List(values))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut fields = Fields::default();
        while let Some(name) = map.next_key::<String>()? {
            let known = LENS.iter().chain(&OTHERS).chain(&LISTS).find(|known| **known == name);
            match (self, known) {
                (Self::File, Some(&name @ "frames")) => fields.0.push((name, map.next_value_seed(Self::Frames)?)),
                (Self::File | Self::Frame, Some(&name)) => fields.0.push((name, map.next_value_seed(Self::Anything)?)),
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(Value::Object(fields))
    }
}
