//! The laws of the design, each held against an oracle that shares no code with what it tests.

mod support;

mod laws {
    mod pages;
}
