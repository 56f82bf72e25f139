//! The folder of a reconstruction: what it was made from, and which stages are finished.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use splat_model::capture::scale::SCALE_FILE;

pub use crate::input::SPARSE;
use crate::own::{self, OwnFiles};
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

/// Masks of the photographs, as a link.
pub const MASKS: &str = "masks";

/// The database and what SQLite keeps beside it.
pub const DATABASE_FILES: [&str; 4] = [DATABASE, "database.db-wal", "database.db-shm", "database.db-journal"];

/// Everything else that belongs to a reconstruction, apart from the link to masks. The user writes the scale, which another one does not have.
const OTHERS: [&str; 7] = [IMAGES, SPARSE, LOG, IMAGES_PARTIAL, SPARSE_PARTIAL, LISTS, SCALE_FILE];

/// The files of COLMAP's models, without extensions.
const MODEL: [&str; 6] = ["cameras", "images", "points3D", "frames", "rigs", "project"];

/// First bytes of the files that programs write: JPEG, SQLite's database, and a log that begins with a command.
const JPEG_START: &[u8] = b"\xff\xd8\xff";
const DATABASE_START: &[u8] = b"SQLite format 3\0";
const LOG_START: &[u8] = b"\n$ ";

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

/// What a reconstruction is made from. If files or options change, everything is made again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ingredients {
    /// The folder of photographs, or the video.
    pub source: PathBuf,
    /// Names of the files and their sizes, bytes.
    pub files: BTreeMap<String, u64>,
    /// Options that change the result.
    pub options: BTreeMap<String, String>,
}

impl Ingredients {
    /// Whether these give the same reconstruction, wherever the files are.
    fn give_the_same_as(&self, other: &Self) -> bool {
        (&self.files, &self.options) == (&other.files, &other.options)
    }
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Stamp {
    ingredients: Ingredients,
    finished: Vec<Stage>,
    /// Number of features of each photograph.
    features: BTreeMap<String, u64>,
    /// Frames, copies of photographs, models, and the size of a unit.
    #[serde(default)]
    files: OwnFiles,
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
    /// Whether a folder holds a finished reconstruction of these ingredients.
    pub fn is_finished(folder: &Path, ingredients: &Ingredients) -> bool {
        let is_finished = |stamp: &Stamp| stamp.finished.contains(&Stage::Model);
        stamp_in(folder).is_some_and(|stamp| stamp.ingredients.give_the_same_as(ingredients) && is_finished(&stamp))
    }

    /// Refuses a folder that holds something else than a reconstruction.
    pub fn check(folder: &Path) -> Result<()> {
        let is_empty = fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
        let shown = folder.display();
        ensure!(
            is_empty || stamp_in(folder).is_some(),
            "{shown} is not empty and holds no reconstruction of this program: choose another `--out`"
        );
        Ok(())
    }

    /// Opens the folder, and makes it if it is not there. What a reconstruction of other ingredients left in it is removed.
    ///
    /// # Errors
    /// If the folder holds something else, files of it are not as they were written, or it cannot be written to.
    pub fn open(folder: &Path, ingredients: Ingredients) -> Result<Self> {
        let shown = folder.display();
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {shown}: choose another with `--out`"))?;
        let mut workspace = Self { folder: folder.to_owned(), stamp: Stamp::default() };
        match stamp_in(folder) {
            Some(stamp) if stamp.ingredients.give_the_same_as(&ingredients) => {
                if !stamp.finished.is_empty() && !stamp.finished.contains(&Stage::Model) {
                    progress::note(&format!("{shown}: going on after the stages that are finished"));
                }
                workspace.stamp = Stamp { ingredients, ..stamp };
                return Ok(workspace);
            }
            Some(stamp) => {
                progress::note(&format!(
                    "{shown}: the photographs or options have changed, all is reconstructed again"
                ));
                workspace.stamp = stamp;
                workspace.clear(&[&DATABASE_FILES[..], &OTHERS].concat())?;
                let masks = workspace.join(MASKS);
                if masks.is_symlink() {
                    fs::remove_file(&masks).with_context(|| format!("cannot remove the link {}", masks.display()))?;
                }
            }
            None => Self::check(folder)?,
        }
        workspace.stamp = Stamp { ingredients, ..Stamp::default() };
        workspace.save()?;
        Ok(workspace)
    }

    /// Removes some of its files and folders. A link is removed, not what it leads to.
    ///
    /// # Errors
    /// If a file there is none that this program or COLMAP wrote: then nothing is removed.
    pub fn clear(&self, names: &[&str]) -> Result<()> {
        let mut found = Vec::new();
        for root in names.iter().map(|name| self.join(name)) {
            let files = own::files_below(&root).with_context(|| format!("cannot list {}", root.display()))?;
            if let Some(other) = files.iter().find(|file| !self.is_own(file)) {
                bail!(
                    "{} is in the way of a new reconstruction, and is not as this program wrote it: move it away, or choose another \
                     `--out`",
                    other.display()
                );
            }
            found.push((root, files));
        }
        found.into_iter().try_for_each(|(root, files)| {
            own::remove(&root, &files)
                .with_context(|| format!("cannot remove {} of an earlier reconstruction", root.display()))
        })
    }

    /// Whether this program wrote a file of the folder, or one that it called, by its name and its content.
    fn is_own(&self, file: &Path) -> bool {
        let name = own::name_below(&self.folder, file);
        let (top, below) = name.split_once('/').unwrap_or((&name, ""));
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        match top {
            IMAGES if file.is_symlink() => self.stamp.ingredients.files.contains_key(below),
            IMAGES | SPARSE => self.stamp.files.hold(&self.folder, file),
            IMAGES_PARTIAL => own::begins_with(file, JPEG_START),
            SPARSE_PARTIAL => MODEL.contains(&stem.as_ref()),
            LISTS => stem.parse::<usize>().is_ok(),
            LOG => own::begins_with(file, LOG_START),
            DATABASE => own::begins_with(file, DATABASE_START),
            // What SQLite keeps beside the database.
            _ => DATABASE_FILES.contains(&top),
        }
    }

    /// Gives a folder that is complete its name, in place of an earlier one, and keeps in mind what is in it.
    pub fn complete(&mut self, partial: &str, name: &str) -> Result<()> {
        self.clear(&[name])?;
        self.stamp.files.add(&self.folder, partial, name).with_context(|| format!("cannot read {partial}"))?;
        // Before the folder has its name, so that it is known at any time.
        self.save()?;
        fs::rename(self.join(partial), self.join(name)).with_context(|| format!("cannot rename {partial} to {name}"))
    }

    pub fn keep_in_mind(&mut self, name: &str) -> Result<()> {
        self.stamp.files.add(&self.folder, name, name).with_context(|| format!("cannot read {name}"))?;
        self.save()
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
