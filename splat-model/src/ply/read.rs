//! Reading of files in any encoding, with properties in any order and of any type.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    DefaultElement, ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyDef,
    PropertyType, ScalarType,
};

use super::VERTEX;
use crate::FileError;

/// Maximum length of a header, bytes. Degree 4 with every property takes 3 KB.
const MAX_HEADER_BYTES: u64 = 1 << 20;

fn header_error(path: &Path, detail: &str) -> FileError {
    FileError::new(path, format!("broken PLY header: {detail}; export it again"))
}

/// The values of a row, in the order of the header. An f64 holds every number of the format exactly.
struct RowValues(Vec<f64>);

impl PropertyAccess for RowValues {
    fn new() -> Self {
        // Room for a Gaussian of degree 3.
        Self(Vec::with_capacity(64))
    }

    fn set_property(&mut self, _: &str, property: Property) -> PropertyAccessResult {
        self.0.push(match property {
            Property::Char(value) => value.into(),
            Property::UChar(value) => value.into(),
            Property::Short(value) => value.into(),
            Property::UShort(value) => value.into(),
            Property::Int(value) => value.into(),
            Property::UInt(value) => value.into(),
            Property::Float(value) => value.into(),
            Property::Double(value) => value,
            _ => return PropertyAccessResult::UnsupportedType,
        });
        PropertyAccessResult::Set
    }
}

/// The row of an element that is skipped.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

/// A file whose header has been read.
pub(crate) struct PlyReader<'a> {
    pub(super) path: &'a Path,
    reader: BufReader<File>,
    /// Number of bytes after the header.
    payload_bytes: u64,
}

impl<'a> PlyReader<'a> {
    /// Opens a file and reads its header.
    pub fn open(path: &'a Path) -> Result<(Self, Header), FileError> {
        let file = File::open(path).map_err(FileError::io(path, "open the scene (is the path right?)"))?;
        let file_bytes = file.metadata().map_err(FileError::io(path, "read the size of the file"))?.len();
        let mut input = Self { path, reader: BufReader::with_capacity(1 << 20, file), payload_bytes: 0 };
        let text = input.header_text()?;
        input.payload_bytes = file_bytes.saturating_sub(text.len() as u64);
        let header = parse_header(path, &text)?;
        Ok((input, header))
    }

    /// Skips the elements before the vertices. Refuses a header that claims more rows than the file can hold, before it reserves memory.
    pub fn begin(&mut self, header: &Header) -> Result<(), FileError> {
        self.check_size(header, VERTEX)?;
        for element in header.elements.values().take_while(|element| element.name != VERTEX) {
            self.skip(element, header)?;
        }
        Ok(())
    }

    /// Refuses a header whose rows, up to the rows of the element `last`, do not fit into the file, before memory is reserved for them.
    pub fn check_size(&self, header: &Header, last: &str) -> Result<(), FileError> {
        let mut needed = 0_u64;
        for element in header.elements.values() {
            let row_bytes = least_row_bytes(element, header.encoding);
            needed = needed.saturating_add(row_bytes.saturating_mul(element.count as u64));
            // The last line of an ASCII file may lack a line break.
            let slack = u64::from(header.encoding == Encoding::Ascii);
            if needed > self.payload_bytes.saturating_add(slack) {
                let detail = format!(
                    "the header claims {} rows of `{}`, at least {needed} bytes of data, but {} bytes follow the header; \
                     the file is truncated or its header wrong: copy or export it again",
                    element.count,
                    brief(&element.name),
                    self.payload_bytes
                );
                return Err(FileError::new(self.path, detail));
            }
            if element.name == last {
                break;
            }
        }
        Ok(())
    }

    /// Reads the bytes up to and including the line `end_header`.
    fn header_text(&mut self) -> Result<Vec<u8>, FileError> {
        let mut text = Vec::new();
        let mut limited = self.reader.by_ref().take(MAX_HEADER_BYTES);
        loop {
            let start = text.len();
            // The first line is `ply`. A file of another kind is not searched for its first line break.
            let limit = if start == 0 { 16 } else { MAX_HEADER_BYTES };
            limited
                .by_ref()
                .take(limit)
                .read_until(b'\n', &mut text)
                .map_err(FileError::io(self.path, "read the header"))?;
            let line = text[start..].trim_ascii();
            if start == 0 && line != b"ply" {
                let found = String::from_utf8_lossy(line).escape_debug().to_string();
                let detail =
                    format!("not a PLY file: it begins with `{found}`, expected a line `ply`; pass a .ply file");
                return Err(FileError::new(self.path, detail));
            }
            if line == b"end_header" {
                return Ok(text);
            }
            if text.len() == start || text.last() != Some(&b'\n') {
                return Err(header_error(self.path, &format!("no line `end_header` within {} bytes", text.len())));
            }
        }
    }

