//! The space that a page can occupy, and what follows from it about a view.
//!
//! The volume of a page is the shell of its footprint between the lowest and the highest height of
//! the finest data under it. It is a *set*: a parent's contains its children's, because footprints
//! and heights nest. What stands here is an oriented box around that set,
//!
//! ```text
//!              up
//!         _____|_____
//!        |   .-^-.   |   <- highest, over the middle of the footprint
//!        | .'_____'. |
//!        |/_/     \_\|   <- lowest, at its corners
//! ```
//!
//! and the set's greatest distance from the body's center. Every answer errs on the safe side:
//! distances are too small, angles too large, and what is called hidden or outside is. Boxes of
//! children may stick out of their parent's; a search that wants monotone answers keeps the
//! parent's where it is the stricter.
//!
//! # Conventions
//!
//! Body-fixed meters from the body's center; heights are along the ellipsoid's normal.
//!
//! # References
//!
//! * P-BDAM: nested volumes and errors.
//! * Virtual Globes, section 4.4: culling behind the horizon of an inscribed sphere.

use glam::{DMat3, DVec3};

use crate::address::PageAddress;
use crate::bounds::{Aabb, HalfSpace, OrientedBox, Position};
use crate::footprint::{Extents, Footprint};
use crate::geodesy::Geographic;
use crate::grid::Grid;
use crate::units::{Meters, Radians};

/// A box around the shell of a page's footprint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    bounds: OrientedBox,
    greatest_radius: f64,
}

/// What an eye sees past the limb of a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    /// n, from the body's center to the eye.
    toward_eye: DVec3,
    radius2: f64,
    /// r² / d and √(1 - r² / d²), with d the eye's distance from the center.
    plane: f64,
    sine: f64,
}

impl Horizon {
    /// The horizon of a sphere of `radius` that lies below all terrain, or `None` for an eye in it.
    #[must_use]
    pub fn new(eye: DVec3, radius: Meters) -> Option<Self> {
        let distance = eye.length();
        if distance <= radius.0 || radius.0 <= 0.0 {
            return None;
        }
        let cosine = radius.0 / distance;
        Some(Self {
            toward_eye: eye / distance,
            radius2: radius.0 * radius.0,
            plane: radius.0 * cosine,
            sine: ((1.0 - cosine) * (1.0 + cosine)).sqrt(),
        })
    }

    /// Whether the sphere hides everything that reaches no farther than `along` toward the eye, and
    /// `greatest_radius` from the body's center: `ARCHITECTURE.md`.
    ///
    /// A point at the angle γ from n is hidden from γ₁ + γ₂ on, with cos γ₁ = r/d and cos γ₂ = r/ρ;
    /// the formula is the cosine of that sum, times ρ.
    #[must_use]
    fn hides(&self, along: f64, greatest_radius: f64) -> bool {
        along < self.hidden_below(greatest_radius)
    }

    /// Whether the sphere hides a point.
    #[must_use]
    pub fn hides_point(&self, point: DVec3) -> bool {
        self.hides(self.toward_eye.dot(point), point.length())
    }

    /// The half space in which the sphere hides nothing that lies outside of it: n · p ≥ r² / d.
    ///
    /// Its plane is that of the circle in which rays from the eye touch the sphere. Whatever ray enters the
    /// sphere does so before that plane and leaves behind it, so that what is hidden lies behind it.
    #[must_use]
    pub fn in_front(&self) -> HalfSpace {
        HalfSpace { normal: self.toward_eye, offset: self.plane }
    }

    fn hidden_below(&self, greatest_radius: f64) -> f64 {
        let over = (greatest_radius * greatest_radius - self.radius2).max(0.0).sqrt();
        self.plane - self.sine * over
    }

    /// How far from the eye at most anything is seen that is no farther than `greatest_radius` from
    /// the body's center: along the line that touches the sphere.
    #[must_use]
    pub fn farthest_seen(&self, greatest_radius: Meters) -> Meters {
        let over = |radius: f64| (radius * radius - self.radius2).max(0.0).sqrt();
        Meters(over(self.radius2 / self.plane) + over(greatest_radius.0))
    }

    /// The half space that holds whatever may be seen of things no farther than `greatest_radius`
    /// from the body's center.
    #[must_use]
    pub fn before(&self, greatest_radius: Meters) -> HalfSpace {
        let offset = self.hidden_below(greatest_radius.0);
        HalfSpace { normal: self.toward_eye, offset }
    }
}

impl Volume {
    /// What boxes are enlarged by, relative to the body: the precision of the projections.
    const SLACK: f64 = 1e-9;

