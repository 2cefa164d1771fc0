//! What a cache has done so far.

/// Counts since the cache was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Stats {
    /// Pages read and decoded.
    pub loads: u64,
    /// Bytes of theirs as they are stored.
    pub loaded_bytes: u64,
    /// Blocks of an index asked for.
    pub index_loads: u64,
    /// Wanted pages that were in memory, summed over updates.
    pub hits: u64,
    /// Wanted pages that were not, summed over updates.
    pub misses: u64,
    /// Pages that a view wanted and the one before it did not, summed over updates.
    pub first_wanted: u64,
    /// Those of them that were in memory already.
    pub first_resident: u64,
    /// Pages dropped to make room.
    pub evictions: u64,
    /// Loads given up because no view wanted them any more.
    pub cancelled: u64,
    /// Loads that failed.
    pub errors: u64,
    /// Pages loaded before a view wanted them.
    pub ahead: u64,
    /// Those of them that a view has wanted since.
    pub ahead_used: u64,
    /// Those of them that were dropped before.
    pub ahead_wasted: u64,
    /// Pages whose bytes a medium was told to bring nearer.
    pub advised: u64,
    /// Those of them that have been loaded since.
    pub advised_used: u64,
    /// What searches looked at.
    pub visited: u64,
    /// Updates that found the store in use and repeated the last selection.
    pub repeated: u64,
    /// Pages in memory.
    pub pages: usize,
    /// Their bytes.
    pub bytes: usize,
    /// Bytes reserved for loads under way.
    pub reserved_bytes: usize,
    /// The most that both have been together.
    pub peak_bytes: usize,
    /// What they may be.
    pub budget_bytes: usize,
}
