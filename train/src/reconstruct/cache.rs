//! The folder of a reconstruction: what it was made from, and which stages are finished.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use splat_model::capture::scale::SCALE_FILE;

use crate::{output, progress};

/// Marks a folder as a reconstruction, and says how far it is.
pub const STAMP: &str = "reconstruction.json";

/// COLMAP's features and matches.
pub const DATABASE: &str = "database.db";

/// The photographs, as links, or the frames of a video.
pub const IMAGES: &str = "images";

/// COLMAP's models.
pub const SPARSE: &str = "sparse";

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

/// Everything else that a reconstruction writes into its folder.
const OTHERS: [&str; 8] = [IMAGES, SPARSE, LOG, IMAGES_PARTIAL, SPARSE_PARTIAL, LISTS, MASKS, SCALE_FILE];

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

    /// Opens the folder, and makes it if it is not there. What another reconstruction of other ingredients left in it is removed.
    ///
    /// # Errors
    /// If the folder holds something else, or cannot be written to.
    pub fn open(folder: &Path, ingredients: Ingredients) -> Result<Self> {
        let shown = folder.display();
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {shown}: choose another with `--out`"))?;
        let is_ours = folder.join(STAMP).exists();
        if !is_ours && fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
            bail!("{shown} is not empty and holds no reconstruction of this program: choose another `--out`");
        }
        if let Some(stamp) = stamp_in(folder).filter(|stamp| stamp.ingredients.give_the_same_as(&ingredients)) {
            if !stamp.finished.is_empty() && !stamp.finished.contains(&Stage::Model) {
                progress::note(&format!("{shown}: going on after the stages that are finished"));
            }
            return Ok(Self { folder: folder.to_owned(), stamp: Stamp { ingredients, ..stamp } });
        }
        if is_ours {
            progress::note(&format!("{shown}: the photographs or options have changed, all is reconstructed again"));
        }
        let workspace = Self {
            folder: folder.to_owned(),
            stamp: Stamp { ingredients, finished: Vec::new(), features: BTreeMap::new() },
        };
        workspace.clear(&DATABASE_FILES)?;
        workspace.clear(&OTHERS)?;
        workspace.save()?;
        Ok(workspace)
    }

    /// Removes some of its files and folders.
    pub fn clear(&self, names: &[&str]) -> Result<()> {
        for name in names {
            let path = self.join(name);
            let Ok(metadata) = fs::symlink_metadata(&path) else { continue };
            // A link is removed, not what it leads to.
            let removed = if metadata.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            removed.with_context(|| format!("cannot remove {} of an earlier reconstruction", path.display()))?;
        }
        Ok(())
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The path of something in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Whether a stage is finished.
    pub fn has(&self, stage: Stage) -> bool {
        self.stamp.finished.contains(&stage)
    }

    /// Marks a stage as finished.
    pub fn finish(&mut self, stage: Stage) -> Result<()> {
        self.stamp.finished.push(stage);
        self.save()
    }

    /// The number of features of each photograph.
    pub fn features(&self) -> &BTreeMap<String, u64> {
        &self.stamp.features
    }

    /// Keeps the number of features of each photograph.
    pub fn set_features(&mut self, features: BTreeMap<String, u64>) {
        self.stamp.features = features;
    }

    /// The log, to append to.
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
    let names = (1..).map(|number| if number == 1 { name.to_owned() } else { format!("{name}-{number}") });
    let mut folders = names.map(|name| parent.join(name));
    folders.find(|folder| is_ours(folder)).unwrap_or_else(|| parent.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(source: &str, size: u64) -> Ingredients {
        Ingredients { source: source.into(), files: [("a.jpg".to_string(), size)].into(), ..Ingredients::default() }
    }

    #[test]
    fn finished_stages_are_kept_until_something_changes() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("made");
        let mut workspace = Workspace::open(&folder, of("photos", 7)).unwrap();
        fs::write(workspace.join(DATABASE), "features").unwrap();
        workspace.set_features([("a.jpg".to_string(), 40)].into());
        workspace.finish(Stage::Features).unwrap();
        let again = Workspace::open(&folder, of("photos", 7)).unwrap();
        assert!(again.has(Stage::Features) && !again.has(Stage::Matches) && again.join(DATABASE).exists());
        assert_eq!(again.features()["a.jpg"], 40);
        let moved = Workspace::open(&folder, of("elsewhere/photos", 7)).unwrap();
        assert!(moved.has(Stage::Features));
        let changed = Workspace::open(&folder, of("photos", 8)).unwrap();
        assert!(!changed.has(Stage::Features) && !changed.join(DATABASE).exists());
    }

    #[test]
    fn a_folder_with_anything_else_is_left_alone() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("database.db"), "mine").unwrap();
        let error = Workspace::open(root.path(), of("photos", 7)).err().unwrap().to_string();
        assert!(error.contains("--out"), "{error}");
        assert_eq!(fs::read_to_string(root.path().join("database.db")).unwrap(), "mine");
    }

    #[test]
    fn photographs_of_the_same_name_have_folders_of_their_own() {
        let root = tempfile::tempdir().unwrap();
        let folder = |source: &str| own_folder(root.path(), "photos", Path::new(source));
        assert_eq!(folder("/a/photos"), root.path().join("photos"));
        Workspace::open(&root.path().join("photos"), of("/a/photos", 1)).unwrap();
        assert_eq!(folder("/a/photos"), root.path().join("photos"));
        assert_eq!(folder("/b/photos"), root.path().join("photos-2"));
        fs::create_dir_all(root.path().join("photos-2/x")).unwrap();
        assert_eq!(folder("/b/photos"), root.path().join("photos-3"));
    }
}
