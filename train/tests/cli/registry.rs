//! `--loss`.

use std::fs;

use crate::run::{DEMO, end, fresh, splat, succeed};
use crate::text;

#[test]
fn the_losses_of_the_program_differ() {
    let run = |loss: &str| {
        let out = fresh(&format!("loss-{loss}"));
        let options = ["--steps", "12", "--max-side", "48", "--effects", "none", "--loss", loss];
        succeed(splat(&["train", text(&DEMO), "--out", text(&out)]).args(options));
        fs::read(out.join("scene.ply")).unwrap()
    };
    let scenes = ["l1-ssim", "l1", "l2", "surfaces"].map(run);
    assert!((0..4).all(|i| (0..i).all(|j| scenes[i] != scenes[j])));
    let refused = end(&mut splat(&["train", text(&DEMO), "--loss", "squares"]));
    assert!(
        refused.code == Some(2) && refused.stderr.contains("[possible values: l1, l1-ssim, l2, surfaces]"),
        "{refused:?}"
    );
}
