//! Normals as texels: how far the ground is turned from the reference surface, in three codes.
//!
//! ```text
//!        n ↖  ↑ n_ref      a texel is d = n − n_ref, body-fixed x, y and z:
//!           \ |            code = 128 + round(127 d), within 1 to 255; 0 is no data
//!      ______\|______
//! ```
//!
//! Both normals are units in body-fixed axes: `n` that of the ground, `n_ref` that of the reference
//! ellipsoid at the same place. There is no frame of east and north that would turn around a pole or
//! jump at the antimeridian, so codes can be averaged and interpolated like colors, without a curve of
//! light; level ground is (128, 128, 128) everywhere.
//!
//! # Precision
//!
//! Half a code is 1/254 in each component, at most 0.4° in all. A component of `d` beyond ±1 is
//! clamped: as |d| = 2 sin(θ/2), that takes ground steeper than θ = 60°.

use glam::DVec3;

/// What a code is worth: the codes of a component of 1 above that of 0.
const CODES_PER_UNIT: f64 = 127.0;

/// The code of a component of 0.
const LEVEL: f64 = 128.0;

/// The codes of a unit normal `normal` where the reference surface has `reference`, before they are
/// rounded to whole ones and clamped.
#[must_use]
pub fn exact_codes(normal: DVec3, reference: DVec3) -> [f64; 3] {
    (normal - reference).to_array().map(|component| LEVEL + CODES_PER_UNIT * component)
}

/// The codes that stand for [`exact_codes`]: whole, ties to even, and within 1 to 255.
#[must_use]
pub fn codes(exact: [f64; 3]) -> [u8; 3] {
    exact.map(|code| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let code = code.round_ties_even().clamp(1.0, 255.0) as u8;
        code
    })
}

/// The unit normal that codes, whole or interpolated between texels, say where the reference surface
/// has the unit normal `reference`: what a viewer lights.
///
/// # Precision
///
/// 0.5° from what was written, for ground of up to 60°; the reference itself where the codes cancel it.
#[must_use]
pub fn normal_from_codes(codes: [f64; 3], reference: DVec3) -> DVec3 {
    let turned = DVec3::from_array(codes.map(|code| (code - LEVEL) / CODES_PER_UNIT));
    (reference + turned).try_normalize().unwrap_or(reference)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn level_ground_is_one_code_everywhere() {
        for reference in [DVec3::X, -DVec3::Z, DVec3::new(0.6, -0.8, 0.0)] {
            assert_eq!(codes(exact_codes(reference, reference)), [128; 3]);
            assert_eq!(normal_from_codes([128.0; 3], reference), reference);
        }
    }

    #[test]
    fn codes_are_clamped_and_never_no_data() {
        assert_eq!(codes(exact_codes(DVec3::X, -DVec3::X)), [255, 128, 128]);
        assert_eq!(codes(exact_codes(-DVec3::X, DVec3::X)), [1, 128, 128]);
    }

    /// The angle between unit vectors, well-conditioned where they are near.
    fn angle(one: DVec3, other: DVec3) -> f64 {
        2.0 * ((one - other).length() / 2.0).asin()
    }

    proptest! {
        #[test]
        fn ground_of_up_to_60_degrees_comes_back(
            z in -1.0..1.0_f64, longitude in -4.0..4.0_f64, slope in 0.0..60.0_f64, toward in 0.0..7.0_f64,
        ) {
            let ring = (1.0 - z * z).sqrt();
            let reference = DVec3::new(ring * longitude.cos(), ring * longitude.sin(), z);
            let across = reference.any_orthonormal_vector();
            let along = reference.cross(across);
            let (sin, cos) = slope.to_radians().sin_cos();
            let normal = cos * reference + sin * (toward.cos() * across + toward.sin() * along);
            let stored = codes(exact_codes(normal, reference)).map(f64::from);
            let off = angle(normal_from_codes(stored, reference), normal);
            // Half a code in three components is a distance of √3/254 before the length is set right.
            prop_assert!(off <= 0.5_f64.to_radians(), "{}", off.to_degrees());
        }
    }
}
