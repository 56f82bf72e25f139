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
