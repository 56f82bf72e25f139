use super::*;

#[test]
fn a_file_is_read_to_its_length_and_no_further() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("numbers.json");
    std::fs::write(&path, "[1, 2]").unwrap();
    let file = |largest| read::<Vec<u32>, _>(&path, largest, |what| what);
    assert_eq!(file(6).unwrap(), [1, 2]);
    assert!(file(5).unwrap_err().contains("more than 5 bytes"));
    let text = |path: &Path| read::<String, _>(path, 6, |what| what).unwrap_err();
    assert!(text(&path).contains("invalid type"));
    assert!(text(&folder.path().join("none")).contains("os error"));
}