    /// The volume of `page` between two heights, which for a page of colors are those of the
    /// terrain it lies on.
    ///
    /// # Domain
    ///
    /// Any page of the grid's pyramid. Heights that are no numbers, or below the centers of
    /// curvature, make a volume around the whole body.
    ///
    /// # Precision
    ///
    /// On a map of longitudes and latitudes the box touches the shell on all its sides. On a polar
    /// map it is larger by at most a hundredth of the page's side while the page is smaller than
    /// the body's radius.
    #[must_use]
    pub fn new(grid: &Grid, page: PageAddress, lowest: Meters, highest: Meters) -> Self {
        let body = &grid.crs().body;
        let (a, b) = (body.a().0, body.b().0);
        let heights = [lowest.0.min(highest.0), lowest.0.max(highest.0)];
        let slack = Self::SLACK * a;
        let numbers = lowest.0.is_finite() && highest.0.is_finite();
        let shell = numbers && heights[0] > -b * (b / a);
        let footprint = if shell { Footprint::new(grid, page) } else { Footprint::Anywhere };

        let highest = if numbers { heights[1].max(0.0) } else { a };
        let latitude = Radians(footprint.lowest_latitude());
        let position = Geographic { longitude: Radians(0.0), latitude };
        let greatest_radius = match footprint {
            Footprint::Anywhere => a + highest,
            _ => body.cartesian_from_geographic(position, Meters(heights[1])).length(),
        } + slack;

        let reach = DVec3::splat(greatest_radius);
        let extents = footprint.extents(body, heights).unwrap_or(Extents {
            axes: DMat3::IDENTITY,
            min: -reach,
            max: reach,
        });
        let min = (extents.min - DVec3::splat(slack)).max(-reach);
        let max = (extents.max + DVec3::splat(slack)).min(reach);
        Self { bounds: OrientedBox::from_extents(extents.axes, min, max), greatest_radius }
    }

    /// The box.
    #[must_use]
    pub fn bounds(&self) -> &OrientedBox {
        &self.bounds
    }

    /// A bound on the distance of its points from the body's center.
    #[must_use]
    pub fn greatest_radius(&self) -> Meters {
        Meters(self.greatest_radius)
    }

    /// The box along body-fixed axes.
    #[must_use]
    pub fn aabb(&self) -> Aabb {
        self.bounds.aabb()
    }

    /// At most the distance from `eye` to the nearest point.
    #[must_use]
    pub fn distance_from(&self, eye: DVec3) -> Meters {
        let above = eye.length() - self.greatest_radius;
        Meters(self.bounds.distance_from(eye).max(above))
    }

    /// What of it lies in each quarter of the box, cut across its two longer edges.
    #[must_use]
    pub fn quarters(&self) -> [Self; 4] {
        let OrientedBox { center, axes, half } = self.bounds;
        let shortest = half.to_array().iter().position(|edge| *edge == half.min_element());
        let [one, other] = match shortest {
            Some(0) => [1, 2],
            Some(1) => [2, 0],
            // So it is where edges are no numbers.
            _ => [0, 1],
        };
        [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)].map(|(to_one, to_other)| {
            let (mut shift, mut half) = (DVec3::ZERO, half);
            (shift[one], shift[other]) = (to_one * half[one], to_other * half[other]);
            (half[one], half[other]) = (0.5 * half[one], 0.5 * half[other]);
            let bounds = OrientedBox { center: center + axes * shift, axes, half };
            Self { bounds, ..*self }
        })
    }

    /// Whether `horizon` hides all of it.
    #[must_use]
    pub fn hidden_by(&self, horizon: &Horizon) -> bool {
        let along = self.bounds.farthest_along(horizon.toward_eye).min(self.greatest_radius);
        horizon.hides(along, self.greatest_radius)
    }

    /// Where it lies, relative to half spaces.
    #[must_use]
    pub fn position_in(&self, frustum: &[HalfSpace]) -> Position {
        self.bounds.position_in(frustum)
    }

    /// At most the cosine of the angle at `eye` between the unit vector `axis` and any of its
    /// points; 0 where that is a right angle or more.
    ///
    /// A cone of less than a right angle is convex: it holds the box if it holds its corners.
    #[must_use]
    pub fn least_cosine(&self, eye: DVec3, axis: DVec3) -> f64 {
        let OrientedBox { center, axes, half } = self.bounds;
        let edges = [axes.x_axis * half.x, axes.y_axis * half.y, axes.z_axis * half.z];
        let from = center - eye - edges[0] - edges[1] - edges[2];
        let [x, y, z] = edges.map(|edge| 2.0 * edge);
        let corners =
            [from, from + x, from + y, from + (x + y)].into_iter().flat_map(|one| [one, one + z]);
        // One square root for all: what is behind stays negative.
        let squares = corners.map(|to_corner| {
            let along = axis.dot(to_corner);
            along * along.abs() / to_corner.length_squared()
        });
        let least = squares.fold(1.0, f64::min);
        // An eye at a corner is at no angle to it: `min` passes that over, and the others span the cone.
        if least > 0.0 { least.sqrt() - 4.0 * f64::EPSILON } else { 0.0 }
    }
}
