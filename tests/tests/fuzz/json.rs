//! The readers of JSON, and checks of their results.

use std::path::PathBuf;

use splat_model::trainer::TrainConfig;

use super::engine::{FuzzTarget, folder};
use super::seeds;
use super::split;
use super::targets::shape;

/// The configuration of a run, which the program writes and reads.
pub struct Json {
    folder: PathBuf,
    text: Vec<u8>,
}

impl Json {
    pub fn new(name: &str) -> Self {
        Self { folder: folder(name), text: Vec::new() }
    }
}

impl FuzzTarget for Json {
    fn name(&self) -> &'static str {
        "json"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        seeds::json()
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "{",
            "}",
            "[",
            "]",
            "[[[[[[[[[[[[[[[[",
            "{\"a\":{\"a\":{\"a\":",
            ":",
            ",",
            "\"",
            "\\u0000",
            "\\ud800",
            "null",
            "true",
            "1e999",
            "-0.0",
            "\"steps\"",
            "\"density\"",
            "\"max_splats\"",
            "\"background\"",
            "\"a\u{0}b\"",
            "\u{feff}",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        split::text(input)
    }

    fn place(&mut self, input: &[u8]) {
        self.text = input.to_vec();
    }

    fn read(&mut self) -> Result<String, String> {
        match serde_json::from_slice::<TrainConfig>(&self.text) {
            Ok(config) => {
                let text = serde_json::to_string(&config).map_err(|error| error.to_string())?;
                let again: TrainConfig = serde_json::from_str(&text).map_err(|error| format!("{error} in {text}"))?;
                let value = |config| serde_json::to_value(config).map_err(|error| error.to_string());
                match same(&value(&config)?, &value(&again)?) {
                    true => Ok("accepted".into()),
                    false => Err(format!("{config:?} reads back as {again:?}")),
                }
            }
            Err(error) => Ok(shape(&error.to_string(), &self.folder)),
        }
    }
}

/// Whether two documents are equal, with numbers within an ulp: the default parser of `serde_json` is not exact without its feature
/// `float_roundtrip`.
fn same(a: &serde_json::Value, b: &serde_json::Value) -> bool {
    use serde_json::Value::{Array, Number, Object};
    match (a, b) {
        (Number(a), Number(b)) if a.is_f64() && b.is_f64() => {
            let [a, b] = [a, b].map(|n| n.as_f64().expect("it is one"));
            a == b || (a - b).abs() <= f64::EPSILON * a.abs()
        }
        (Array(a), Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        (Object(a), Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, value)| b.get(key).is_some_and(|other| same(value, other)))
        }
        (a, b) => a == b,
    }
}

#[test]
fn numbers_may_differ_by_an_ulp_and_nothing_else() {
    let read = |text: &str| serde_json::from_str(text).expect("JSON");
    assert!(same(&read("[{\"a\": 21474836480.000126}]"), &read("[{\"a\": 21474836480.00013}]")));
    assert!(!same(&read("[{\"a\": 1.0}]"), &read("[{\"a\": 1.000000000000001}]")));
    assert!(!same(&read("{\"a\": 1}"), &read("{\"b\": 1}")));
    assert!(!same(&read("[1, 2]"), &read("[1]")));
}
