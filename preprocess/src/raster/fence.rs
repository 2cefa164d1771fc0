//! Where files may lie that are opened for somebody who may not open all.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use super::error::RasterError;

/// Folders: a file that is opened must lie in one of them, whatever links led to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fence {
    folders: Vec<PathBuf>,
}

impl Fence {
    /// Around `folders`, whose paths are absolute and without symbolic links.
    #[must_use]
    pub fn new(folders: Vec<PathBuf>) -> Self {
        Self { folders }
    }

    /// Checks where `file`, which was opened at `path`, lies: the file itself, not what is at the path now.
    ///
    /// # Errors
    ///
    /// [`RasterError::Outside`], [`RasterError::Io`].
    pub(crate) fn check(&self, file: &File, path: &Path) -> Result<(), RasterError> {
        let place = place_of(file, path).map_err(RasterError::io("find", path))?;
        if self.folders.iter().any(|folder| place.starts_with(folder)) {
            return Ok(());
        }
        Err(RasterError::Outside { path: path.to_owned() })
    }
}

#[cfg(target_os = "linux")]
fn place_of(file: &File, _: &Path) -> io::Result<PathBuf> {
    use std::os::fd::AsRawFd as _;
    std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

/// Where no system says it: the place without links, if that has the same file.
#[cfg(all(unix, not(target_os = "linux")))]
fn place_of(file: &File, path: &Path) -> io::Result<PathBuf> {
    use std::os::unix::fs::MetadataExt as _;
    let place = path.canonicalize()?;
    let (opened, there) = (file.metadata()?, place.symlink_metadata()?);
    if (opened.dev(), opened.ino()) == (there.dev(), there.ino()) {
        return Ok(place);
    }
    Err(io::Error::other("another file has its place"))
}

#[cfg(not(unix))]
fn place_of(_: &File, path: &Path) -> io::Result<PathBuf> {
    path.canonicalize()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn what_counts_is_where_the_file_lies_that_was_opened() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let (within, beside) = (root.join("within"), root.join("within-not"));
        for folder in [&within, &beside] {
            std::fs::create_dir(folder).unwrap();
            std::fs::write(folder.join("file"), "text").unwrap();
        }
        std::os::unix::fs::symlink(beside.join("file"), within.join("link")).unwrap();
        let fence = Fence::new(vec![within.clone()]);
        let check = |path: &Path| fence.check(&File::open(path).unwrap(), path);
        check(&within.join("file")).unwrap();
        check(&beside.join("../within/file")).unwrap();
        let links = [within.join("link"), within.join("../within-not/file"), beside.join("file")];
        for path in links {
            let refused = check(&path).unwrap_err();
            assert!(matches!(refused, RasterError::Outside { .. }), "{refused}");
        }
        // Opened through a link that is another file by now.
        let link = within.join("link");
        let opened = File::open(&link).unwrap();
        std::fs::remove_file(&link).unwrap();
        std::fs::write(&link, "text").unwrap();
        fence.check(&opened, &link).unwrap_err();
    }
}
