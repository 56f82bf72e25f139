use burn::tensor::Device;
use splat_op::RenderOptions;

use super::super::reference::tests::{rows, shots};
use super::*;

#[test]
fn more_bits_and_degrees_are_closer_to_the_scene() {
    let (rows, folder) = (rows(200), tempfile::tempdir().unwrap());
    let bench = Bench::new(&rows, shots(), [0.0; 3], RenderOptions::standard(), &Device::flex()).unwrap();
    let file = folder.path().join("trial");
    let stored = measure(&bench, &rows, &file, |_| Ok((20.0, 0.5))).unwrap();
    let of = |name: &str, sh_degree: usize| {
        let found = stored.iter().find(|scene| scene.name == name && scene.sh_degree == sh_degree);
        found.unwrap_or_else(|| panic!("no {name} of degree {sh_degree}"))
    };
    assert!(of("PLY", 1).is_exact());
    let [least, six, eight] = ["SPZ", "SPZ, 6 bits", "SPZ, 8 bits"].map(|name| of(name, 1).error_db);
    assert!(least + 1.0 < six && six < eight && eight < 80.0, "{least}, {six}, {eight}");
    assert!(of("SPZ", 0).error_db + 3.0 < least, "no harmonics: {}", of("SPZ", 0).error_db);
    assert!(of("SPZ", 0).bytes_each < of("PLY", 1).bytes_each / 3.0);
    let text = section(&stored);
    assert!(text.contains("| **PLY** | 1 |") && text.contains(" | – | 20.00 | 0.5000 |"), "{text}");
    assert_eq!(chart(&stored, String::new()).dots.len(), stored.len() - 1);
}
