#![doc = include_str!("../../FORMAT.md")]

mod audit;
mod bytes;
mod description;
mod entry;
mod error;
pub mod index;
pub mod layout;
mod reader;
pub mod record;
pub mod recover;
mod tail;
mod writer;

pub use audit::record_range;
pub use description::{
    Description, LevelSummary, MipRule, Resampling, Source, SourceFile, Summary,
};
pub use entry::{ConstantTexel, ENTRY_LEN, PageEntry, Payload, payload_checksum};
pub use error::ArchiveError;
pub use reader::{Archive, decode_page};
pub use recover::Unfinished;
pub use writer::{ArchiveWriter, Written};
