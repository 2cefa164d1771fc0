//! The pixel whose cell holds a texel's center, and its validity.

use areoid_formats::lanes;

use super::super::tile::Coords;
use super::super::window::{View, Window};
use super::{Sampled, taps};

/// Copies pixels.
///
/// # Panics
///
/// If one lies outside the view.
pub(super) fn nearest(u: &[f64], v: &[f64], view: View<'_>, out: &mut Vec<f32>) {
    out.clear();
    taps::nearest(u, v, view, |pixels| {
        out.extend(pixels.iter().map(|&pixel| view.data[pixel as usize]));
    });
}

/// Says which texels are valid; of colors the alpha between pixels, at least 1 where valid.
pub(super) fn mask(coords: &Coords, window: &Window, out: &mut Sampled) {
    let Some(alpha) = window.alpha() else {
        out.alpha = None;
        return;
    };
    let view = window.view(0);
    let mask = out.alpha.get_or_insert_default();
    mask.clear();
    taps::nearest(&coords.u, &coords.v, view, |pixels| {
        mask.extend(pixels.iter().map(|&pixel| alpha[pixel as usize]));
    });
    if window.channels() > 1 {
        let places = coords.u.iter().zip(&coords.v);
        for (alpha_here, (&u, &v)) in mask.iter_mut().zip(places).filter(|(here, _)| **here != 0) {
            *alpha_here = between(u, v, view, alpha);
        }
    }
    if lanes::none(mask, |alpha| alpha != u8::MAX) {
        out.alpha = None;
    }
}

/// Bilinear alpha at a valid texel.
fn between(u: f64, v: f64, view: View<'_>, alpha: &[u8]) -> u8 {
    let (left, top) = (u.floor(), v.floor());
    let (right, down) = (u - left, v - top);
    let at = view.index(left, top);
    let row = |at: usize| {
        let [a, b] = [alpha[at], alpha[at + 1]].map(f64::from);
        a + (b - a) * right
    };
    let (upper, lower) = (row(at), row(at + view.stride));
    let alpha = (upper + (lower - upper) * down).round_ties_even();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 255")]
    let alpha = alpha.max(1.0) as u8;
    alpha
}
