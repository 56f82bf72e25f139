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
mod tests {
    use super::*;

    #[test]
    fn every_encoding_becomes_utf_8_without_a_mark() {
        let text = "# é\r\n𝄞 1";
        let units: Vec<u16> = text.encode_utf16().collect();
        let little: Vec<u8> = units.iter().flat_map(|unit| unit.to_le_bytes()).collect();
        let big: Vec<u8> = units.iter().flat_map(|unit| unit.to_be_bytes()).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [b"\xff\xfe", &little[..]].concat(),
            [b"\xfe\xff", &big[..]].concat(),
            little,
            big,
        ] {
            assert_eq!(String::from_utf8(utf8(bytes)).unwrap(), text);
        }
        for bytes in [&b""[..], b"\0", b"\xff", b"\0\0", b"a\xff\xff"] {
            assert_eq!(utf8(bytes.to_vec()), bytes);
        }
        // A lone surrogate, and a byte too many.
        assert_eq!(utf8(b"\xff\xfe\0\xd8a\0b".to_vec()), "\u{fffd}a".as_bytes());
    }
}
