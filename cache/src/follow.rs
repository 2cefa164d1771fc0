//! Keeps a cache at the newest generation of its catalog, whoever changes it.

use std::error::Error;
use std::path::PathBuf;
use std::sync::{Arc, Weak};
use std::time::Duration;

use areoid_formats::catalog::{Catalog, CatalogError};
use tokio::task::spawn_blocking;
use tokio::time::sleep;
use tracing::debug;

use crate::engine::Engine;
use crate::open::{CacheError, Contents, News, news};

/// A catalog's folder, and what of it the cache has.
pub(crate) struct Followed {
    pub(crate) folder: PathBuf,
    pub(crate) generation: u64,
    pub(crate) contents: Contents,
}

/// How often the folder is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(300);

/// Follows for as long as the engine lives.
///
/// # Cancel safety
///
/// Dropped while it looks, it changes nothing.
pub(crate) async fn follow(engine: Weak<Engine>, mut followed: Followed) {
    loop {
        sleep(LOOK_EVERY).await;
        let looked = spawn_blocking(move || {
            let found = look(&followed);
            (followed, found)
        });
        let Ok((again, found)) = looked.await else { return };
        followed = again;
        let Some(engine) = engine.upgrade() else { return };
        match found {
            Ok(None) => {}
            Ok(Some(news)) => {
                followed.generation = news.generation;
                apply(&engine, &mut followed.contents, news);
            }
            // It may be gone for a moment, or for good: what is there is kept.
            Err(error) => debug!(error = &error as &dyn Error, "catalog not read"),
        }
    }
}

/// Shows what has changed, in one step.
pub(crate) fn apply(engine: &Engine, shown: &mut Contents, news: News) {
    let News { generation, contents, newcomers, problems, .. } = news;
    for problem in &problems {
        debug!(error = problem as &dyn Error, "dataset left out");
    }
    if newcomers.is_empty() && *shown == contents {
        return;
    }
    let stays = |name: &str| shown.get(name) == contents.get(name);
    engine.change(|info| !stays(&info.name), newcomers);
    debug!(generation, "catalog changed");
    *shown = contents;
}

/// What has changed, if something has.
fn look(followed: &Followed) -> Result<Option<News>, CacheError> {
    let Followed { folder, generation, contents } = followed;
    let newest = Catalog::newest_generation(folder)?;
    if newest.is_none_or(|newest| newest <= *generation) {
        return Ok(None);
    }
    match news(folder, contents, |_, _| {}) {
        Err(CacheError::Catalog(CatalogError::NotACatalog { .. })) => Ok(None),
        news => news.map(Some),
    }
}

/// Follows on the engine's threads, and lets go of it when the last of its users does.
pub(crate) fn start(engine: &Arc<Engine>, followed: Followed) {
    engine.handle().spawn(follow(Arc::downgrade(engine), followed));
}
