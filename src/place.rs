//! Where a catalog is, as arguments say it.

use std::path::PathBuf;

use areoid_cache::place::{DiskCache, Place};
use areoid_cache::{Cache, Options};

use crate::failure::{Failure, say_why};

/// A catalog to look at.
#[derive(Debug, clap::Args)]
pub(crate) struct Source {
    /// The catalog: its folder, or the address of its server.
    #[arg(value_name = "DIR|URL")]
    catalog: Place,

    /// Keep what a server answers in this folder, for the next time.
    #[arg(long, value_name = "DIR")]
    disk_cache: Option<PathBuf>,

    /// The most that --disk-cache takes, in mebibytes [default: 4096].
    #[arg(long, value_name = "MIB", requires = "disk_cache")]
    disk_cache_mib: Option<u64>,
}

const DISK_CACHE_MIB: u64 = 4096;

impl Source {
    /// Opens it on a budget, and says what had to be left out.
    pub(crate) fn open(&self, memory_mib: usize) -> Result<Cache, Failure> {
        let place = self.place()?;
        let options = Options::for_place(&place, memory_mib.saturating_mul(1 << 20));
        let cache = Cache::open(place, options).wait()?;
        for problem in cache.problems() {
            say_why("warning", problem);
        }
        Ok(cache)
    }

    /// What it is called.
    pub(crate) fn name(&self) -> String {
        self.catalog.to_string()
    }

    /// Its folder, if it is one.
    pub(crate) fn folder(&self) -> Option<PathBuf> {
        match &self.catalog {
            Place::Folder(folder) => Some(folder.clone()),
            Place::Server(_) => None,
        }
    }

    fn place(&self) -> Result<Place, Failure> {
        let most_bytes = self.disk_cache_mib.unwrap_or(DISK_CACHE_MIB).saturating_mul(1 << 20);
        match (self.catalog.clone(), &self.disk_cache) {
            (Place::Server(mut server), Some(folder)) => {
                server.disk = Some(DiskCache { folder: folder.clone(), most_bytes });
                Ok(Place::Server(server))
            }
            (Place::Folder(_), Some(_)) => {
                Err(Failure::Misused("--disk-cache is of no use for a folder".to_owned()))
            }
            (place, None) => Ok(place),
        }
    }
}
