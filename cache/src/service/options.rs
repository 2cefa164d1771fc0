//! What a service is told at its start, and why it may not start.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use areoid_formats::catalog::CatalogError;

use super::listen::Limits;

/// What to serve, where, and within what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// The catalog.
    pub folder: PathBuf,
    /// Where anybody may ask.
    pub listen: SocketAddr,
    /// Stored pages in memory, in bytes.
    pub memory_bytes: u64,
    /// The second listener, if there is to be one.
    pub admin: Option<Admin>,
    /// Threads that answer; one a core if `None`.
    pub threads: Option<usize>,
    /// What clients may take.
    pub limits: Limits,
}

/// The second listener: state, counters, and changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Admin {
    /// Where it listens: on the loopback only, unless there is a token.
    pub listen: SocketAddr,
    /// Whether the service does without where that is taken.
    pub is_optional: bool,
    /// A file whose first line is the token; without one nobody may change anything.
    pub token_file: Option<PathBuf>,
    /// Folders that rasters may lie in.
    pub allowed: Vec<PathBuf>,
}

/// A service that did not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// The catalog cannot be opened.
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    /// An address cannot be listened on.
    #[error("cannot listen on {address}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// The admin listener would be open to others.
    #[error("the admin listener on {address} needs a token file: it is not on the loopback")]
    Exposed {
        /// The address.
        address: SocketAddr,
    },
    /// A file or folder named at the start cannot be read.
    #[error("cannot read {}", path.display())]
    Path {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A token that is easily guessed.
    #[error("the token in {} is shorter than 16 characters", path.display())]
    Token {
        /// The file.
        path: PathBuf,
    },
    /// The system gave no threads.
    #[error("cannot start threads")]
    Threads(#[source] io::Error),
}
