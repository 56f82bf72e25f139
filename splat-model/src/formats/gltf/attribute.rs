//! The numbers of an attribute.

use std::io;
use std::ops::Range;

use super::buffers::Buffers;
use super::document::{Document, Primitive};
use crate::ply::brief;

/// A component's type: its code in the format and its size. All are read for every attribute; a normalised integer stands for a fraction of its
/// largest value.
#[derive(Clone, Copy)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Kind {
    fn of(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// The number in some bytes, and the largest of its type.
    fn number(self, b: &[u8]) -> (f32, f32) {
        match self {
            Self::I8 => (f32::from(b[0] as i8), 127.0),
            Self::U8 => (f32::from(b[0]), 255.0),
            Self::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32_767.0),
            Self::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65_535.0),
            Self::F32 => (f32::from_le_bytes([b[0], b[1], b[2], b[3]]), 1.0),
        }
    }
}

/// Number of Gaussians of a primitive.
pub fn count(document: &Document, primitive: &Primitive) -> Result<usize, String> {
    let index = primitive.attributes.get(super::POSITION).ok_or("a primitive without `POSITION`")?;
    let accessor = document.accessors.get(*index).ok_or_else(|| format!("no accessor {index} for `POSITION`"))?;
    Ok(accessor.count)
}

/// The numbers of an attribute of `N` components for each Gaussian: where they are, within their buffer.
pub struct Attribute<const N: usize> {
    buffer: usize,
    first: usize,
    stride: usize,
    kind: Kind,
    normalized: bool,
}

impl<const N: usize> Attribute<N> {
    /// Finds an attribute of `count` Gaussians.
    ///
    /// # Errors
    /// If it is missing, of another shape, or outside of its buffer.
    pub fn find(
        document: &Document,
        buffers: &Buffers,
        primitive: &Primitive,
        name: &str,
        count: usize,
    ) -> Result<Self, String> {
        let shape = if N == 1 { "SCALAR".to_owned() } else { format!("VEC{N}") };
        let index = *primitive.attributes.get(name).ok_or_else(|| format!("a primitive without `{name}`"))?;
        let accessor = document.accessors.get(index).ok_or_else(|| format!("no accessor {index} for `{name}`"))?;
        if accessor.shape != shape || accessor.count != count {
            return Err(format!(
                "`{name}` has {} elements `{}`, expected {count} elements `{shape}`",
                accessor.count,
                brief(&accessor.shape)
            ));
        }
        let kind = Kind::of(accessor.component_type).ok_or_else(|| {
            let code = accessor.component_type;
            format!(
                "`{name}` has components of type {code}, expected 5126 (float), or 5120 to 5123 (integers of 8 and 16 bits)"
            )
        })?;
        let view = accessor.buffer_view.filter(|_| accessor.sparse.is_none());
        let view = view.ok_or_else(|| format!("`{name}` is sparse or has no `bufferView`, expected plain values"))?;
        let view = document.buffer_views.get(view).ok_or_else(|| format!("`{name}` is in no buffer view {view}"))?;
        let buffer = buffers.get(&view.buffer).ok_or_else(|| format!("`{name}` is in no buffer {}", view.buffer))?;
        let element = N * kind.bytes();
        let stride = view.byte_stride.unwrap_or(element);
        let (first, end) =
            (view.byte_offset.saturating_add(accessor.byte_offset), view.byte_offset.saturating_add(view.byte_length));
        // The last element may end before its stride does.
        let needed = count.saturating_sub(1).saturating_mul(stride).saturating_add(element);
        let fits = end <= buffer.len() && first <= end && (count == 0 || needed <= end - first);
        if stride < element || !fits {
            return Err(format!(
                "`{name}`: {count} elements of {element} bytes, {stride} bytes apart from byte {} of a view of {} bytes from byte {}, are \
                 not all within the {} bytes of buffer {}",
                accessor.byte_offset,
                view.byte_length,
                view.byte_offset,
                buffer.len(),
                view.buffer
            ));
        }
        Ok(Self { buffer: view.buffer, first, stride, kind, normalized: accessor.normalized })
    }

    /// Reads the numbers of some Gaussians.
    ///
    /// # Errors
    /// If the file cannot be read.
    ///
    /// # Panics
    /// If there are not so many Gaussians, or the buffers are others.
    pub fn read(&self, buffers: &Buffers, which: Range<usize>) -> io::Result<Vec<[f32; N]>> {
        if which.is_empty() {
            return Ok(Vec::new());
        }
        let last = self.first + self.stride * (which.end - 1);
        let bytes = buffers[&self.buffer].part(self.first + self.stride * which.start..last + N * self.kind.bytes())?;
        let value = |bytes: &[u8]| match self.kind.number(bytes) {
            // The least integer stands for −1, as the one above it does.
            (number, largest) if self.normalized => (number / largest).max(-1.0),
            (number, _) => number,
        };
        let of = |element: &[u8]| std::array::from_fn(|i| value(&element[self.kind.bytes() * i..]));
        Ok(bytes.chunks(self.stride).map(of).collect())
    }
}
