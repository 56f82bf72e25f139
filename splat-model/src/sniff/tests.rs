use super::*;

#[test]
fn files_are_named_for_what_they_are() {
    let of = |first: &[u8]| FileKind::of_bytes(first).map(|kind| kind.what);
    for (first, what) in [
        (&b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"[..], "a HEIC (HEIF) picture"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "a HEIC (HEIF) picture"),
        (b"\0\0\0\x1cftypavif\0\0\0\0avifmif1miaf", "an AVIF picture"),
        (b"\0\0\0\x18ftypcrx \0\0\0\x01crx isom", "the raw file of a camera"),
        (b"II*\0\x08\0\0\0\x0b\0", "a TIFF picture or the raw file of a camera"),
        (b"BM\x36\0\0\0", "a BMP picture"),
        (b"PK\x03\x04\x14\0\0\0", "a ZIP archive"),
        (b"\x1f\x8b\x08\0", "a GZ archive"),
        (b"ply\nformat ascii", "a PLY file, a scene or points"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"),
        (b" {\"frames\": []}", "a JSON file without frames that have poses"),
        (b"# Camera list\n1 PINHOLE", "a text file"),
        (b"", "an empty file"),
    ] {
        assert_eq!(of(first).as_deref(), Some(what), "{first:?}");
    }
    assert_eq!(of(&[3; 64]), None);
    let class = |first: &[u8]| FileKind::of_bytes(first).map(|kind| kind.class);
    for (first, expected) in [
        (&b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom"[..], FileClass::Video),
        (b"\0\0\0\x14ftypqt  \0\0\0\0qt  ", FileClass::Video),
        (b"\xff\xd8\xff\xe0", FileClass::Picture),
        (b"BM\x36\0\0\0", FileClass::Other),
        (b"NGSP\x04\0\0\0", FileClass::Scene),
        (b"a,b,c", FileClass::Text),
    ] {
        assert_eq!(class(first), Some(expected), "{first:?}");
    }
}

#[test]
fn scenes_of_other_programs_are_known_by_their_names() {
    for name in ["a.splat", "b/C.KSPLAT"] {
        let kind = FileKind::of_scene(Path::new(name)).unwrap();
        assert!(kind.remedy.contains("splat-transform") && kind.remedy.contains("SuperSplat"), "{kind:?}");
    }
    assert_eq!(FileKind::of_scene(Path::new("a.ply")), None);
}
