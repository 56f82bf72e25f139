//! Splits inputs into fields. A broken input is split as far as possible, and its parts always add up to the input.

/// Splits text into words, blanks and line ends.
pub fn text(input: &[u8]) -> Vec<Vec<u8>> {
    let class = |byte: &u8| match byte {
        b'\n' | b'\r' => 0,
        byte if byte.is_ascii_whitespace() => 1,
        b'"' | b',' | b':' | b'[' | b']' | b'{' | b'}' => 2,
        _ => 3,
    };
    // Punctuation and line ends are fields of their own.
    input.chunk_by(|a, b| class(a) == class(b) && matches!(class(a), 1 | 3)).map(<[u8]>::to_vec).collect()
}

/// Splits the header of a PLY file as text, and its rows as numbers of four bytes or as text.
pub fn ply(input: &[u8]) -> Vec<Vec<u8>> {
    const END: &[u8] = b"end_header\n";
    let header = input.windows(END.len()).position(|window| window == END).map_or(input.len(), |at| at + END.len());
    let (header, rows) = input.split_at(header);
    let mut fields = text(header);
    match header.windows(5).any(|window| window == b"ascii") {
        true => fields.extend(text(rows)),
        false => fields.extend(rows.chunks(4).map(<[u8]>::to_vec)),
    }
    fields
}

/// File of a COLMAP model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelFile {
    Cameras,
    Images,
    Points,
}

/// Splits a file of a binary COLMAP model by the entries of the format's documentation.
pub fn colmap(part: ModelFile, input: &[u8]) -> Vec<Vec<u8>> {
    let mut rest = input;
    let mut fields = Vec::new();
    let mut take = |bytes: usize| {
        let (field, left) = rest.split_at(bytes.min(rest.len()));
        rest = left;
        if !field.is_empty() {
            fields.push(field.to_vec());
        }
        (rest.is_empty(), field)
    };
    let number = |field: &[u8]| field.iter().rev().fold(0_u64, |sum, byte| (sum << 8) | u64::from(*byte));
    take(8);
    loop {
        let ended = match part {
            ModelFile::Cameras => {
                take(4);
                let parameters = match number(take(4).1) {
                    0 | 14 => 3,
                    3 | 7 | 9 => 5,
                    4 | 5 => 8,
                    6 | 10 => 12,
                    _ => 4,
                };
                (0..2 + parameters).map(|_| take(8).0).last()
            }
            ModelFile::Images => {
                take(4);
                (0..7).for_each(|_| _ = take(8));
                take(4);
                // The bytes of a name, up to its end.
                while !matches!(take(1), (true, _) | (_, [0])) {}
                let keypoints = number(take(8).1);
                (0..3 * keypoints.min(8)).map(|_| take(8).0).last().or(Some(false))
            }
            ModelFile::Points => {
                (0..4).for_each(|_| _ = take(8));
                (0..3).for_each(|_| _ = take(1));
                take(8);
                let track = number(take(8).1);
                (0..2 * track.min(8)).map(|_| take(4).0).last().or(Some(false))
            }
        };
        if ended == Some(true) || take(0).0 {
            return fields;
        }
    }
}

#[test]
fn fields_add_up_to_the_input() {
    let ascii = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1.5 2\n";
    assert!(ply(ascii).contains(&b"1.5".to_vec()) && ply(ascii).contains(&b"vertex".to_vec()));
    let json = br#"{"a": [1, 2.5], "b": "c d"}"#;
    for input in [&ascii[..], json, b"", b"\n\n", &[0xff; 100]] {
        assert_eq!(text(input).concat(), input);
        assert_eq!(ply(input).concat(), input);
        for part in [ModelFile::Cameras, ModelFile::Images, ModelFile::Points] {
            assert_eq!(colmap(part, input).concat(), input, "{part:?}");
        }
    }
}
