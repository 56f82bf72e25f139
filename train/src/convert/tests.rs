use super::*;

#[test]
fn numbers_are_short() {
    let cases = [
        (0.0, "0"),
        (0.00012, "1.2e-4"),
        (0.001, "0.0010"),
        (0.0371, "0.037"),
        (3.16, "3.2"),
        (42.4, "42"),
        (12345.0, "1.2e4"),
    ];
    for (value, text) in cases {
        assert_eq!(short(value), text);
    }
}
