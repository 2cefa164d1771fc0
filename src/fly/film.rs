//! Pictures of frames in a folder that appears with the last of them.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use areoid_viewer::Image;

use crate::failure::Failure;
use crate::shot::png;

/// Pictures on their way to the disk. A thread of its own writes them; if it is behind by some, the
/// next waits.
#[derive(Debug)]
pub(super) struct Film {
    folder: PathBuf,
    /// Beside it, until all are there.
    unfinished: PathBuf,
    pictures: Option<SyncSender<(u32, Image)>>,
    writer: Option<JoinHandle<io::Result<()>>>,
}

/// Pictures that may wait for the disk.
const BEHIND: usize = 4;

impl Film {
    /// A film of so many frames.
    ///
    /// # Errors
    ///
    /// If there is something in the folder, unless it is a film and `replaces`.
    pub(super) fn begin(folder: &Path, frames: u32, replaces: bool) -> Result<Self, Failure> {
        let shown = folder.display();
        let Some(name) = folder.file_name() else {
            return Err(Failure::Misused(format!("{shown} names no folder to be made")));
        };
        match what_is_in(folder)? {
            Content::Film if !replaces => {
                let reason = format!("{shown} holds a film: --force replaces it");
                return Err(io::Error::other(reason).into());
            }
            Content::Else => {
                let reason = format!("{shown} exists and is no film, nor an empty folder");
                return Err(io::Error::other(reason).into());
            }
            Content::Film | Content::Nothing => {}
        }
        let mut hidden = name.to_owned();
        hidden.push(format!(".{}.tmp", std::process::id()));
        let unfinished = folder.with_file_name(hidden);
        fs::create_dir(&unfinished).map_err(|error| {
            io::Error::new(error.kind(), format!("cannot write {shown}: {error}"))
        })?;
        let (pictures, given) = sync_channel::<(u32, Image)>(BEHIND);
        let digits = (frames - 1).to_string().len().max(5);
        let target = unfinished.clone();
        let write = move || {
            for (number, picture) in given {
                let path = target.join(format!("frame-{number:0digits$}.png"));
                fs::write(path, png(picture).map_err(io::Error::other)?)?;
            }
            Ok(())
        };
        let folder = folder.to_owned();
        let mut film = Self { folder, unfinished, pictures: Some(pictures), writer: None };
        film.writer = Some(std::thread::Builder::new().name("film".to_owned()).spawn(write)?);
        Ok(film)
    }

    /// Takes a picture in.
    pub(super) fn add(&mut self, number: u32, picture: Image) -> Result<(), Failure> {
        let given = self.pictures.as_ref().is_some_and(|to| to.send((number, picture)).is_ok());
        // Whoever takes no more has failed, and says why.
        if given { Ok(()) } else { self.written() }
    }

    /// Waits until all pictures are written, and puts the folder in its place.
    pub(super) fn finish(mut self) -> Result<(), Failure> {
        self.written()?;
        let mut name = self.unfinished.file_name().unwrap_or_default().to_owned();
        name.push(".old");
        let old = self.folder.with_file_name(name);
        let replaced = match fs::rename(&self.folder, &old) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => false,
            other => other.map(|()| true)?,
        };
        fs::rename(&self.unfinished, &self.folder)?;
        if replaced {
            fs::remove_dir_all(old)?;
        }
        Ok(())
    }

    fn written(&mut self) -> Result<(), Failure> {
        self.pictures = None;
        let written = self.writer.take().map(JoinHandle::join);
        written.unwrap_or(Ok(Ok(()))).unwrap_or_else(|_| {
            Err(io::Error::other("the thread that writes pictures has panicked"))
        })?;
        Ok(())
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        // After an error, which says more; after the end there is nothing.
        let _ = self.written();
        let _ = fs::remove_dir_all(&self.unfinished);
    }
}

enum Content {
    /// No folder, or an empty one.
    Nothing,
    /// Pictures of frames alone.
    Film,
    Else,
}

fn what_is_in(folder: &Path) -> io::Result<Content> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Content::Nothing),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => return Ok(Content::Else),
        other => other?,
    };
    let mut content = Content::Nothing;
    for entry in entries {
        let name = entry?.file_name();
        let number =
            name.to_str().and_then(|name| name.strip_prefix("frame-")?.strip_suffix(".png"));
        if !number.is_some_and(|number| number.bytes().all(|digit| digit.is_ascii_digit())) {
            return Ok(Content::Else);
        }
        content = Content::Film;
    }
    Ok(content)
}
