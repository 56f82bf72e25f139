use std::fs;

use super::super::testing::assert_says;
use super::*;

#[test]
fn a_scale_is_kept_beside_the_capture() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(Scale::load(folder.path()).unwrap(), None);
    let scale = Scale { metres_per_unit: 0.1 + 0.2, relative_deviation: None, source: "a ruler".into() };
    scale.save(folder.path()).unwrap();
    assert_eq!(Scale::load(folder.path()).unwrap(), Some(scale));
    for (text, found) in
        [("{\"metres_per_unit\": -1}", "is -1"), ("{}", "missing field"), ("{\"metres_per_unit\": 1e999}", "range")]
    {
        fs::write(folder.path().join(SCALE_FILE), text).unwrap();
        assert_says(&Scale::load(folder.path()).unwrap_err().to_string(), &[SCALE_FILE, found, "correct the file"]);
    }
}
