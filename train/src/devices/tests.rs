use super::*;

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
