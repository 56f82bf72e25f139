use super::*;

#[test]
fn sizes_are_rounded_down() {
    let cases = [
        (0, "0 B"),
        (1023, "1023 B"),
        (128 << 20, "128 MiB"),
        ((1 << 31) - 1, "1.9 GiB"),
        ((1 << 31) - 4, "1.9 GiB"),
        (1 << 31, "2 GiB"),
        (u64::MAX, "16777215.9 TiB"),
    ];
    for (count, expected) in cases {
        assert_eq!(bytes(count), expected);
    }
}

#[test]
fn columns_are_aligned() {
    let row = |name: &str, adapter: &str| {
        let mut row: TableRow = Default::default();
        (row[0], row[1], row[5]) = (name.into(), adapter.into(), "no".into());
        row
    };
    let lines = table(&[row("flex", "é"), row("a long name", "")]);
    assert_eq!(lines.len(), 3);
    let start = lines[0].find("f32 atomics").expect("the last column");
    assert!(lines[0].starts_with("--device     adapter  kind"), "{}", lines[0]);
    for line in &lines[1..] {
        assert_eq!(line.chars().skip(start).collect::<String>(), "no", "{line}");
    }
}