    /// Skips an element.
    pub fn skip(&mut self, element: &ElementDef, header: &Header) -> Result<(), FileError> {
        // In binary, such rows take no space, and a header may claim 2⁶⁴ of them.
        if element.properties.is_empty() && header.encoding != Encoding::Ascii {
            return Ok(());
        }
        let mut reader = Reader::new(&mut self.reader);
        let skipped = Parser::<Skipped>::new().read_payload_for_element(&mut reader, element, header);
        // The parser counts rows as lines, from 1.
        let row = reader.line().saturating_sub(1);
        skipped.map(drop).map_err(|error| self.row_error(element, row, &error))
    }

    /// Reads all rows of an element without lists, and passes the number of each row and its values of `properties` to `take`.
    pub fn each_row(
        &mut self,
        element: &ElementDef,
        encoding: Encoding,
        properties: &[impl AsRef<str>],
        mut take: impl FnMut(usize, &[f64]) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        let parser = Parser::<RowValues>::new();
        let columns: Vec<usize> =
            properties.iter().filter_map(|name| element.properties.get_index_of(name.as_ref())).collect();
        let mut bytes = vec![0; usize::try_from(least_row_bytes(element, Encoding::BinaryLittleEndian)).unwrap_or(0)];
        let mut line = String::new();
        let mut values = vec![0.0; columns.len()];
        let of_floats = |property: &PropertyDef| matches!(property.data_type, PropertyType::Scalar(ScalarType::Float));
        // The usual layout, without the parser.
        let plain = encoding == Encoding::BinaryLittleEndian && element.properties.values().all(of_floats);
        for i in 0..element.count {
            if plain {
                self.fill(&mut bytes).map_err(|error| self.row_error(element, i, &error))?;
                let floats = bytes.as_chunks::<4>().0;
                let of = |column: usize| f64::from(f32::from_le_bytes(floats[column]));
                values.iter_mut().zip(&columns).for_each(|(value, &column)| *value = of(column));
                take(i, &values)?;
                continue;
            }
            let row = match encoding {
                Encoding::Ascii => self.ascii_row(&parser, element, &mut line),
                Encoding::BinaryBigEndian => {
                    self.fill(&mut bytes).and_then(|()| parser.read_big_endian_element(&mut &bytes[..], element))
                }
                Encoding::BinaryLittleEndian => {
                    self.fill(&mut bytes).and_then(|()| parser.read_little_endian_element(&mut &bytes[..], element))
                }
            };
            let RowValues(row) = row.map_err(|error| self.row_error(element, i, &error))?;
            values.iter_mut().zip(&columns).for_each(|(value, &column)| *value = row[column]);
            take(i, &values)?;
        }
        Ok(())
    }

    fn fill(&mut self, row: &mut [u8]) -> Result<(), ParseError> {
        Ok(self.reader.read_exact(row)?)
    }

    fn ascii_row(
        &mut self,
        parser: &Parser<RowValues>,
        element: &ElementDef,
        line: &mut String,
    ) -> Result<RowValues, ParseError> {
        line.clear();
        if self.reader.read_line(line)? == 0 {
            return Err(io::Error::from(ErrorKind::UnexpectedEof).into());
        }
        // The parser would accept surplus numbers.
        let (found, expected) = (line.split_ascii_whitespace().count(), element.properties.len());
        if found != expected {
            let detail = format!("the line holds {found} values, expected {expected}");
            return Err(io::Error::new(ErrorKind::InvalidData, detail).into());
        }
        // The parser knows neither infinities nor NaN, which other programs write.
        let read = line.contains(['n', 'N']).then(|| non_finite_row(line, element)).flatten();
        read.map_or_else(|| parser.read_ascii_element(line, element), Ok)
    }

    fn row_error(&self, element: &ElementDef, row: usize, error: &ParseError) -> FileError {
        let name = brief(&element.name);
        match error.kind() {
            ErrorKind::UnexpectedEof => {
                let count = element.count;
                let end = format!("the file ends in row {row} of `{name}`, expected {count} rows");
                FileError::new(self.path, format!("{end}; it is truncated: copy or export it again"))
            }
            ErrorKind::InvalidInput | ErrorKind::InvalidData => {
                value_error(self.path, &name, row, &brief(&error.to_string()))
            }
            kind => FileError::io(self.path, "read the rows")(io::Error::new(kind, error.to_string())),
        }
    }
}

