//! Whether a JPEG is whole: decoders fill up with grey what is missing at its end.

#[cfg(test)]
mod tests;

/// The end of the picture (ITU-T T.81, table B.1).
const END: u8 = 0xd9;

/// Whether the marker of the end is there. Segments are passed over by their lengths, because that of EXIF holds a JPEG of its own; the data
/// of a scan hold no marker but those of restarts.
pub(super) fn has_end(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(rest) = bytes.get(at..) {
        // Neither zeros after a byte of 255, nor fill bytes, nor markers that stand alone.
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 1 | 0xd0..=0xd8 | 0xff);
        let Some(found) = rest.windows(2).position(is_marker) else { return false };
        if rest[found + 1] == END {
            return true;
        }
        let Some(length) = rest[found + 2..].first_chunk() else { return false };
        at += found + 2 + usize::from(u16::from_be_bytes(*length));
    }
    false
}
