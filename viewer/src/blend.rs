//! How far a page of heights shows over the coarser one beneath it: the twin of `shader/blend.wgsl`,
//! which says why.

use areoid_cache::View;
use glam::DVec3;

use crate::camera::pixel_angle;

/// Where errors are looked at from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Vantage {
    eye: DVec3,
    backward: DVec3,
    /// Of the tolerance, at the center of the picture.
    angle: f64,
    pub(crate) exaggeration: f64,
    pub(crate) tolerance_px: f64,
}

impl Vantage {
    pub(crate) fn new(view: &View, exaggeration: f64) -> Self {
        let tolerance_px = view.tolerance_px;
        let angle = pixel_angle(view) * tolerance_px;
        Self { eye: view.eye, backward: view.orientation.z_axis, angle, exaggeration, tolerance_px }
    }

    /// Meters of height at a place that show as large as the tolerance across the line of sight; exaggerated,
    /// where that makes them larger.
    pub(crate) fn tolerance_m_at(&self, place: DVec3) -> f64 {
        let position = place - self.eye;
        let along = self.backward.dot(position);
        let tolerance_m = along * along / position.length().max(1e-6) * self.angle;
        (tolerance_m / self.exaggeration.max(1.0)).max(1e-9)
    }
}

/// The share of the finer of two pages, by the errors of both in tolerances.
pub(crate) fn share_of_finer(coarser: f64, finer: f64) -> f64 {
    if coarser <= 1.0 {
        return 0.0;
    }
    let gradual = (coarser - 1.0) / (View::BLENDED - 1.0);
    let needed = (coarser - 1.0) / (coarser - finer).max(1e-6);
    gradual.max(needed).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Down a lineage whose errors grow from page to page, the finest within the tolerance.
        #[test]
        fn blends_are_within_the_tolerance(
            finest in 0.0..1.0_f64,
            growth in prop::collection::vec(1.0..3.0_f64, 1..8),
        ) {
            let (mut error, mut own) = (finest, finest);
            for factor in growth {
                own *= factor;
                error = own + (error - own) * share_of_finer(own, error);
                prop_assert!(error <= 1.0 + 1e-9, "{error}");
            }
        }

        /// What is beneath is not needed where its error is large, and is all there is where it is small.
        #[test]
        fn shares_go_from_none_to_all(finer in 0.0..1.0_f64, coarser in 0.0..4.0_f64) {
            let share = share_of_finer(coarser.max(finer), finer);
            prop_assert_eq!(share == 0.0, coarser.max(finer) <= 1.0);
            prop_assert!(coarser < View::BLENDED || share == 1.0);
        }
    }
}
