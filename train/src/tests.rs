use anyhow::anyhow;

use super::*;

#[test]
fn causes_are_said_once() {
    let error = anyhow!("disk full").context("cannot write a.png: disk full").context("no pictures");
    assert_eq!(describe(&error), "error: no pictures\n  because: cannot write a.png: disk full");
}
