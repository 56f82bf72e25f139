//! Reading, without trusting a header before the bytes it claims have been read.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::ops::RangeInclusive;
use std::path::Path;

use flate2::bufread::GzDecoder;
use ruzstd::decoding::StreamingDecoder;
use splat_op::sh::SH_DEGREE_MAX;

use super::pack::{Layout, SECTIONS, unpack};
use super::{ANTIALIASED, GZIP, HEADER, MAGIC};
use crate::FileError;
use crate::formats::{Format, SceneFile};
use crate::ply::TrainedAs;

/// Maximum number of bytes that one byte of a file can expand to: the limit of deflate (zlib's documentation), and more than
/// any scene needs with zstd.
const EXPANSION_MAX: u64 = 1_032;

/// Maximum number of fractional bits, which fit into 32 bits.
const FRACTION_MAX: u32 = 30;

/// Maximum number of bytes read after the sections, to verify gzip's checksum at the end; extensions are short.
const EXTENSIONS_MAX: u64 = 1 << 24;

/// Window size that any zstd file may use, bytes (RFC 8878).
const WINDOW: u64 = 8 << 20;

/// Whether a file with these first bytes may be an SPZ file.
pub fn is_spz(first: &[u8]) -> bool {
    first.starts_with(&GZIP) || first.starts_with(&MAGIC)
}

/// Reads a file that [`is_spz`] accepts.
pub fn read(path: &Path) -> Result<SceneFile, FileError> {
    let file = File::open(path).map_err(FileError::io(path, "open the scene (is the path right?)"))?;
    let bytes = file.metadata().map_err(FileError::io(path, "read the size of the file"))?.len();
    let mut file = BufReader::with_capacity(1 << 20, file);
    let is_gzip = file.fill_buf().map_err(FileError::io(path, "read the scene"))?.starts_with(&GZIP);
    let of = Of { path, bytes };
    let (layout, flags, sections) = if is_gzip { of.gzip(file)? } else { of.zstd(file)? };
    let rows = unpack(&layout, sections.each_ref().map(Vec::as_slice));
    let trained = TrainedAs { antialias: flags & ANTIALIASED != 0, ..TrainedAs::default() };
    Ok(SceneFile { rows, trained, ..SceneFile::default() })
}

/// The layout, flags and sections of a file.
type SpzSections = (Layout, u8, [Vec<u8>; SECTIONS]);

#[derive(Clone, Copy)]
struct Of<'a> {
    path: &'a Path,
    bytes: u64,
}

