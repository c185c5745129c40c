//! Files that are replaced whole: whoever reads finds the old contents or the new ones, also after a loss of power.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Error, Write};
use std::path::{Path, PathBuf};

/// Who may read: everybody as far as the process's mask allows.
pub const ORDINARY: u32 = 0o666;

/// Writes `contents` to `{path}.new`, brings it to the disk, and renames it to `path`. `mode`: permissions of a new file on Unix,
/// before the process's mask.
///
/// # Errors
/// Whatever the disk says; `path` is then as it was.
pub fn replace(path: &Path, contents: &[u8], mode: u32) -> Result<(), Error> {
    let beside = beside(path);
    // Left by a run that was killed.
    let _ = std::fs::remove_file(&beside);
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    #[cfg(not(unix))]
    let _ = mode;
    let mut file = options.open(&beside)?;
    file.write_all(contents)?;
    file.sync_all()?;
    std::fs::rename(&beside, path)?;
    // The name is in the folder.
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

fn beside(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".new");
    name.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_also_after_a_run_that_was_killed_while_writing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("team.map");
        std::fs::write(&path, "old").unwrap();
        std::fs::write(folder.path().join("team.map.new"), "half of").unwrap();
        replace(&path, b"new", ORDINARY).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_secret_is_for_its_owner_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key.pem");
        replace(&path, b"secret", 0o600).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(replace(&folder.path().join("no/such/file"), b"", ORDINARY).is_err());
    }
}
