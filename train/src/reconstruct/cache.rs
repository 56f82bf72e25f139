//! The folder of a reconstruction: what it was made from, and which stages are finished.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use splat_model::capture::scale::{SCALE_FILE, Scale};

pub use crate::input::SPARSE;
use crate::{output, progress};

/// Marks a folder as a reconstruction, and says how far it is.
pub const STAMP: &str = "reconstruction.json";

/// COLMAP's features and matches.
pub const DATABASE: &str = "database.db";

/// The photographs, as links, or the frames of a video.
pub const IMAGES: &str = "images";

/// All that programs printed.
pub const LOG: &str = "reconstruction.log";

/// Models of a mapper that is at work.
pub const SPARSE_PARTIAL: &str = "sparse.partial";

/// Frames while they are decoded.
pub const IMAGES_PARTIAL: &str = "images.partial";

/// Lists of photographs by camera.
pub const LISTS: &str = "lists";

/// Vocabulary of the photographs' features.
pub const VOCABULARY: &str = "vocabulary.bin";

/// Masks of the photographs, as a link.
pub const MASKS: &str = "masks";

/// The database and what SQLite keeps beside it.
pub const DATABASE_FILES: [&str; 4] = [DATABASE, "database.db-wal", "database.db-shm", "database.db-journal"];

/// Part of a reconstruction that is not repeated once it is finished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Frames of a video are in `images/`.
    Frames,
    /// Features of all photographs are in the database.
    Features,
    /// Matches are in the database.
    Matches,
    /// Models are in `sparse/`.
    Model,
}

/// What a reconstruction is made from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ingredients {
    /// The folder of photographs, or the video.
    pub source: PathBuf,
    /// Names of the files and their sizes, bytes.
    pub files: BTreeMap<String, u64>,
    /// Options that change the result.
    pub options: BTreeMap<String, String>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Stamp {
    ingredients: Ingredients,
    finished: Vec<Stage>,
    /// Number of features of each photograph.
    features: BTreeMap<String, u64>,
}

/// The folder of a reconstruction that is under way or finished.
pub struct Workspace {
    folder: PathBuf,
    stamp: Stamp,
}

/// The stamp of a folder, `None` if it has none that can be read.
fn stamp_in(folder: &Path) -> Option<Stamp> {
    serde_json::from_slice(&fs::read(folder.join(STAMP)).ok()?).ok()
}

impl Workspace {
    /// Whether a folder holds a finished reconstruction of these ingredients. An error if it holds another
    /// reconstruction, or anything else.
    pub fn is_finished(folder: &Path, ingredients: &Ingredients) -> Result<bool> {
        let shown = folder.display();
        match stamp_in(folder) {
            // The same files may be elsewhere now.
            Some(Stamp { ingredients: Ingredients { files, options, .. }, finished, .. })
                if (&files, &options) == (&ingredients.files, &ingredients.options) =>
            {
                Ok(finished.contains(&Stage::Model))
            }
            Some(_) => bail!(
                "{shown} holds a reconstruction of other photographs, or with other options: move it away, or choose another `--out`"
            ),
            None if fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none()) => Ok(false),
            None => {
                bail!("{shown} is not empty and holds no reconstruction of this program: choose another `--out`")
            }
        }
    }

    /// Opens a folder that [`is_finished`](Self::is_finished) accepts, and makes it if it is not there. An error if it
    /// cannot be written to.
    pub fn open(folder: &Path, ingredients: Ingredients) -> Result<Self> {
        let shown = folder.display();
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {shown}: choose another with `--out`"))?;
        let mut workspace = Self { folder: folder.to_owned(), stamp: Stamp::default() };
        match stamp_in(folder) {
            Some(stamp) => {
                if !stamp.finished.is_empty() && !stamp.finished.contains(&Stage::Model) {
                    progress::note(&format!("{shown}: going on after the stages that are finished"));
                }
                workspace.stamp = Stamp { ingredients, ..stamp };
            }
            None => {
                workspace.stamp.ingredients = ingredients;
                workspace.save()?;
            }
        }
        Ok(workspace)
    }

    /// Removes what a stage left that did not finish. An error if something is there and cannot be removed.
    pub fn clear(&self, names: &[&str]) -> Result<()> {
        for path in names.iter().map(|name| self.join(name)) {
            let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            match removed {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    return Err(error).with_context(|| format!("cannot remove {}", path.display()));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Gives a folder that is complete its name. Nothing is replaced.
    pub fn complete(&self, partial: &Path, name: &str) -> Result<()> {
        fs::rename(partial, self.join(name))
            .with_context(|| format!("cannot rename {} to {name}: move away what has that name", partial.display()))
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn join(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn has(&self, stage: Stage) -> bool {
        self.stamp.finished.contains(&stage)
    }

    pub fn finish(&mut self, stage: Stage) -> Result<()> {
        self.stamp.finished.push(stage);
        self.save()
    }

    pub fn features(&self) -> &BTreeMap<String, u64> {
        &self.stamp.features
    }

    pub fn set_features(&mut self, features: BTreeMap<String, u64>) {
        self.stamp.features = features;
    }

    pub fn log(&self) -> Result<File> {
        let path = self.join(LOG);
        let log = OpenOptions::new().create(true).append(true).open(&path);
        log.with_context(|| format!("cannot write {}", path.display()))
    }

    fn save(&self) -> Result<()> {
        let text = serde_json::to_string_pretty(&self.stamp)?;
        output::write(&self.join(STAMP), |file| Ok(writeln!(file, "{text}")?))
    }
}

/// Keeps the size of a unit in the folder of a reconstruction, unless it is stated there. Elsewhere nothing is written.
/// An error if the file cannot be read or written.
pub fn keep_scale(folder: &Path, scale: &Scale) -> Result<()> {
    if stamp_in(folder).is_none() {
        return Ok(());
    }
    match Scale::load(folder)? {
        None => scale.save(folder)?,
        Some(stated) if stated == *scale => {}
        Some(_) => progress::note(&format!(
            "{} states another scale, and stays: only this run has the new one",
            folder.join(SCALE_FILE).display()
        )),
    }
    Ok(())
}

/// The first of `parent/NAME`, `parent/NAME-2` and so on that is free or holds a reconstruction of `source`.
pub fn own_folder(parent: &Path, name: &str, source: &Path) -> PathBuf {
    let is_ours = |folder: &Path| match fs::read(folder.join(STAMP)) {
        Ok(text) => serde_json::from_slice(&text).map_or(true, |stamp: Stamp| stamp.ingredients.source == source),
        Err(_) => fs::read_dir(folder).map_or(!folder.exists(), |mut entries| entries.next().is_none()),
    };
    output::numbered(parent, OsStr::new(name), is_ours)
}

#[cfg(test)]
mod tests;
