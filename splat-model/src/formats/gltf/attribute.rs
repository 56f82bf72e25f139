//! The numbers of an attribute.

use std::collections::BTreeMap;

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

/// Reads an attribute of `N` components for `count` Gaussians.
///
/// # Errors
/// If it is missing, of another shape, or outside of its buffer.
pub fn read<const N: usize>(
    document: &Document,
    buffers: &BTreeMap<usize, Vec<u8>>,
    primitive: &Primitive,
    name: &str,
    count: usize,
) -> Result<Vec<[f32; N]>, String> {
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
    let end = view.byte_offset.saturating_add(view.byte_length);
    let inside = buffer.get(view.byte_offset..end).and_then(|view| view.get(accessor.byte_offset..));
    // The last element may end before its stride does.
    let needed = count.saturating_sub(1).saturating_mul(stride).saturating_add(element);
    let inside = inside.filter(|inside| stride >= element && (count == 0 || needed <= inside.len()));
    let inside = inside.ok_or_else(|| {
        format!(
            "`{name}`: {count} elements of {element} bytes, {stride} bytes apart from byte {} of a view of {} bytes from byte {}, are \
             not all within the {} bytes of buffer {}",
            accessor.byte_offset,
            view.byte_length,
            view.byte_offset,
            buffer.len(),
            view.buffer
        )
    })?;
    let value = |bytes: &[u8]| match kind.number(bytes) {
        // The least integer stands for −1, as the one above it does.
        (number, largest) if accessor.normalized => (number / largest).max(-1.0),
        (number, _) => number,
    };
    let of = |i: usize| {
        let element = &inside[stride * i..];
        std::array::from_fn(|component| value(&element[kind.bytes() * component..]))
    };
    Ok((0..count).map(of).collect())
}
