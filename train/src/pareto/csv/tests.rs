use super::*;

#[test]
fn commas_and_quotes_are_quoted() {
    assert_eq!(quoted("a b"), "a b");
    assert_eq!(quoted("a, b"), "\"a, b\"");
    assert_eq!(quoted("a \"b\""), "\"a \"\"b\"\"\"");
}
