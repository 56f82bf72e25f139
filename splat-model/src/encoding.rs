//! Text of other systems.

/// Text in UTF-8 without a byte order mark. UTF-16, as shells of Windows write it, is recognised by its mark or by the zero in its first
/// character; all other bytes stay as they are.
pub(crate) fn utf8(bytes: Vec<u8>) -> Vec<u8> {
    let unit: fn([u8; 2]) -> u16 = match bytes.as_slice() {
        [0xef, 0xbb, 0xbf, text @ ..] => return text.to_vec(),
        [0xff, 0xfe, ..] | [1..=127, 0, ..] => u16::from_le_bytes,
        [0xfe, 0xff, ..] | [0, 1..=127, ..] => u16::from_be_bytes,
        _ => return bytes,
    };
    let units = bytes.as_chunks().0.iter().map(|&pair| unit(pair));
    let text: String = char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
    text.trim_start_matches('\u{feff}').into()
}

#[cfg(test)]
mod tests;
