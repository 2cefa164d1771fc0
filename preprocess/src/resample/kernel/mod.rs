//! Kernels: what a texel is of the pixels around its place in the source.
//!
//! | kernel | taps | ns | RMS error, % of a wave of 273 | 16 | 8 | 4 | 2.5 pixels |
//! |---|---|---|---|---|---|---|---|
//! | nearest | 1 | 2.1 | | | | | |
//! | bilinear | 2² | 3.0 | .0047 | 1.37 | 5.4 | 20.5 | 46.9 |
//! | cubic (Keys, -1/2) | 4² | 6.3 | .00001 | .061 | .60 | 6.7 | 30.9 |
//! | Lanczos-3, plain | 6² | 10.6 | .033 | .46 | .58 | 2.01 | 15.4 |
//! | Lanczos-3, exact for ramps | 6² | 10.6 | .0002 | .059 | .39 | 1.94 | 15.5 |
//! | cubic spline | 4² | 6.5 | .00001 | .0030 | .055 | 1.32 | 15.8 |
//! | quintic spline | 6² | 9.8 | .00002 | .00003 | .0009 | .12 | 6.5 |
//! | average | 2² or more | 17.6 | | | | | |
//!
//! (Processor time a texel on one core of a Xeon with AVX-512, November 2026; the window costs 1 ns
//! more, the preparation 3 ns a pixel, 6 and 8 for the splines.)
//!
//! Splines sum coefficients, which [`super::prepare`] makes of the pixels. Where texels are farther
//! apart than the source's detail, kernels are stretched (`stretched.rs`).
//!
//! All kernels keep constants to the bit, also where the source is constant only around a texel.

mod area;
mod nearest;
mod stretched;
mod taps;
mod weights;
mod wide;

use super::prepare::Filter;
use super::tile::{Coords, Footprint};
use super::window::{View, Window};
use crate::texel;

/// A way to make texels of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// The pixel whose cell holds the texel's center.
    Nearest,
    /// Linear along both axes.
    Bilinear,
    /// Keys' cubic with a = -1/2.
    Cubic,
    /// The windowed sinc with three lobes, as others have it.
    PlainLanczos,
    /// The same, made exact for ramps.
    Lanczos,
    /// The interpolating spline of degree 3.
    CubicSpline,
    /// The interpolating spline of degree 5.
    QuinticSpline,
    /// The mean of the texel's footprint.
    Average,
}

/// Whether texels may be beyond the pixels around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RangeLimit {
    /// They may: kernels with negative lobes overshoot.
    #[default]
    None,
    /// They are brought between the least and the greatest pixel with data under the kernel's taps.
    Taps,
}

/// Texels of a tile, row-major with the tile's own columns.
#[derive(Clone, Debug, Default)]
pub struct Sampled {
    /// A plane a channel: meters, or amounts of light. Finite also where nothing is valid.
    pub planes: Vec<Vec<f32>>,
    /// 0 where a texel is invalid; of colors what is between, too. `None` if all are opaque.
    pub alpha: Option<Vec<u8>>,
}

impl Sampled {
    /// Appends the codes of a plane of light.
    ///
    /// # Panics
    ///
    /// If there is no such channel.
    pub fn codes_into(&self, channel: usize, out: &mut Vec<u8>) {
        out.extend(self.planes[channel].iter().map(|&light| texel::code(light)));
    }
}

/// Memory that kernels use again.
#[derive(Debug, Default)]
pub struct Scratch {
    tables: stretched::Tables,
    room: wide::Room,
}

