//! Which pages the GPU holds, and how a shader finds them; slots and table need no GPU.

pub(crate) mod slots;

pub(crate) mod table;

pub(crate) mod uploads;

pub(crate) mod texture;
