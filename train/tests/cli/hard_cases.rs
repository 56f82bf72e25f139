//! `splat hard-cases`: the table, on the CPU and for the shortest group. The whole battery is a test of the crate
//! `splat-tests`.

use std::fs;

use crate::run::{end, refuse, splat, succeed};
use crate::text;

#[test]
fn the_table_is_written_and_its_summary_printed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new");
    let only = ["--group", "colour", "--group", "cameras", "--device", "flex"];
    let said = succeed(splat(&["hard-cases", "--out"]).arg(&out).args(only)).stdout;
    assert!(said.contains("Paths: flex. Of 13 cases 13 pass, 0 are loose, 0 fail."), "{said}");
    assert!(said.contains("The GPU was skipped"), "{said}");
    let table = fs::read_to_string(out.join("hard_cases.tsv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split('\t').collect()).collect();
    let mut groups: Vec<&str> = rows.iter().map(|row| row[0]).collect();
    groups.dedup();
    assert_eq!((rows.len(), groups), (13, vec!["Cameras", "Colour"]));
    let row = rows.iter().find(|row| row[1] == "1° field of view").unwrap();
    assert_eq!((row.len(), row[3], row[8]), (12, "fx 3438 px", "yes"), "{row:?}");
    // Scores of the CPU and of the textbook, none of a GPU.
    for (cell, there) in [(4, true), (5, true), (6, false), (7, false), (9, true), (10, true)] {
        assert_eq!(row[cell].contains('('), there, "{row:?}");
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
