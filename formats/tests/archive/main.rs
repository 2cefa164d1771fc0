//! Archives as a whole: written, cut short, damaged, forged.

#![expect(
    clippy::cast_possible_truncation,
    clippy::unwrap_used,
    reason = "tests: archives are small, and a panic is a failure"
)]

mod cut;
mod damage;
mod format;
mod hostile;
mod lookup;
mod round_trip;
mod small;
