//! The kernels in the source of the crate `splat-op`.

use std::collections::BTreeSet;
use std::path::Path;
use std::{env, fs, io};

/// The source of `splat-op` from the folder of this package.
const SOURCE: &str = "../../splat-op/src";

/// Returns the names of all kernels' functions, except those in files of tests.
pub fn kernels() -> io::Result<BTreeSet<String>> {
    let mut found = BTreeSet::new();
    // Cargo's variable at run time: a build of another clone would name that clone.
    let package = env::var("CARGO_MANIFEST_DIR").unwrap_or_else(|_| env!("CARGO_MANIFEST_DIR").to_owned());
    visit(&Path::new(&package).join(SOURCE), &mut found)?;
    Ok(found)
}

fn visit(folder: &Path, found: &mut BTreeSet<String>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            visit(&path, found)?;
        } else if path.to_str().is_some_and(|name| name.ends_with(".rs") && !name.ends_with("tests.rs")) {
            found.extend(kernels_of(&fs::read_to_string(path)?).map(str::to_owned));
        }
    }
    Ok(())
}

fn kernels_of(text: &str) -> impl Iterator<Item = &str> {
    text.split("#[cube(launch").skip(1).filter_map(|kernel| {
        let function = kernel.split_once("fn ")?.1;
        function.split(|c: char| !c.is_alphanumeric() && c != '_').next()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_are_found_by_their_attribute() -> io::Result<()> {
        let text = "#[cube(launch_unchecked)]\npub fn a_kernel<F: Float>(x: F) {}\n#[cube]\nfn b() {}\n";
        assert_eq!(kernels_of(text).collect::<Vec<_>>(), ["a_kernel"]);
        let all = kernels()?;
        assert!(all.len() > 20 && !all.contains("threes_kernel"), "{all:?}");
        Ok(())
    }
}
