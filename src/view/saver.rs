//! Files of a window, written one after the other on a thread of their own.

use std::path::Path;
use std::sync::mpsc::{self, Receiver, Sender, SyncSender, TrySendError};
use std::thread::{self, JoinHandle};

use areoid_viewer::window::Content;

use crate::output;
use crate::shot::png;

/// Files that wait for their turn; one more is refused.
const WAITING: usize = 4;

/// Names that are tried for a new file.
const MOST_FILES: u32 = 10_000;

type Saved = Result<String, String>;

/// See the module. Dropped, it waits for the files that it was given.
#[derive(Debug)]
pub(super) struct Saver {
    /// `None` where there is no thread, or no more.
    given: Option<SyncSender<(String, Content)>>,
    written: Receiver<Saved>,
    /// Says what cannot be given.
    refuses: Sender<Saved>,
    thread: Option<JoinHandle<()>>,
}

impl Saver {
    pub(super) fn new() -> Self {
        let (given, taken) = mpsc::sync_channel::<(String, Content)>(WAITING);
        let (says, written) = mpsc::channel();
        let refuses = says.clone();
        let thread = thread::Builder::new().name("files".to_owned()).spawn(move || {
            for (stem, content) in taken {
                // Whoever gave it may be gone: it is written all the same.
                let _ = says.send(write(&stem, content));
            }
        });
        Self { given: thread.is_ok().then_some(given), written, refuses, thread: thread.ok() }
    }

    /// Begins to write a new file whose name begins with `stem`.
    pub(super) fn save(&mut self, stem: &str, content: Content) {
        let given = self.given.as_ref().map(|given| given.try_send((stem.to_owned(), content)));
        let reason = match given {
            Some(Ok(())) => return,
            Some(Err(TrySendError::Full(_))) => "too many files are waiting to be written",
            Some(Err(TrySendError::Disconnected(_))) | None => "nobody writes files any more",
        };
        // The other end is its own.
        let _ = self.refuses.send(Err(reason.to_owned()));
    }

    /// What became of a file; of each once.
    pub(super) fn saved(&mut self) -> Option<Saved> {
        self.written.try_recv().ok()
    }
}

impl Drop for Saver {
    fn drop(&mut self) {
        self.given = None;
        if let Some(thread) = self.thread.take() {
            // Had it panicked, that would have been said.
            let _ = thread.join();
        }
        for reason in self.written.try_iter().filter_map(Result::err) {
            output::say(format_args!("error: {reason}"));
        }
    }
}

fn write(stem: &str, content: Content) -> Saved {
    let (extension, bytes) = match content {
        Content::Json(text) => ("json", text.into_bytes()),
        Content::Picture(picture) => ("png", png(picture).map_err(|error| error.to_string())?),
    };
    let mut names = (1..MOST_FILES).map(|number| format!("{stem}-{number:04}.{extension}"));
    let name = names.find(|name| !Path::new(name).exists());
    let name = name.ok_or_else(|| format!("there are too many files called {stem}"))?;
    output::write_file(Path::new(&name), &bytes).map_err(|failure| failure.in_full())?;
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_was_given_is_written_each_to_a_file_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let stem = folder.path().join("flight").to_str().unwrap().to_owned();
        let mut saver = Saver::new();
        for text in ["a", "b"] {
            saver.save(&stem, Content::Json(text.to_owned()));
        }
        saver.save(&format!("{stem}/nowhere"), Content::Json("c".to_owned()));
        let mut said = Vec::new();
        while said.len() < 3 {
            said.extend(saver.saved());
        }
        assert_eq!(said[1], Ok(format!("{stem}-0002.json")));
        assert!(said[2].as_ref().unwrap_err().contains("nowhere"), "{said:?}");
        saver.save(&stem, Content::Json("d".to_owned()));
        drop(saver);
        let read = |number| std::fs::read_to_string(format!("{stem}-000{number}.json")).unwrap();
        assert_eq!([1, 2, 3].map(read), ["a", "b", "d"]);
    }
}
