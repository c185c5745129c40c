//! Folders that a program writes to: tried before the work, so that a job whose results could not be kept is not begun.

use std::fs;
use std::io;
use std::path::Path;

/// Makes the folder if it is not there, and tries to write to it.
///
/// # Errors
/// It cannot be made or written to.
pub fn make_writable(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let probe = folder.join(format!(".probe-{}", std::process::id()));
    fs::write(&probe, b"?")?;
    fs::remove_file(&probe)
}

/// Whether [`make_writable`] would do; leaves nothing there.
///
/// # Errors
/// As [`make_writable`].
pub fn could_be_written(folder: &Path) -> io::Result<()> {
    let missing: Vec<&Path> = folder.ancestors().take_while(|part| !part.exists()).collect();
    let made = make_writable(folder);
    for part in missing {
        // One that could not be made is not there, and one that somebody else uses by now stays.
        let _ = fs::remove_dir(part);
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_written_is_found_out_and_one_that_can_stays_empty() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a/b");
        could_be_written(&out).unwrap();
        assert!(!folder.path().join("a").exists());
        make_writable(&out).unwrap();
        could_be_written(&out).unwrap();
        assert_eq!(fs::read_dir(&out).unwrap().count(), 0);
        fs::write(out.join("file"), b"").unwrap();
        assert!(make_writable(&out.join("file")).is_err());
        assert!(could_be_written(&out.join("file/below")).is_err());
    }
}
