//! A small file system, to be filled.

use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

/// A file system of a size, as long as this lives.
pub(crate) struct Mounted(TempDir);

impl Mounted {
    /// `None` without the right to mount one.
    pub(crate) fn new(bytes: u64) -> Option<Self> {
        let folder = TempDir::new().unwrap();
        mount(&format!("size={bytes}"), folder.path()).then(|| Self(folder))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn resize(&self, bytes: u64) {
        assert!(mount(&format!("remount,size={bytes}"), self.path()));
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.path()).status();
    }
}

fn mount(options: &str, folder: &Path) -> bool {
    let mut mount = Command::new("mount");
    mount.args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(folder);
    mount.output().is_ok_and(|output| output.status.success())
}
