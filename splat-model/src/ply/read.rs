//! Reading of files in any encoding, with properties in any order and of any type.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{ElementDef, Encoding, Header, PropertyAccess, PropertyType, ScalarType};

use super::row::{PlyRow, REQUIRED, Skipped, degree_of_rest};
use super::{ORIGIN_COMMENT, PlyError, VERTEX};
use crate::gaussians::GaussianRows;

/// Maximum length of a header, bytes. Degree 4 with every property takes 3 KB.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Reads a scene, and the origin that its positions are relative to (zero if the file names none).
///
/// Values of other numeric types are converted to the nearest f32; whether they are finite is not checked.
///
/// # Errors
///
/// A [`PlyError`] for every file that is not a complete scene in the layout of [this module](super). Memory is bounded
/// by a small multiple of the file's true size, whatever its header claims.
pub fn read(path: &Path) -> Result<(GaussianRows, DVec3), PlyError> {
    let (input, header) = PlyReader::open(path)?;
    read_from(input, &header)
}

/// Reads a scene and its origin from a file whose header has been read.
pub(crate) fn read_from(mut input: PlyReader, header: &Header) -> Result<(GaussianRows, DVec3), PlyError> {
    let path = input.path;
    let origin = origin(path, header)?;
    let vertex = vertex(path, header)?;
    let degree = check_properties(path, vertex)?;
    input.begin(header)?;
    let mut rows = empty_rows(vertex.count, degree);
    input.each_row(vertex, header.encoding, |_, row: PlyRow| {
        row.push_to(&mut rows);
        Ok(())
    })?;
    Ok((rows, origin))
}

pub(crate) fn io_error(path: &Path, action: &'static str, source: io::Error) -> PlyError {
    PlyError::Io { path: path.to_path_buf(), action, source }
}

/// A file whose header has been read.
pub(crate) struct PlyReader<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    /// Number of bytes after the header.
    payload_bytes: u64,
}

impl<'a> PlyReader<'a> {
    /// Opens a file and reads its header.
    pub fn open(path: &'a Path) -> Result<(Self, Header), PlyError> {
        let file = File::open(path).map_err(|source| io_error(path, "open the scene (is the path right?)", source))?;
        let file_bytes = file.metadata().map_err(|source| io_error(path, "read the size of the file", source))?.len();
        let mut input = Self { path, reader: BufReader::with_capacity(1 << 20, file), payload_bytes: 0 };
        let text = input.header_text()?;
        input.payload_bytes = file_bytes.saturating_sub(text.len() as u64);
        let header = parse_header(path, &text)?;
        Ok((input, header))
    }

    /// Skips the elements before the vertices. Refuses a header that claims more rows than the file can hold, before memory is
    /// reserved for them.
    pub fn begin(&mut self, header: &Header) -> Result<(), PlyError> {
        self.check_size(header, VERTEX)?;
        for element in header.elements.values().take_while(|element| element.name != VERTEX) {
            self.skip(element, header)?;
        }
        Ok(())
    }

    /// Refuses a header whose rows, up to the rows of the element `last`, do not fit into the file, before memory is reserved
    /// for them.
    pub fn check_size(&self, header: &Header, last: &str) -> Result<(), PlyError> {
        let mut needed = 0_u64;
        for element in header.elements.values() {
            let row_bytes = least_row_bytes(element, header.encoding);
            needed = needed.saturating_add(row_bytes.saturating_mul(element.count as u64));
            // The last line of an ASCII file may lack a line break.
            let slack = u64::from(header.encoding == Encoding::Ascii);
            if needed > self.payload_bytes.saturating_add(slack) {
                return Err(PlyError::TooManyRows {
                    path: self.path.to_path_buf(),
                    element: brief(&element.name),
                    rows: element.count,
                    needed,
                    found: self.payload_bytes,
                });
            }
            if element.name == last {
                break;
            }
        }
        Ok(())
    }

