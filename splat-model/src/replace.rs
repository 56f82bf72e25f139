//! Atomic writing of files: each is written under a temporary name in the same folder, then renamed.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tempfile::NamedTempFile;

/// Part of the names of files in progress, before what keeps two writers of the same file apart.
const TEMPORARY: &str = ".tmp-";

/// Number of characters after [`TEMPORARY`], which `tempfile` chooses.
const RANDOM: usize = 6;

/// What [`replace`] does, with the remedy, for errors.
pub(crate) const WRITE: &str = "write it (is the folder there, writable, and not full?)";

/// Writes a file by calling `fill`. It replaces an existing file once it is complete and on the disk; nothing at all replaces none. No
/// temporary file is left behind unless the process is killed.
///
/// # Errors
/// If `fill` fails, the file cannot be written, or an empty file would replace another.
pub fn replace<E: From<io::Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let temporary = begin(path)?;
    let mut out = BufWriter::with_capacity(1 << 20, temporary.as_file().try_clone()?);
    fill(&mut out)?;
    out.flush()?;
    // Closed before the rename, which some systems refuse for open files.
    drop(out);
    Ok(finish(temporary, path)?)
}

/// Creates a hidden file beside `path`, because a rename is atomic only within a file system. It is removed if it is dropped.
pub(crate) fn begin(path: &Path) -> io::Result<NamedTempFile> {
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let prefix = [".".as_ref(), name, TEMPORARY.as_ref()].into_iter().collect::<OsString>();
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Those of any new file; otherwise its owner alone could read it.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    // Of a name alone, the parent is empty.
    builder.tempfile_in(path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new(".")))
}

/// Gives a complete file its name.
pub(crate) fn finish(temporary: NamedTempFile, path: &Path) -> io::Result<()> {
    // Opened anew: a writer that was given the name may have put another file there.
    let written = File::options().write(true).open(temporary.path())?;
    if written.metadata()?.len() == 0 && path.exists() {
        return Err(io::Error::other("it would be empty, and the file of that name is kept"));
    }
    // Without this, a power cut after the rename could leave an empty file in place of a good one.
    written.sync_all()?;
    drop(written);
    temporary.persist(path).map_err(|error| error.error)?;
    Ok(())
}

/// The name of the file that [`replace`] was writing under this name, if it was. A process that was killed leaves such files.
pub fn name_of_temporary(name: &str) -> Option<&str> {
    let (name, random) = name.strip_prefix('.')?.rsplit_once(TEMPORARY)?;
    let is_random = random.len() == RANDOM && random.chars().all(|c| c.is_ascii_alphanumeric());
    (is_random && !name.is_empty()).then_some(name)
}