impl Kernel {
    /// Its name in archives.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nearest => "nearest",
            Self::Bilinear => "bilinear",
            Self::Cubic => "cubic",
            Self::PlainLanczos => "plain lanczos",
            Self::Lanczos => "lanczos",
            Self::CubicSpline => "cubic spline",
            Self::QuinticSpline => "quintic spline",
            Self::Average => "average",
        }
    }

    /// What the kernel wants of its taps.
    #[must_use]
    pub fn filter(self) -> Filter {
        match self {
            Self::Nearest | Self::Average => Filter::Pixels { reach: 0 },
            Self::Bilinear => Filter::Pixels { reach: 1 },
            Self::Cubic => Filter::Pixels { reach: 2 },
            Self::PlainLanczos | Self::Lanczos => Filter::Pixels { reach: 3 },
            Self::CubicSpline => Filter::CubicSpline,
            Self::QuinticSpline => Filter::QuinticSpline,
        }
    }

    /// How far the taps of a texel reach along the source's columns and rows: at `u` they are those
    /// from `floor(u) + 1 - reach` to `floor(u) + reach`.
    #[must_use]
    pub fn reach(self, footprint: Footprint) -> [i64; 2] {
        if self == Self::Average {
            return [footprint.texel_u, footprint.texel_v].map(area::reach);
        }
        stretched::stretch(footprint).map(|stretch| stretched::reach(self, stretch))
    }

    /// Half the taps along an axis, unstretched.
    fn pairs(self) -> usize {
        match self {
            Self::Nearest | Self::Bilinear | Self::Average => 1,
            Self::Cubic | Self::CubicSpline => 2,
            Self::PlainLanczos | Self::Lanczos | Self::QuinticSpline => 3,
        }
    }

    /// The texels at `coords`.
    ///
    /// A texel is valid if the pixel is whose cell holds its center; of [`Self::Average`], if half
    /// of its footprint is.
    ///
    /// # Domain
    ///
    /// The window is assembled for the range of `coords` and this kernel's [`Self::reach`], of a
    /// source prepared for its [`Self::filter`].
    ///
    /// # Precision
    ///
    /// f32, relative to the differences of the taps from the one beside the texel: 36 roundings.
    ///
    /// # Panics
    ///
    /// If a tap lies outside the window.
    pub fn sample(
        self,
        limit: RangeLimit,
        coords: &Coords,
        footprint: Footprint,
        window: &Window,
        scratch: &mut Scratch,
        out: &mut Sampled,
    ) {
        out.planes.resize_with(window.channels(), Vec::new);
        if self == Self::Average {
            area::average(coords, footprint, window, scratch, out);
            return;
        }
        let stretch = stretched::stretch(footprint);
        let is_plain = stretch == [1.0; 2] || self == Self::Nearest;
        for (channel, plane) in out.planes.iter_mut().enumerate() {
            plane.resize(coords.u.len(), 0.0);
            let view = window.view(channel);
            if is_plain {
                self.plain(&coords.u, &coords.v, view, plane);
            } else {
                stretched::sample(self, stretch, coords, view, scratch, plane);
            }
            if limit == RangeLimit::Taps {
                let pixels = (window.pixels(channel), window.alpha());
                taps::limit(self.reach(footprint), &coords.u, &coords.v, pixels, plane);
            }
        }
        nearest::mask(coords, window, out);
    }

    fn plain(self, u: &[f64], v: &[f64], view: View<'_>, out: &mut Vec<f32>) {
        match self {
            Self::Nearest | Self::Average => nearest::nearest(u, v, view, out),
            Self::Bilinear => taps::bilinear(u, v, view, out),
            Self::Cubic => taps::separable::<2, 2, 4>(&weights::CUBIC, u, v, view, out),
            Self::PlainLanczos => {
                taps::separable::<3, 5, 8>(&weights::PLAIN_LANCZOS, u, v, view, out);
            }
            Self::Lanczos => taps::separable::<3, 5, 8>(&weights::LANCZOS, u, v, view, out),
            Self::CubicSpline => {
                taps::separable::<2, 2, 4>(&weights::CUBIC_SPLINE, u, v, view, out);
            }
            Self::QuinticSpline => {
                taps::separable::<3, 3, 8>(&weights::QUINTIC_SPLINE, u, v, view, out);
            }
        }
    }
}

#[cfg(test)]
mod tests;
