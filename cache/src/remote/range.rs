//! Ranges of an archive on a server, retried, in bounded time.

use std::io::{self, Read as _};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use super::client::{ANSWER, Client};
use super::link::is_nobody;
use crate::locks::lock;

/// How often a read is tried, with waits of 0.1, 0.2 and 0.4 s between.
const TRIES: u32 = 4;
const FIRST_WAIT: Duration = Duration::from_millis(100);
/// No try begins so late.
const PATIENCE: Duration = ANSWER;
/// How often it is asked whether an answer is still wanted.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How long an archive that the server did not have is not asked for.
const MISSING: Duration = Duration::from_secs(30);

/// An archive on a server.
///
/// # Threads
///
/// Any number may read at once. A read takes at most three times the client's time-outs.
#[derive(Debug)]
pub(super) struct Ranges {
    client: Client,
    url: String,
    content: String,
    /// That the server does not have it, until when that is believed.
    missing: Mutex<Option<(Instant, String)>>,
}

/// Why a try failed.
enum Trouble {
    /// Nobody is there.
    Nobody(io::Error),
    /// It may go well the next time.
    Passing(io::Error),
    /// The server says no.
    Refused(io::Error),
    /// The server has no such archive.
    Missing(io::Error),
    /// Nobody waits for it any more.
    Unwanted,
}

/// A read that was given up because nobody waits for it.
#[derive(Debug, thiserror::Error)]
#[error("it was given up")]
struct GivenUp;

pub(super) fn given_up() -> io::Error {
    io::Error::other(GivenUp)
}

/// Whether a read was given up.
pub(super) fn is_given_up(error: &io::Error) -> bool {
    error.get_ref().is_some_and(|error| error.is::<GivenUp>())
}

impl Ranges {
    /// The archive `file` of a content. Asks nothing yet.
    pub(super) fn new(client: Client, file: &str, content: &str) -> Self {
        let url = client.url(&format!("/v1/archives/{file}"));
        Self { client, url, content: content.to_owned(), missing: Mutex::default() }
    }

    pub(super) fn url(&self) -> &str {
        &self.url
    }

    /// Fills `buffer`, which is not empty, from `start`, for as long as it `is_wanted`: that is asked before
    /// each try, and as bytes come.
    ///
    /// # Errors
    ///
    /// [`io::ErrorKind::NotFound`] if the server has the archive no more,
    /// [`io::ErrorKind::NotConnected`] if it could not be reached a moment ago, one that [`is_given_up`] if
    /// it is not wanted any more; or what went wrong at the last try.
    pub(super) fn read(
        &self,
        buffer: &mut [u8],
        start: u64,
        is_wanted: &dyn Fn() -> bool,
    ) -> io::Result<()> {
        let missing = lock(&self.missing).clone();
        if let Some((until, reason)) = missing
            && Instant::now() < until
        {
            return Err(io::Error::new(io::ErrorKind::NotFound, reason));
        }
        let link = self.client.link();
        if let Some(reason) = link.silence() {
            return Err(io::Error::new(io::ErrorKind::NotConnected, reason));
        }
        // One try shows whether somebody is back.
        let tries = if link.is_lost() { 1 } else { TRIES };
        let (begin, mut wait) = (Instant::now(), FIRST_WAIT);
        let in_words =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", self.url));
        for attempt in 1.. {
            if !is_wanted() {
                return Err(given_up());
            }
            let is_last = attempt >= tries || begin.elapsed() >= PATIENCE;
            match self.attempt(buffer, start, is_wanted) {
                Ok(()) => return Ok(()),
                // Whoever tries no more tells the others.
                Err(Trouble::Nobody(error)) if is_last || !is_wanted() => {
                    let error = in_words(error);
                    link.lose(&error.to_string());
                    return Err(error);
                }
                Err(Trouble::Passing(error)) if is_last => return Err(in_words(error)),
                Err(Trouble::Refused(error)) => return Err(in_words(error)),
                Err(Trouble::Unwanted) => return Err(given_up()),
                Err(Trouble::Missing(error)) => {
                    let error = in_words(error);
                    let believed = Some((Instant::now() + MISSING, error.to_string()));
                    *lock(&self.missing) = believed;
                    return Err(error);
                }
                Err(Trouble::Nobody(_) | Trouble::Passing(_)) => thread::sleep(wait),
            }
            wait *= 2;
        }
        unreachable!("the last try returns")
    }

    fn attempt(
        &self,
        buffer: &mut [u8],
        start: u64,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<(), Trouble> {
        let sort = |error: ureq::Error| match is_nobody(&error) {
            true => Trouble::Nobody(error.into_io()),
            false => Trouble::Passing(error.into_io()),
        };
        let last = start + buffer.len() as u64 - 1;
        let asked = self.client.agent().get(&self.url);
        let answer = asked.header("range", format!("bytes={start}-{last}")).call().map_err(sort)?;
        self.client.link().find();
        let status = answer.status().as_u16();
        let refusal = || io::Error::other(format!("the server answers {status}"));
        match status {
            206 => {}
            404 | 410 => {
                let error = io::Error::new(io::ErrorKind::NotFound, "the server has it no more");
                return Err(Trouble::Missing(error));
            }
            408 | 429 | 500.. => return Err(Trouble::Passing(refusal())),
            _ => return Err(Trouble::Refused(refusal())),
        }
        let tag = answer.headers().get("etag").and_then(|tag| tag.to_str().ok());
        if tag.map(|tag| tag.trim_matches('"')) != Some(self.content.as_str()) {
            let error = io::Error::new(io::ErrorKind::InvalidData, "another archive answers");
            return Err(Trouble::Missing(error));
        }
        let mut body = answer.into_body().into_reader();
        let passing = |error: io::Error| match ureq::Error::from(error) {
            error @ ureq::Error::Timeout(_) => sort(error),
            error => Trouble::Passing(error.into_io()),
        };
        let (mut done, mut looked) = (0, Instant::now());
        while done < buffer.len() {
            if looked.elapsed() >= LOOK_EVERY {
                looked = Instant::now();
                if !is_wanted() {
                    return Err(Trouble::Unwanted);
                }
            }
            match body.read(&mut buffer[done..]).map_err(passing)? {
                0 => return Err(Trouble::Passing(io::ErrorKind::UnexpectedEof.into())),
                count => done += count,
            }
        }
        // A connection is kept when the end of its answer was seen.
        match body.read(&mut [0]).map_err(passing)? {
            0 => Ok(()),
            _ => Err(Trouble::Passing(io::Error::new(
                io::ErrorKind::InvalidData,
                "the answer is longer than what was asked for",
            ))),
        }
    }
}