/// The values of a line with infinities or NaN, each a number of its property's type.
fn non_finite_row(line: &str, element: &ElementDef) -> Option<RowValues> {
    let value = |(word, property): (&str, &PropertyDef)| match property.data_type {
        PropertyType::Scalar(ScalarType::Float | ScalarType::Double) => word.parse().ok(),
        _ => word.parse::<i64>().ok().map(|whole| whole as f64),
    };
    line.split_ascii_whitespace().zip(element.properties.values()).map(value).collect::<Option<_>>().map(RowValues)
}

/// The error for a row with a value that it cannot have.
pub(super) fn value_error(path: &Path, element: &str, row: usize, detail: &str) -> FileError {
    FileError::new(path, format!("row {row} of `{element}`: {detail}; correct that row or export the scene again"))
}

/// Shortens a message of the parser to one line without control characters, because the parser quotes whole lines, whatever they hold.
pub(crate) fn brief(message: &str) -> String {
    const MAX_CHARS: usize = 240;
    let words: Vec<&str> = message.split_whitespace().collect();
    let mut text: String = words.join(" ").chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if let Some((cut, _)) = text.char_indices().nth(MAX_CHARS) {
        text.truncate(cut);
        text.push('…');
    }
    text
}

fn parse_header(path: &Path, text: &[u8]) -> Result<Header, FileError> {
    // Comments may be in any encoding, and everything else is ascii.
    let text = String::from_utf8_lossy(text);
    let wrong = |message: &str| {
        let says = message.split("Error: ParseError").next().unwrap_or(message);
        let forms = "lines `format`, `element`, `property`, `comment` and `obj_info` in the form of the format";
        format!("{}, expected {forms}", brief(says))
    };
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut Reader::new(text.as_bytes()))
        .map_err(|error| header_error(path, &wrong(&error.to_string())))?;
    // The parser keeps the last of two equal names, so every row would be misread.
    let declared = |keyword: &str| text.lines().filter(|line| line.split_whitespace().next() == Some(keyword)).count();
    let properties = header.elements.values().map(|element| element.properties.len()).sum::<usize>();
    if declared("element") != header.elements.len() || declared("property") != properties {
        let detail = "two elements or two properties of an element have the same name, expected each once";
        return Err(header_error(path, detail));
    }
    Ok(header)
}

pub(crate) fn vertex<'a>(path: &Path, header: &'a Header) -> Result<&'a ElementDef, FileError> {
    header.elements.get(VERTEX).ok_or_else(|| {
        let found = quoted(header.elements.keys());
        FileError::new(path, format!("no element `vertex`, found {found}; export a scene as a Gaussian splatting PLY"))
    })
}

/// The first few names, for an error message.
fn quoted<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    match names.len() {
        0 => "none".into(),
        1..=16 => brief(&names.join(" ")),
        count => format!("{} and {} more", brief(&names[..16].join(" ")), count - 16),
    }
}

/// Refuses lists, and vertices that lack one of these properties.
pub(crate) fn require(path: &Path, vertex: &ElementDef, properties: &[&str]) -> Result<(), FileError> {
    if let Some(list) = vertex.properties.values().find(|p| matches!(p.data_type, PropertyType::List(..))) {
        let detail = format!(
            "property `{}` of `vertex` is a list, expected one number per row; remove it or export it as scalars",
            brief(&list.name)
        );
        return Err(FileError::new(path, detail));
    }
    match properties.iter().find(|&&name| !vertex.properties.contains_key(name)) {
        Some(property) => Err(missing_property(path, property, vertex.properties.keys())),
        None => Ok(()),
    }
}

pub(super) fn missing_property<'a>(path: &Path, property: &str, found: impl Iterator<Item = &'a String>) -> FileError {
    let detail = format!(
        "element `vertex` has no property `{property}`, found {}; export a scene in the original 3D Gaussian splatting \
         layout, and points with `x`, `y` and `z`",
        quoted(found)
    );
    FileError::new(path, detail)
}

/// Minimum size of a row, bytes.
fn least_row_bytes(element: &ElementDef, encoding: Encoding) -> u64 {
    if encoding == Encoding::Ascii {
        // A digit and a separator per property; a row without any is an empty line.
        return (2 * element.properties.len() as u64).max(1);
    }
    let size = |scalar: &ScalarType| match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let least = |property: &PropertyType| match property {
        PropertyType::Scalar(scalar) => size(scalar),
        // An empty list takes only the bytes of its length.
        PropertyType::List(length, _) => size(length),
    };
    element.properties.values().map(|property| least(&property.data_type)).sum()
}
