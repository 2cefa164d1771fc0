//! The normal of the ground from the places around it.
//!
//! With differences x = right − left and y = below − above of body-fixed places, the normal is the
//! direction of x × y. The metric of the grid is in the places: it needs no other word.

use glam::DVec3;

use super::places::Place;

/// What lies on both sides of a place along an axis; nowhere if there is nothing.
pub(super) type Sides = [Place; 2];

/// Along an axis from one side of `here` to the other; `None` if nothing is there, or it does not lie
/// apart.
fn difference([before, after]: Sides, here: Place) -> Option<DVec3> {
    let level = |across: DVec3| across - here.up * across.dot(here.up);
    let difference = match (before.at.is_nan(), after.at.is_nan()) {
        (false, false) => after.at - before.at,
        // From here to there the surface itself leans by half of its turn between the two.
        (true, false) => level(after.at - here.at) + here.up * (after.height_m - here.height_m),
        (false, true) => level(here.at - before.at) + here.up * (here.height_m - before.height_m),
        (true, true) => return None,
    };
    // Closer together than their rounding errors, places tell nothing: a row on a pole is one place.
    (level(difference).length() > 1e-13 * here.at.length()).then_some(difference)
}

/// The unit normal at `here`, with what lies along two axes beside it; along an axis that tells nothing
/// the ground is level.
pub(super) fn normal(here: Place, sides: [Sides; 2]) -> DVec3 {
    let up = here.up;
    // What is perpendicular to an axis and as near to `up` as that allows.
    let level_across = |axis: DVec3| axis.cross(up.cross(axis));
    let normal = match sides.map(|sides| difference(sides, here)) {
        [Some(x), Some(y)] => {
            let normal = x.cross(y);
            // Of a map two columns wide both axes are one at a pole.
            let is_one = normal.length() <= 1e-10 * x.length() * y.length();
            if is_one { level_across(y) } else { normal }
        }
        [Some(axis), None] | [None, Some(axis)] => level_across(axis),
        [None, None] => up,
    };
    let outward = if normal.dot(up) < 0.0 { -normal } else { normal };
    outward.try_normalize().unwrap_or(up)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOTHING: Place = Place::NOWHERE;

    /// On a surface that is flat.
    fn place(x: f64, y: f64, z: f64) -> Place {
        Place { at: DVec3::new(x, y, z), up: DVec3::Z, height_m: z }
    }

    fn close(one: DVec3, other: DVec3) -> bool {
        (one - other).length() < 1e-9
    }

    proptest! {
        /// Whatever the axes, which sides are there, and which way each goes.
        #[test]
        fn a_plane_has_one_normal(
            tilt in prop::array::uniform2(-1.5..1.5_f64), turn in 0.1..3.0_f64, flip: bool,
            lengths in prop::array::uniform4(0.1..9.0_f64), missing in 0..9_usize,
        ) {
            let plane = |x: f64, y: f64| place(x, y, 50.0 + tilt[0] * x + tilt[1] * y);
            let [left, right, above, below] = lengths;
            let y = if flip { -1.0 } else { 1.0 };
            let mut sides = [
                [plane(-left, 0.0), plane(right, 0.0)],
                [
                    plane(-above * turn.cos(), -above * y * turn.sin()),
                    plane(below * turn.cos(), below * y * turn.sin()),
                ],
            ];
            // One side of each axis may be missing.
            if missing % 3 < 2 { sides[0][missing % 3] = NOTHING; }
            if missing / 3 < 2 { sides[1][missing / 3] = NOTHING; }
            let expected = DVec3::new(-tilt[0], -tilt[1], 1.0).normalize();
            prop_assert!(close(normal(plane(0.0, 0.0), sides), expected));
        }

        /// A cylinder's side seen along one axis alone.
        #[test]
        fn ground_is_level_along_an_axis_without_neighbors(slope in -3.0..3.0_f64, first: bool) {
            let axis = [place(-1.0, 0.0, 50.0 - slope), place(1.0, 0.0, 50.0 + slope)];
            let nothing = [NOTHING; 2];
            let sides = if first { [axis, nothing] } else { [nothing, axis] };
            let expected = DVec3::new(-slope, 0.0, 1.0).normalize();
            prop_assert!(close(normal(place(0.0, 0.0, 50.0), sides), expected));
        }
    }

    #[test]
    fn ground_alone_is_level() {
        let up = DVec3::new(0.6, 0.0, 0.8);
        let here = Place { at: 3.0 * up, up, height_m: 1.0 };
        assert_eq!(normal(here, [[NOTHING; 2]; 2]), up);
    }

    /// On a round body a place as high lies below the tangent.
    #[test]
    fn as_high_on_one_side_is_level() {
        let on_sphere = |angle: f64| {
            let up = DVec3::new(angle.sin(), 0.0, angle.cos());
            Place { at: 9.0 * up, up, height_m: 2.0 }
        };
        for side in [[NOTHING, on_sphere(0.3)], [on_sphere(-0.2), NOTHING]] {
            assert!(close(normal(on_sphere(0.0), [side, [NOTHING; 2]]), DVec3::Z));
        }
    }

    /// All columns of a row on a pole are one place, at heights that may differ.
    #[test]
    fn what_lies_in_one_place_tells_nothing() {
        let here = place(0.0, 0.0, 50.0);
        let y = [place(0.0, -1.0, 49.5), place(0.0, 1.0, 50.5)];
        let x = [place(1e-13, 0.0, 57.0), here];
        let expected = DVec3::new(0.0, -0.5, 1.0).normalize();
        assert!(close(normal(here, [x, y]), expected));
        assert!(close(normal(here, [y, y]), expected));
    }
}
