//! Tests that links of the documentation lead to an existing file and heading of this repository, and that every page is in the
//! book's table of contents.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders with pages. Their subfolders have none.
const FOLDERS: [&str; 4] = [".", "docs", "benches", "train/assets/viewer"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// Returns the Markdown files of the repository, by relative path.
fn pages() -> Vec<PathBuf> {
    let mut pages = Vec::new();
    for folder in FOLDERS {
        let Ok(entries) = fs::read_dir(root().join(folder)) else { continue };
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        pages.extend(names.filter(|name| name.ends_with(".md")).map(|name| Path::new(folder).join(name)));
    }
    pages.sort();
    pages
}

/// Returns the lines of a page outside code blocks, without text between backquotes.
fn prose(page: &str) -> Vec<String> {
    let mut code = false;
    let mut lines = Vec::new();
    for line in page.lines() {
        if line.trim_start().starts_with("```") {
            code = !code;
        } else if !code {
            lines.push(line.to_owned());
        }
    }
    lines
}

/// Returns the targets of `[text](target)` in a line.
fn targets(line: &str) -> Vec<&str> {
    let outside_code: Vec<&str> = line.split('`').collect();
    let mut targets = Vec::new();
    // A link's text may be code, so the search looks for `](` rather than for the text.
    for part in outside_code.iter().step_by(2) {
        for (at, _) in part.match_indices("](") {
            let rest = &part[at + 2..];
            targets.extend(rest.find(')').map(|end| &rest[..end]));
        }
    }
    targets
}

/// Returns the anchors of a page's headings, as GitHub and mdBook generate them.
fn anchors(page: &str) -> BTreeSet<String> {
    let headings = prose(page).into_iter().filter(|line| line.starts_with('#'));
    headings
        .map(|line| {
            let text = line.trim_start_matches('#').trim().to_lowercase();
            let kept = text.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
            kept.map(|c| if c == ' ' { '-' } else { c }).collect()
        })
        .collect()
}

#[test]
fn every_link_leads_to_a_file_and_a_heading() {
    let mut broken = Vec::new();
    let mut followed = 0;
    for page in pages() {
        let text = fs::read_to_string(root().join(&page)).unwrap();
        for line in prose(&text) {
            for target in targets(&line) {
                if target.contains("://") || target.starts_with("mailto:") {
                    continue;
                }
                followed += 1;
                let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
                let path =
                    if file.is_empty() { root().join(&page) } else { root().join(&page).with_file_name("").join(file) };
                let is_there = match fs::read_to_string(&path) {
                    Ok(text) => anchor.is_empty() || anchors(&text).contains(anchor),
                    Err(_) => path.exists() && anchor.is_empty(),
                };
                if !is_there {
                    broken.push(format!("{}: {target}", page.display()));
                }
            }
        }
    }
    assert!(broken.is_empty(), "these links lead nowhere:\n{}", broken.join("\n"));
    assert!(followed > 20, "found only {followed} links: the search for links is broken");
}

#[test]
fn the_table_of_contents_has_every_page_of_the_book() {
    let summary = fs::read_to_string(root().join("docs/SUMMARY.md")).expect("the book's table of contents");
    let listed: BTreeSet<&str> = summary.lines().flat_map(targets).collect();
    let pages = pages().into_iter().filter(|page| page.starts_with("docs") && !page.ends_with("SUMMARY.md"));
    let names = pages.map(|page| page.strip_prefix("docs").unwrap().to_str().unwrap().to_owned());
    let missing: Vec<String> = names.filter(|name| !listed.contains(name.as_str())).collect();
    assert!(missing.is_empty(), "not in docs/SUMMARY.md: {missing:?}");
}