impl Of<'_> {
    fn broken(&self, detail: impl Into<String>) -> FileError {
        FileError::broken(self.path, Format::Spz, detail)
    }

    /// Reads exactly `bytes` bytes; `name` describes them in messages. Memory grows only with bytes that exist.
    fn exactly(&self, source: &mut impl Read, name: &str, bytes: usize) -> Result<Vec<u8>, FileError> {
        let mut found = Vec::new();
        let read = source.take(bytes as u64).read_to_end(&mut found);
        read.map_err(|error| self.broken(format!("{name}: {error}")))?;
        match found.len() == bytes {
            true => Ok(found),
            false => Err(self.broken(format!("{name}: {} bytes, expected {bytes}; it is truncated", found.len()))),
        }
    }

    /// Versions 1 to 3.
    fn gzip(&self, file: BufReader<File>) -> Result<SpzSections, FileError> {
        let mut stream = GzDecoder::new(file);
        let header = self.exactly(&mut stream, "header", 16)?;
        let (layout, flags) = self.layout(&header, 1..=3)?;
        let mut sections = <[Vec<u8>; SECTIONS]>::default();
        for ((section, each), name) in sections.iter_mut().zip(layout.bytes()).zip(NAMES) {
            *section = self.exactly(&mut stream, name, each * layout.count)?;
        }
        // The checksum is verified at the end of the stream.
        io::copy(&mut stream.take(EXTENSIONS_MAX), &mut io::sink())
            .map_err(|error| self.broken(format!("after the last section: {error}")))?;
        Ok((layout, flags, sections))
    }

    /// Version 4.
    fn zstd(&self, mut file: BufReader<File>) -> Result<SpzSections, FileError> {
        let header = self.exactly(&mut file, "header", HEADER)?;
        let (layout, flags) = self.layout(&header, 4..=4)?;
        let sizes = layout.bytes().map(|each| each * layout.count);
        // Empty sections have no stream.
        let wanted: Vec<usize> = (0..SECTIONS).filter(|&section| sizes[section] > 0).collect();
        let (streams, table) = (usize::from(header[15]), number(&header[16..20]));
        let mut at = table + 16 * streams as u64;
        if streams != wanted.len() || table < HEADER as u64 || at > self.bytes {
            return Err(self.broken(format!(
                "a table of {streams} streams at byte {table}, expected {} within the {} bytes of the file and after its first {HEADER}",
                wanted.len(),
                self.bytes
            )));
        }
        self.seek(&mut file, table)?;
        let entries = self.exactly(&mut file, "table of streams", 16 * streams)?;
        let mut sections = <[Vec<u8>; SECTIONS]>::default();
        for (entry, section) in entries.as_chunks::<16>().0.iter().zip(wanted) {
            let [packed, plain] = [&entry[..8], &entry[8..]].map(number);
            let (name, bytes) = (NAMES[section], sizes[section]);
            let end = at.saturating_add(packed);
            if plain != bytes as u64 || end > self.bytes {
                return Err(self.broken(format!(
                    "{name} of {plain} bytes until byte {end}, expected {bytes} for {} Gaussians, within the {} of the file",
                    layout.count, self.bytes
                )));
            }
            self.seek(&mut file, at)?;
            let window = plain.max(WINDOW);
            let stream = StreamingDecoder::new_with_max_window_size((&mut file).take(packed), window);
            let mut stream = stream.map_err(|error| self.broken(format!("{name}: {error}")))?;
            sections[section] = self.exactly(&mut stream, name, bytes)?;
            at = end;
        }
        Ok((layout, flags, sections))
    }

    fn seek(&self, file: &mut BufReader<File>, to: u64) -> Result<(), FileError> {
        file.seek(SeekFrom::Start(to)).map_err(FileError::io(self.path, "read the scene")).map(drop)
    }

    /// Parses the 16 bytes that all versions begin with. Returns the layout and the flags. Refuses more Gaussians than the file can hold.
    fn layout(&self, header: &[u8], versions: RangeInclusive<u32>) -> Result<(Layout, u8), FileError> {
        if header[..4] != MAGIC {
            let found = header[..4].escape_ascii();
            return Err(self.broken(format!("its contents begin with `{found}`, expected `NGSP`")));
        }
        let (version, count) = (number(&header[4..8]) as u32, number(&header[8..12]) as usize);
        let (sh_degree, fraction) = (usize::from(header[12]), u32::from(header[13]));
        if !versions.contains(&version) {
            let (first, last) = versions.into_inner();
            let which = if first == last { String::new() } else { format!("{first} to ") };
            return Err(
                self.broken(format!("version {version}, expected {which}{last} in a file that begins like this one"))
            );
        }
        if sh_degree > SH_DEGREE_MAX {
            return Err(self.broken(format!("harmonics of degree {sh_degree}, expected 0 to {SH_DEGREE_MAX}")));
        }
        if fraction > FRACTION_MAX {
            return Err(self.broken(format!("fractions of {fraction} bits, expected 0 to {FRACTION_MAX}")));
        }
        let layout = Layout { version, count, sh_degree, fraction };
        let needed = layout.bytes().iter().map(|each| *each as u64 * count as u64).sum::<u64>();
        if needed > EXPANSION_MAX.saturating_mul(self.bytes) {
            return Err(self.broken(format!(
                "the header claims {count} Gaussians, {needed} bytes, more than a file of {} bytes can hold",
                self.bytes
            )));
        }
        Ok((layout, header[14]))
    }
}

const NAMES: [&str; SECTIONS] = ["positions", "opacities", "colours", "scales", "rotations", "harmonics"];

/// Parses a little-endian number.
fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
}
