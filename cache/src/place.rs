//! Where a catalog is: in a folder, or on a server.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::remote::{Blocks, Client, RemoteError};

/// Where a catalog is.
///
/// Text is a server's address if it starts with `http://` or `https://`, and a folder's path if not.
/// Paths are folders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A catalog on the disk.
    Folder(PathBuf),
    /// A catalog that somebody serves.
    Server(Server),
}

/// A server, and what is kept of what it says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Server {
    /// Its address, such as `http://127.0.0.1:8360`.
    pub url: String,
    /// Where what was read is kept for the next time.
    pub disk: Option<DiskCache>,
}

/// A folder for what was read from servers. Several processes, and servers, may share one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiskCache {
    /// The folder, made if it is not there.
    pub folder: PathBuf,
    /// The most that it takes.
    pub most_bytes: u64,
}

impl Place {
    /// Whether it is a server.
    #[must_use]
    pub fn is_server(&self) -> bool {
        matches!(self, Self::Server(_))
    }
}

impl From<OsString> for Place {
    fn from(text: OsString) -> Self {
        let is_address = |text: &str| text.starts_with("http://") || text.starts_with("https://");
        match text.to_str() {
            Some(url) if is_address(url) => {
                Self::Server(Server { url: url.to_owned(), disk: None })
            }
            _ => Self::Folder(text.into()),
        }
    }
}

impl From<&OsStr> for Place {
    fn from(text: &OsStr) -> Self {
        text.to_owned().into()
    }
}

impl From<&str> for Place {
    fn from(text: &str) -> Self {
        OsString::from(text).into()
    }
}

impl From<&Path> for Place {
    fn from(folder: &Path) -> Self {
        Self::Folder(folder.to_owned())
    }
}

impl From<&Self> for Place {
    fn from(place: &Self) -> Self {
        place.clone()
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder(folder) => folder.display().fmt(f),
            Self::Server(server) => server.url.fmt(f),
        }
    }
}

/// A server that can be asked.
#[derive(Clone, Debug)]
pub(crate) struct Connection {
    pub(crate) client: Client,
    pub(crate) blocks: Option<Arc<Blocks>>,
}

impl Server {
    /// Makes the folder, and asks nobody yet.
    pub(crate) fn connection(&self) -> Result<Connection, RemoteError> {
        let client = Client::new(&self.url)?;
        let open = |DiskCache { folder, most_bytes }: &DiskCache| {
            let failed =
                |source| RemoteError::Disk { folder: folder.display().to_string(), source };
            Blocks::open(folder, *most_bytes).map(Arc::new).map_err(failed)
        };
        let blocks = self.disk.as_ref().map(open).transpose()?;
        Ok(Connection { client, blocks })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_starts_like_an_address_is_a_server() {
        for url in ["http://127.0.0.1:8360", "http://host/mars", "https://host", "http://"] {
            let server = Server { url: url.to_owned(), disk: None };
            assert_eq!(Place::from(url), Place::Server(server), "{url}");
            assert!(!Place::from(Path::new(url)).is_server());
        }
        for folder in ["mars", "/data/mars", "http:", "ftp://host", "./http://host", ""] {
            assert_eq!(Place::from(folder), Place::Folder(folder.into()), "{folder}");
            assert_eq!(Place::from(folder).to_string(), folder);
        }
    }
}
