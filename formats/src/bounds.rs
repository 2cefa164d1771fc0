//! Boxes around things, and half spaces to tell them apart by.
//!
//! Everything is in body-fixed meters, and everything errs on the safe side by rounding alone:
//! whoever makes a box adds the slack.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// The points `p` with `normal · p >= offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Points into the half space; of any length but 0.
    pub normal: DVec3,
    /// In meters times the length of `normal`.
    pub offset: f64,
}

impl HalfSpace {
    /// The half space that `normal` points into from `point`.
    #[must_use]
    pub fn through(point: DVec3, normal: DVec3) -> Self {
        Self { normal, offset: normal.dot(point) }
    }
}

/// A box along the axes of body-fixed space.
///
/// The empty box has its least above its greatest coordinates and contains nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Least coordinates, in meters.
    pub min: [f64; 3],
    /// Greatest coordinates, in meters.
    pub max: [f64; 3],
}

impl Aabb {
    /// The box that contains nothing.
    pub const EMPTY: Self = Self { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    /// The box with two opposite corners.
    #[must_use]
    pub fn new(min: DVec3, max: DVec3) -> Self {
        Self { min: min.to_array(), max: max.to_array() }
    }

    /// Whether the box contains nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        (0..3).any(|axis| self.min[axis] > self.max[axis])
    }

    /// The least box around both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        let (min, max) = (self.least().min(other.least()), self.greatest().max(other.greatest()));
        Self::new(min, max)
    }

    /// The box of all points that are no farther from this one than `by` along any axis.
    #[must_use]
    pub fn grown(&self, by: f64) -> Self {
        Self::new(self.least() - DVec3::splat(by), self.greatest() + DVec3::splat(by))
    }

    /// Half the area of the surface, in square meters: what the cost of a tree counts in.
    #[must_use]
    pub fn half_area(&self) -> f64 {
        let size = (self.greatest() - self.least()).max(DVec3::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    /// How far two opposite corners are apart; 0 if the box is empty.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        (self.greatest() - self.least()).max(DVec3::ZERO).length()
    }

    /// The middle of the box.
    #[must_use]
    pub fn center(&self) -> DVec3 {
        0.5 * (self.least() + self.greatest())
    }

    /// Whether `other` lies in this box.
    #[must_use]
    pub fn contains(&self, other: &Self) -> bool {
        other.is_empty()
            || (self.least().cmple(other.least()) & self.greatest().cmpge(other.greatest())).all()
    }

    /// Whether the boxes have a point in common.
    #[must_use]
    pub fn meets(&self, other: &Self) -> bool {
        (self.least().cmple(other.greatest()) & self.greatest().cmpge(other.least())).all()
    }

    /// How far away the nearest point of the box is.
    #[must_use]
    pub fn distance_from(&self, eye: DVec3) -> f64 {
        (self.least() - eye).max(eye - self.greatest()).max(DVec3::ZERO).length()
    }

    /// The greatest `direction · p` over the points of the box.
    #[must_use]
    pub fn farthest_along(&self, direction: DVec3) -> f64 {
        (direction * self.least()).max(direction * self.greatest()).element_sum()
    }

    /// Where the box lies, relative to half spaces; within them if there is none.
    #[must_use]
    pub fn position_in(&self, frustum: &[HalfSpace]) -> Position {
        let mut position = Position::Within;
        for side in frustum {
            if self.farthest_along(side.normal) < side.offset {
                return Position::Outside;
            }
            // What is no number is across.
            let is_within = -self.farthest_along(-side.normal) >= side.offset;
            if !is_within {
                position = Position::Across;
            }
        }
        position
    }

    /// Whether the box lies wholly outside one of the half spaces.
    #[must_use]
    pub fn outside(&self, frustum: &[HalfSpace]) -> bool {
        frustum.iter().any(|side| self.farthest_along(side.normal) < side.offset)
    }

    fn least(&self) -> DVec3 {
        DVec3::from_array(self.min)
    }

    fn greatest(&self) -> DVec3 {
        DVec3::from_array(self.max)
    }
}