    /// Reads the bytes up to and including the line `end_header`.
    fn header_text(&mut self) -> Result<Vec<u8>, PlyError> {
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
                .map_err(|source| io_error(self.path, "read the header", source))?;
            let line = text[start..].trim_ascii();
            if start == 0 && line != b"ply" {
                let found = String::from_utf8_lossy(line).escape_debug().to_string();
                return Err(PlyError::NotPly { path: self.path.to_path_buf(), found });
            }
            if line == b"end_header" {
                return Ok(text);
            }
            if text.len() == start || text.last() != Some(&b'\n') {
                let detail = format!("no line `end_header` within {} bytes", text.len());
                return Err(PlyError::Header { path: self.path.to_path_buf(), detail });
            }
        }
    }

    /// Skips an element.
    pub fn skip(&mut self, element: &ElementDef, header: &Header) -> Result<(), PlyError> {
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

    /// Reads the rows of an element without lists, and passes each to `take` with its number, from 0.
    pub fn each_row<R: PropertyAccess>(
        &mut self,
        vertex: &ElementDef,
        encoding: Encoding,
        mut take: impl FnMut(usize, R) -> Result<(), PlyError>,
    ) -> Result<(), PlyError> {
        let parser = Parser::<R>::new();
        let mut bytes = vec![0; usize::try_from(least_row_bytes(vertex, Encoding::BinaryLittleEndian)).unwrap_or(0)];
        let mut line = String::new();
        for i in 0..vertex.count {
            let row = match encoding {
                Encoding::Ascii => self.ascii_row(&parser, vertex, &mut line),
                Encoding::BinaryBigEndian => {
                    self.fill(&mut bytes).and_then(|()| parser.read_big_endian_element(&mut &bytes[..], vertex))
                }
                Encoding::BinaryLittleEndian => {
                    self.fill(&mut bytes).and_then(|()| parser.read_little_endian_element(&mut &bytes[..], vertex))
                }
            };
            take(i, row.map_err(|error| self.row_error(vertex, i, &error))?)?;
        }
        Ok(())
    }

    fn fill(&mut self, row: &mut [u8]) -> Result<(), ParseError> {
        Ok(self.reader.read_exact(row)?)
    }

    fn ascii_row<R: PropertyAccess>(
        &mut self,
        parser: &Parser<R>,
        vertex: &ElementDef,
        line: &mut String,
    ) -> Result<R, ParseError> {
        line.clear();
        if self.reader.read_line(line)? == 0 {
            return Err(io::Error::from(ErrorKind::UnexpectedEof).into());
        }
        // The parser would accept surplus numbers.
        let (found, expected) = (line.split_ascii_whitespace().count(), vertex.properties.len());
        if found != expected {
            let detail = format!("the line holds {found} values, expected {expected}");
            return Err(io::Error::new(ErrorKind::InvalidData, detail).into());
        }
        parser.read_ascii_element(line, vertex)
    }

    fn row_error(&self, element: &ElementDef, row: usize, error: &ParseError) -> PlyError {
        let (path, name) = (self.path.to_path_buf(), brief(&element.name));
        match error.kind() {
            ErrorKind::UnexpectedEof => PlyError::Truncated { path, element: name, row, rows: element.count },
            ErrorKind::InvalidInput | ErrorKind::InvalidData => {
                PlyError::Row { path, element: name, row, detail: brief(&error.to_string()) }
            }
            kind => io_error(self.path, "read the rows", io::Error::new(kind, error.to_string())),
        }
    }
}

/// Shortens a message of the parser to one line without control characters, because the parser quotes whole lines, whatever
/// they hold.
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

/// The parser's message about a header, without the parser's state.
fn header_detail(message: &str) -> String {
    let says = message.split("Error: ParseError").next().unwrap_or(message);
    format!(
        "{}, expected lines `format`, `element`, `property`, `comment` and `obj_info` in the form of the format",
        brief(says)
    )
}

