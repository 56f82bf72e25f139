use super::*;

#[test]
fn the_high_water_mark_is_read() {
    assert_eq!(peak_of("VmPeak:\t  9 kB\nVmHWM:\t  157286 kB\nVmRSS:\t 5 kB\n"), Some(153.6));
    assert_eq!(peak_of("VmHWM:\t many kB\n"), None);
    assert_eq!(peak_of(""), None);
}

#[test]
fn files_that_are_not_ours_name_no_views() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("metrics.json");
    assert!(views_of(&path).is_empty());
    for text in ["", "[1]", r#"{"test": null}"#, r#"{"test": {"views": [{"name": 3}, 4]}}"#] {
        std::fs::write(&path, text).unwrap();
        assert!(views_of(&path).is_empty(), "{text}");
    }
    std::fs::write(&path, r#"{"test": {"views": [{"name": "a.jpg"}]}}"#).unwrap();
    assert_eq!(views_of(&path), ["a.jpg"]);
}
