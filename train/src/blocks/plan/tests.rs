use super::*;

fn args(blocks: Option<usize>, splats_per_block: Option<usize>) -> PlanArgs {
    let (capture, out, options) = Default::default();
    PlanArgs { capture, out, blocks, splats_per_block, margin: 0.1, min_share: 0.1, coarse_steps: None, options }
}

#[test]
fn blocks_have_room_for_what_is_not_kept() {
    assert_eq!(counts(&args(Some(1), None), 1000), (1, 1000));
    assert_eq!(counts(&args(Some(2), None), 1000), (2, 650));
    assert_eq!(counts(&args(None, Some(650)), 1000), (2, 650));
    assert_eq!(counts(&args(None, Some(649)), 1000), (3, 649));
    assert_eq!(counts(&args(None, Some(1000)), 1000), (1, 1000));
}

#[test]
fn a_path_leads_from_a_block_to_its_capture() {
    let folder = tempfile::tempdir().unwrap();
    let (block, capture) = (folder.path().join("plan/block-0"), folder.path().join("my capture"));
    fs::create_dir_all(&block).unwrap();
    fs::create_dir_all(&capture).unwrap();
    let path = path_from(&block, &capture).unwrap();
    assert_eq!(path, Path::new("../../my capture"));
    assert_eq!(block.join(path).canonicalize().unwrap(), capture.canonicalize().unwrap());
}
