use super::*;

#[test]
fn a_size_at_the_limit_fits_and_one_above_names_all() {
    let need = Need::floats("sh", [1024, 16, 16], "use fewer");
    assert_eq!(need.bytes, 1 << 20);
    need.check(1 << 20).expect("as large as the limit");
    let error = need.check((1 << 20) - 1).expect_err("one byte too large");
    assert!(matches!(error, SplatError::TooLarge { what: "sh", .. }), "{error}");
    let message = error.to_string();
    for part in ["`sh`", "1048576 bytes", "1048575 bytes", "use fewer"] {
        assert!(message.contains(part), "`{part}` is missing: {message}");
    }
}

#[test]
fn a_size_beyond_all_numbers_is_too_large() {
    let need = Need::floats("planes", [usize::MAX, usize::MAX], "a smaller picture");
    assert!(need.check(u64::MAX - 1).is_err());
}
