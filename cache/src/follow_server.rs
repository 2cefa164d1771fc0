//! Keeps a cache at what a server serves, over restarts and outages.
//!
//! ```text
//!   connect to the events ──▶ ask for the catalog ──▶ apply ──▶ wait ──▶ an event ──▶ ask …
//!      ▲ later and later                                         │
//!      └──────────── the stream ends, or a load finds nobody ◀───┘
//! ```
//!
//! Nothing of an event is believed but that it came. After every connection the catalog is asked for,
//! so that what happened before is known, too, and what failed to load meanwhile is tried again.

use std::collections::hash_map::RandomState;
use std::error::Error;
use std::hash::{BuildHasher as _, Hasher as _};
use std::sync::{Arc, Weak};
use std::time::Duration;

use areoid_formats::body::Body;
use tokio::sync::watch;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep, timeout};
use tracing::debug;

use crate::engine::Engine;
use crate::follow::apply;
use crate::open::{CacheError, Contents, News, news_afar};
use crate::place::Connection;
use crate::remote::{Events, RemoteError};

/// A server, and what of it the cache has.
pub(crate) struct FollowedServer {
    pub(crate) connection: Connection,
    /// What all datasets have to show.
    pub(crate) body: Body,
    pub(crate) contents: Contents,
    /// That of the list, if all of it is in the contents.
    pub(crate) tag: Option<String>,
}

/// Waits between connections: they double, but begin anew after one that held.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const LAST_WAIT: Duration = Duration::from_secs(8);
const HELD: Duration = Duration::from_secs(30);
/// Events so close to one another are one.
const TOGETHER: Duration = Duration::from_millis(30);
/// A stream of events is asked about no more often than that.
const MOST_TOGETHER: u32 = 10;
/// After which time datasets that could not be opened are tried again.
const AGAIN: Duration = Duration::from_secs(30);

/// What becomes of a question.
struct Asked {
    followed: FollowedServer,
    result: Result<Option<News>, CacheError>,
}

/// Follows on the engine's threads, and lets go of it when the last of its users does.
pub(crate) fn start(engine: &Arc<Engine>, followed: FollowedServer) {
    engine.handle().spawn(follow(Arc::downgrade(engine), followed));
}

/// Follows for as long as the engine lives.
///
/// # Cancel safety
///
/// Dropped at any time, it changes nothing by halves.
async fn follow(engine: Weak<Engine>, mut followed: FollowedServer) {
    let client = followed.connection.client.clone();
    let mut losses = client.link().losses();
    let mut wait = FIRST_WAIT;
    loop {
        let begin = Instant::now();
        losses.mark_unchanged();
        let connected = Events::connect(&client).await;
        let is_refused = matches!(connected, Err(RemoteError::Refused { .. }));
        let error: CacheError = match connected {
            Ok(events) => {
                let (again, error) = listen(&engine, followed, events, &mut losses).await;
                let Some(again) = again else { return };
                followed = again;
                error
            }
            // Whoever has no events may still have a catalog.
            Err(error) if is_refused => {
                let Some(again) = refresh(&engine, followed, true).await else { return };
                followed = again.0;
                again.1.err().unwrap_or_else(|| error.into())
            }
            Err(error) => error.into(),
        };
        if engine.strong_count() == 0 {
            return;
        }
        debug!(error = &error as &dyn Error, "server not heard");
        if begin.elapsed() >= HELD {
            wait = FIRST_WAIT;
        }
        sleep(scattered(wait)).await;
        wait = (wait * 2).min(LAST_WAIT);
    }
}

/// Follows while the stream lasts; nothing is followed any more without an engine.
async fn listen(
    engine: &Weak<Engine>,
    mut followed: FollowedServer,
    mut events: Events,
    losses: &mut watch::Receiver<u64>,
) -> (Option<FollowedServer>, CacheError) {
    // The server says hello: from there on it tells of everything.
    if let Err(error) = events.next().await {
        return (Some(followed), error.into());
    }
    let mut is_first = true;
    loop {
        let Some((again, result)) = refresh(engine, followed, is_first).await else {
            return (None, CacheError::GivenUp);
        };
        followed = again;
        is_first = false;
        if let Err(error) = result {
            return (Some(followed), error);
        }
        let is_whole = followed.tag.is_some();
        tokio::select! {
            event = events.next() => if let Err(error) = event {
                return (Some(followed), error.into());
            },
            _ = losses.changed() => {
                let url = followed.connection.client.address().to_owned();
                let source = std::io::ErrorKind::NotConnected.into();
                return (Some(followed), RemoteError::Network { url, source }.into());
            }
            () = sleep(AGAIN), if !is_whole => {}
        }
        for _ in 0..MOST_TOGETHER {
            match timeout(TOGETHER, events.next()).await {
                Ok(Ok(())) => {}
                // The next wait for an event hears of it, too.
                Ok(Err(_)) | Err(_) => break,
            }
        }
    }
}

/// Asks for the catalog and applies what has changed; after a connection, what failed to load is tried
/// again. `None` if there is no engine any more.
async fn refresh(
    engine: &Weak<Engine>,
    followed: FollowedServer,
    is_first: bool,
) -> Option<(FollowedServer, Result<(), CacheError>)> {
    let asked = spawn_blocking(move || ask(followed)).await;
    let Asked { mut followed, result } = asked.ok()?;
    let engine = engine.upgrade()?;
    let result = result.map(|news| {
        if let Some(news) = news {
            apply(&engine, &mut followed.contents, news);
        }
        if is_first {
            engine.forgive();
        }
    });
    Some((followed, result))
}

fn ask(mut followed: FollowedServer) -> Asked {
    let FollowedServer { connection, body, contents, tag } = &mut followed;
    let result = match news_afar(connection, contents, tag.as_deref(), |_, _| {}) {
        Ok(Some((news, _))) if news.body != *body => {
            let url = connection.client.address().to_owned();
            let reason = format!("it shows {}, and not {} any more", news.body.name, body.name);
            Err(RemoteError::Answer { url, reason }.into())
        }
        Ok(Some((news, newest))) => {
            // The server says when it can read what it could not.
            let is_final = |problem: &CacheError| {
                matches!(problem, CacheError::Remote(RemoteError::Unreadable { .. }))
            };
            *tag = newest.filter(|_| news.problems.iter().all(is_final));
            Ok(Some(news))
        }
        Ok(None) => Ok(None),
        Err(error) => Err(error),
    };
    Asked { followed, result }
}

/// A wait up to half as long again, so that not all come back at once.
fn scattered(wait: Duration) -> Duration {
    let chance = RandomState::new().build_hasher().finish() % 1024;
    wait + wait * u32::try_from(chance).unwrap_or(0) / 2048
}
