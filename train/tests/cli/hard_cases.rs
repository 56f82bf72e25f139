//! `splat hard-cases`: the table, on the CPU and for the shortest group. The whole battery is a test of the crate
//! `splat-tests`.

use std::fs;

use crate::run::{end, refuse, splat, succeed};
use crate::text;

#[test]
fn the_table_is_printed_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new");
    let only = ["--group", "colour", "--group", "cameras", "--device", "flex"];
    let ended = succeed(splat(&["hard-cases", "--out"]).arg(&out).args(only));
    let table = fs::read_to_string(out.join("HARD_CASES.md")).unwrap();
    assert_eq!(ended.stdout, format!("{table}\n"));
    assert!(table.contains("Paths: flex. Of 10 cases 10 pass, 0 are loose, 0 fail."), "{table}");
    assert!(table.contains("The GPU was skipped"), "{table}");
    let titles: Vec<&str> = table.lines().filter(|line| line.starts_with("## ")).collect();
    assert_eq!(titles, ["## Cameras", "## Colour"]);
    let row = table.lines().find(|line| line.starts_with("| 1° field of view |")).unwrap();
    let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
    assert_eq!((cells.len(), cells[2], cells[7]), (10, "fx 3438 px", "yes"), "{row}");
    // Scores of the CPU and of the textbook, none of a GPU.
    for (cell, there) in [(3, true), (4, true), (5, false), (6, false), (8, true), (9, true)] {
        assert_eq!(cells[cell].contains('('), there, "{row}");
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}

#[test]
fn what_is_not_there_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let unknown = end(splat(&["hard-cases", "--group", "nonsense", "--out"]).arg(folder.path()));
    assert_eq!(unknown.code, Some(2));
    assert!(unknown.stderr.contains("needles"), "{}", unknown.stderr);
    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    refuse(splat(&["hard-cases", "--device", "flex", "--out"]).arg(&file), &[text(&file), "--out"]);
}