fn parse_header(path: &Path, text: &[u8]) -> Result<Header, PlyError> {
    let broken = |detail: String| PlyError::Header { path: path.to_path_buf(), detail };
    // Comments may be in any encoding, and everything else is ascii.
    let text = String::from_utf8_lossy(text);
    let header = Parser::<PlyRow>::new()
        .read_header(&mut Reader::new(text.as_bytes()))
        .map_err(|error| broken(header_detail(&error.to_string())))?;
    // The parser keeps the last of two equal names, so every row would be misread.
    let declared = |keyword: &str| text.lines().filter(|line| line.split_whitespace().next() == Some(keyword)).count();
    let properties = header.elements.values().map(|element| element.properties.len()).sum::<usize>();
    if declared("element") != header.elements.len() || declared("property") != properties {
        return Err(broken(
            "two elements or two properties of an element have the same name, expected each once".into(),
        ));
    }
    Ok(header)
}

pub(crate) fn origin(path: &Path, header: &Header) -> Result<DVec3, PlyError> {
    let Some(text) = header.comments.iter().find_map(|comment| comment.trim().strip_prefix(ORIGIN_COMMENT)) else {
        return Ok(DVec3::ZERO);
    };
    let numbers: Option<Vec<f64>> =
        text.split_whitespace().map(|word| word.parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err(PlyError::Origin { path: path.to_path_buf(), found: brief(text) }),
    }
}

pub(crate) fn vertex<'a>(path: &Path, header: &'a Header) -> Result<&'a ElementDef, PlyError> {
    header
        .elements
        .get(VERTEX)
        .ok_or_else(|| PlyError::MissingVertex { path: path.to_path_buf(), found: quoted(header.elements.keys()) })
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
pub(crate) fn require(path: &Path, vertex: &ElementDef, properties: &[&str]) -> Result<(), PlyError> {
    let path_buf = || path.to_path_buf();
    if let Some(list) = vertex.properties.values().find(|p| matches!(p.data_type, PropertyType::List(..))) {
        return Err(PlyError::ListProperty { path: path_buf(), property: brief(&list.name) });
    }
    match properties.iter().find(|&&name| !vertex.properties.contains_key(name)) {
        Some(&property) => {
            let found = quoted(vertex.properties.keys());
            Err(PlyError::MissingProperty { path: path_buf(), property: property.into(), found })
        }
        None => Ok(()),
    }
}

/// Checks that the properties describe a Gaussian, and returns the degree of its spherical harmonics.
fn check_properties(path: &Path, vertex: &ElementDef) -> Result<usize, PlyError> {
    let path_buf = || path.to_path_buf();
    require(path, vertex, &REQUIRED)?;
    let rest = vertex.properties.keys().filter(|name| name.starts_with("f_rest_")).count();
    let numbered = (0..rest).map(|i| format!("f_rest_{i}"));
    let degree = degree_of_rest(rest).ok_or_else(|| PlyError::RestCount { path: path_buf(), found: rest })?;
    match numbered.into_iter().find(|name| !vertex.properties.contains_key(name)) {
        Some(property) => {
            let found = quoted(vertex.properties.keys().filter(|name| name.starts_with("f_rest_")));
            Err(PlyError::MissingProperty { path: path_buf(), property, found })
        }
        None => Ok(degree),
    }
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

/// An empty scene with room for `count` rows, which the file was checked to hold.
fn empty_rows(count: usize, sh_degree: usize) -> GaussianRows {
    GaussianRows {
        means: Vec::with_capacity(count),
        rotations: Vec::with_capacity(count),
        log_scales: Vec::with_capacity(count),
        logit_opacities: Vec::with_capacity(count),
        sh_dc: Vec::with_capacity(count),
        sh_rest: Vec::with_capacity(3 * super::row::rest_per_channel(sh_degree) * count),
        sh_degree,
    }
}
