use super::*;

#[test]
fn lines_of_several_versions() {
    assert_eq!(field("  Name:            a b.jpg"), Some(("Name", "a b.jpg")));
    let logged = "I20260315 10:00:00.000001 77 feature_extraction.cc:300]   Features:        1250 (SIFT)";
    assert_eq!(field(logged), Some(("Features", "1250 (SIFT)")));
    assert_eq!(field("Elapsed time"), None);
    assert_eq!(matched("Matching block [2/3, 1/3] in 2.1s"), Some((4, 9)));
    assert_eq!(matched("I2026 pairing.cc:1] Processing image [7/50]"), Some((7, 50)));
    assert_eq!(matched("Indexing image [7/50] in 0.04s"), None);
    assert_eq!(matched("  Residuals : 372 [px]"), None);
    assert_eq!(matched("[0/0, 0/0]"), None);
    assert_eq!(registered("Registering image #19 (3)"), Some(3));
    assert_eq!(registered("I2026 x.cc:1] Registering image #19 (num_reg_frames=12)"), Some(12));
    assert_eq!(registered("  => Image sees 185 / 1112 points"), None);
}