/// Where something lies, relative to half spaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Position {
    /// Wholly outside one of them.
    Outside,
    /// Neither, as far as is known.
    Across,
    /// Wholly in all of them.
    Within,
}

/// A box along axes of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedBox {
    /// The middle of the box.
    pub center: DVec3,
    /// Unit vectors along the edges, at right angles.
    pub axes: DMat3,
    /// Half the length of the edges.
    pub half: DVec3,
}

impl OrientedBox {
    /// The box whose extents along `axes` are `min` to `max`.
    #[must_use]
    pub fn from_extents(axes: DMat3, min: DVec3, max: DVec3) -> Self {
        Self { center: axes * (0.5 * (min + max)), axes, half: 0.5 * (max - min) }
    }

    /// The radius of the sphere around [`Self::center`] that touches the corners.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.half.length()
    }

    /// The least `direction · p` over the points of the box.
    #[must_use]
    pub fn nearest_along(&self, direction: DVec3) -> f64 {
        -self.farthest_along(-direction)
    }

    /// Where the box lies, relative to half spaces; within them if there is none.
    #[must_use]
    pub fn position_in(&self, frustum: &[HalfSpace]) -> Position {
        let mut position = Position::Within;
        for side in frustum {
            let half = self.half_along(side.normal);
            let middle = side.normal.dot(self.center) - side.offset;
            if middle < -half {
                return Position::Outside;
            }
            // What is no number is across.
            let is_within = middle >= half;
            if !is_within {
                position = Position::Across;
            }
        }
        position
    }

    /// How far away the nearest point of the box is.
    #[must_use]
    pub fn distance_from(&self, eye: DVec3) -> f64 {
        let eye_in_box = self.axes.transpose_mul_vec3(eye - self.center);
        (eye_in_box.abs() - self.half).max(DVec3::ZERO).length()
    }

    /// How far away the farthest point of the box is.
    #[must_use]
    pub fn farthest_from(&self, eye: DVec3) -> f64 {
        let eye_in_box = self.axes.transpose_mul_vec3(eye - self.center);
        (eye_in_box.abs() + self.half).length()
    }

    /// The greatest `direction · p` over the points of the box.
    #[must_use]
    pub fn farthest_along(&self, direction: DVec3) -> f64 {
        direction.dot(self.center) + self.half_along(direction)
    }

    /// How far `direction · p` reaches to either side of the center's.
    fn half_along(&self, direction: DVec3) -> f64 {
        self.axes.transpose_mul_vec3(direction).abs().dot(self.half)
    }

    /// The corners.
    #[must_use]
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|corner| {
            let side = |bit: usize| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let corner_in_box = self.half * DVec3::new(side(0), side(1), side(2));
            self.center + self.axes * corner_in_box
        })
    }

    /// The least box along body-fixed axes around this one.
    #[must_use]
    pub fn aabb(&self) -> Aabb {
        let [x, y, z] = [self.axes.x_axis, self.axes.y_axis, self.axes.z_axis].map(DVec3::abs);
        let half = x * self.half.x + y * self.half.y + z * self.half.z;
        Aabb::new(self.center - half, self.center + half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-10.0..10.0).prop_map(DVec3::from_array)
    }

    fn oriented() -> impl Strategy<Value = OrientedBox> {
        (vector(), vector(), prop::array::uniform3(0.0..5.0)).prop_map(|(center, turn, half)| {
            let axes = DMat3::from_rotation_x(turn.x) * DMat3::from_rotation_z(turn.z);
            OrientedBox { center, axes, half: DVec3::from_array(half) }
        })
    }

    #[test]
    fn nothing_is_in_the_empty_box() {
        let unit = Aabb::new(DVec3::ZERO, DVec3::ONE);
        assert!(Aabb::EMPTY.is_empty() && !unit.is_empty());
        assert_eq!(Aabb::EMPTY.union(&unit), unit);
        assert_eq!(Aabb::EMPTY.half_area(), 0.0);
        assert!(unit.contains(&Aabb::EMPTY) && !Aabb::EMPTY.contains(&unit));
        assert!(!unit.meets(&Aabb::EMPTY));
    }

    #[test]
    fn a_box_of_no_numbers_is_neither_within_nor_outside() {
        let side = HalfSpace::through(DVec3::ZERO, DVec3::X);
        for (center, half) in
            [(f64::NAN, 1.0), (0.0, f64::NAN), (0.0, f64::INFINITY), (f64::NAN, f64::INFINITY)]
        {
            let (center, half) = (DVec3::splat(center), DVec3::splat(half));
            let volume = OrientedBox { center, axes: DMat3::IDENTITY, half };
            assert_eq!(volume.position_in(&[side]), Position::Across);
            let box_of_none = Aabb::new(center - half, center + half);
            assert_eq!(box_of_none.position_in(&[side]), Position::Across);
        }
    }

    proptest! {
        #[test]
        fn an_oriented_box_lies_in_its_aligned_one(
            volume in oriented(), eye in vector(), direction in vector(),
        ) {
            let aabb = volume.aabb();
            prop_assert!(aabb.distance_from(eye) <= volume.distance_from(eye) + 1e-9);
            prop_assert!(aabb.farthest_along(direction) >= volume.farthest_along(direction) - 1e-9);
            let (mut nearest, mut farthest) = (f64::INFINITY, f64::NEG_INFINITY);
            for corner in volume.corners() {
                prop_assert!(aabb.distance_from(corner) < 1e-9);
                prop_assert!((corner.distance(volume.center) - volume.radius()).abs() < 1e-9);
                nearest = nearest.min(corner.distance(eye));
                farthest = farthest.max(corner.dot(direction));
            }
            prop_assert!(volume.distance_from(eye) <= nearest + 1e-9);
            prop_assert!((volume.farthest_along(direction) - farthest).abs() < 1e-9);
            let side = HalfSpace::through(eye, direction);
            prop_assert_eq!(aabb.outside(&[side]), aabb.farthest_along(direction) < side.offset);
            let [min, max] = [aabb.min, aabb.max];
            let depths = (0..8).map(|corner| {
                let at = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                direction.dot(DVec3::new(at(0), at(1), at(2))) - side.offset
            });
            let (least, most) =
                depths.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), depth| {
                    (least.min(depth), most.max(depth))
                });
            // Nearer to the plane than that, rounding tells.
            if least.abs().min(most.abs()) > 1e-9 {
                let expected = match (least > 0.0, most < 0.0) {
                    (true, _) => Position::Within,
                    (_, true) => Position::Outside,
                    _ => Position::Across,
                };
                prop_assert_eq!(aabb.position_in(&[side]), expected);
                let both = [HalfSpace::through(eye, DVec3::ZERO), side];
                prop_assert_eq!(aabb.position_in(&both), expected);
            }
        }

        #[test]
        fn corners_tell_where_a_box_lies(
            volume in oriented(), sides in prop::collection::vec((vector(), vector()), 0..5),
        ) {
            let sides: Vec<HalfSpace> =
                sides.iter().map(|&(eye, normal)| HalfSpace::through(eye, normal)).collect();
            let depths: Vec<[f64; 8]> = sides
                .iter()
                .map(|side| volume.corners().map(|corner| side.normal.dot(corner) - side.offset))
                .collect();
            // Nearer to a plane than that, rounding tells.
            prop_assume!(depths.iter().flatten().all(|depth| depth.abs() > 1e-9));
            let is_outside = |depths: &[f64; 8]| depths.iter().all(|depth| *depth < 0.0);
            let expected = if depths.iter().any(is_outside) {
                Position::Outside
            } else if depths.iter().flatten().all(|depth| *depth > 0.0) {
                Position::Within
            } else {
                Position::Across
            };
            prop_assert_eq!(volume.position_in(&sides), expected);
        }
    }
}
