//! Which files a scene consists of.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::Beginning;

/// A name in a document is shorter. Data may stand there too, as text.
const MAX_NAME_BYTES: usize = 1_000;

/// The files of a scene: the named one and, where that is a document, those beside it which it names.
pub fn files(path: &Path) -> Vec<PathBuf> {
    fn texts(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::String(text) if text.len() < MAX_NAME_BYTES => found.push(text.clone()),
            Value::Array(values) => values.iter().for_each(|value| texts(value, found)),
            Value::Object(fields) => fields.values().for_each(|value| texts(value, found)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    if let Ok(Beginning::Json) = Beginning::of(path)
        && let Ok(document) = fs::read(path).map_err(drop).and_then(|text| serde_json::from_slice(&text).map_err(drop))
    {
        texts(&document, &mut found);
    }
    let beside = found.iter().map(|name| path.with_file_name(name)).filter(|file| file.is_file());
    std::iter::once(path.to_path_buf()).chain(beside).collect()
}
