use super::*;

#[test]
fn runs_hold_whole_tiles_and_all_slots() {
    // Tiles of 3, 1, 1 and 2 started segments; a slot may stay empty between two tiles.
    let starts = [0, 300, 300, 428, 600];
    let run = |tiles, slots| RunSlots { tiles, slots };
    assert_eq!(runs_from(&starts, 100), [run(0..4, 0..8)]);
    assert_eq!(runs_from(&starts, 4), [run(0..2, 0..4), run(2..4, 4..8)]);
    assert_eq!(runs_from(&starts, 1), [run(0..1, 0..3), run(1..2, 3..4), run(2..3, 4..6), run(3..4, 6..8)]);
    assert_eq!(runs_from(&[0, 0], 1), [run(0..1, 0..1)]);
}
