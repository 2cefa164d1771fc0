//! The laws of the design, each held against an oracle that shares no code with what it tests.

#![expect(clippy::unwrap_used, reason = "a failed test may panic")]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "made-up rasters are small, and their values are chosen"
)]

mod support;

mod laws {
    mod analytic;
    mod bytes;
    mod lowpass;
    mod nodata;
    mod normals;
    mod pages;
    mod planets;
    mod registration;
    mod resampled;
    mod shapes;
    mod split;
    mod truth;
    mod verification;
}
