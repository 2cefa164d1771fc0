//! Where a picture is taken from, and how sharp it has to be.

use areoid_formats::bounds::{Aabb, HalfSpace, OrientedBox, Position};
use areoid_formats::units::{Meters, Radians};
use areoid_formats::volume::{Horizon, Volume};
use glam::{DMat3, DVec3};

/// A pinhole camera in body-fixed space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Body-fixed meters from the body's center.
    pub eye: DVec3,
    /// Columns: right, up, backward, as unit vectors in body-fixed space.
    pub orientation: DMat3,
    /// The whole angle between the lower and the upper edge of the picture.
    pub vertical_fov: Radians,
    /// Width and height of the picture in pixels.
    pub viewport: [u32; 2],
    /// The largest error of a height on the screen, and the largest texel of a color, in pixels.
    pub tolerance_px: f64,
}

impl View {
    /// How many times the tolerance the error of a height page is where its children show alone. From
    /// the tolerance on they show more and more, and it less.
    pub const BLENDED: f64 = 1.25;

    /// The direction the camera looks in, a unit vector in body-fixed space.
    #[must_use]
    pub fn axis(&self) -> DVec3 {
        -self.orientation.z_axis
    }
}

/// What a search has to know of a view, computed once.
#[derive(Clone, Debug)]
pub(crate) struct Lens {
    pub(crate) eye: DVec3,
    pub(crate) axis: DVec3,
    /// The four sides, and the plane through the eye that the camera looks away from.
    pub(crate) frustum: [HalfSpace; 5],
    /// Toward the picture's corners.
    corners: [DVec3; 4],
    /// Pixels to a tangent of 1 from the view axis: S / (2 tan(θ/2)).
    pixels_per_tangent: f64,
    /// Cosine of the angle between the axis and the picture's corners.
    pub(crate) corner_cosine: f64,
    /// Cosine of the least angle between the picture and straight down.
    down_cosine: f64,
    /// At most the distance of what is seen, where all of the picture looks down on the sphere below all
    /// terrain; else infinite.
    farthest_ground: f64,
    /// What a sphere below all terrain hides.
    horizon: Option<Horizon>,
    /// Before that, if the body has nothing beyond the greatest radius.
    before: Option<HalfSpace>,
    /// Before that, whatever the body has.
    in_front: Option<HalfSpace>,
}

/// How near a page, or some other thing, is to a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    /// From the eye, in meters; infinite if it is out of sight.
    pub(crate) distance: f64,
    /// At most d cos² α of any of its visible points, at the distance d and the angle α from the
    /// axis: what lengths are divided by on their way to the screen.
    pub(crate) reach: f64,
    /// Whether it is seen, and all of it that the body does not hide is in the picture.
    pub(crate) is_whole: bool,
}

impl Sight {
    pub(crate) const NONE: Self =
        Self { distance: f64::INFINITY, reach: f64::INFINITY, is_whole: false };

    pub(crate) fn is_seen(&self) -> bool {
        self.distance.is_finite()
    }

    /// Of both distances and both reaches the stricter; what is whole is its own matter.
    pub(crate) fn within(&self, above: &Self) -> Self {
        let Self { distance, reach, is_whole } = *self;
        Self { distance: distance.max(above.distance), reach: reach.max(above.reach), is_whole }
    }
}

impl Lens {
    /// A dataset that is smaller on the screen is not drawn.
    pub(crate) const SMALLEST_PX: f64 = 1.0;

    /// All terrain lies between the two radii.
    pub(crate) fn new(view: &View, [inscribed_radius, greatest_radius]: [Meters; 2]) -> Self {
        let [width, height] = view.viewport.map(|pixels| f64::from(pixels.max(1)));
        let up_tangent = (view.vertical_fov.0 / 2.0).tan();
        let right_tangent = up_tangent * width / height;
        let DMat3 { x_axis: right, y_axis: up, z_axis: backward } = view.orientation;
        let horizon = Horizon::new(view.eye, inscribed_radius);
        let normals = [
            right - right_tangent * backward,
            -right - right_tangent * backward,
            up - up_tangent * backward,
            -up - up_tangent * backward,
            -backward,
        ];
        let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(x, y)| (x * right_tangent * right + y * up_tangent * up - backward).normalize());
        let down = -view.eye.normalize_or_zero();
        let least_cosine = corners.iter().map(|corner| corner.dot(down)).fold(1.0, f64::min);
        Self {
            eye: view.eye,
            axis: view.axis(),
            frustum: normals.map(|normal| HalfSpace::through(view.eye, normal)),
            corners,
            pixels_per_tangent: height / (2.0 * up_tangent),
            corner_cosine: (1.0 + up_tangent.powi(2) + right_tangent.powi(2)).sqrt().recip(),
            down_cosine: greatest_cosine(&normals, &corners, down),
            farthest_ground: until_sphere(view.eye, least_cosine, inscribed_radius),
            horizon,
            before: horizon.map(|horizon| horizon.before(greatest_radius)),
            in_front: horizon.map(|horizon| horizon.in_front()),
        }
    }

    /// How near a page is to the view.
    ///
    /// d cos² α is a cos α, with a the length along the axis: of both, the larger lower bound counts.
    pub(crate) fn sight(&self, volume: &Volume) -> Sight {
        self.sight_at(volume, self.position(volume))
    }

    /// The same, where it is known where the page lies.
    pub(crate) fn sight_at(&self, volume: &Volume, position: Position) -> Sight {
        if position == Position::Outside {
            return Sight::NONE;
        }
        let bounds = volume.bounds();
        let distance = volume.distance_from(self.eye).0;
        let distance = distance.max(self.nearest_within(volume.greatest_radius().0));
        let cosine = volume.least_cosine(self.eye, self.axis).max(self.corner_cosine);
        let along = bounds.nearest_along(self.axis) - self.axis.dot(self.eye);
        let reach = (distance * cosine * cosine).max(along * cosine);
        Sight { distance, reach, is_whole: position == Position::Within }
    }

    /// How near a box is to the view, and with it what lies in it.
    pub(crate) fn sight_of_box(&self, bounds: &Aabb) -> Sight {
        let distance = bounds.distance_from(self.eye);
        // The angles θ of the middle and φ of the radius of the sphere around it.
        let middle = bounds.center() - self.eye;
        let length = middle.length();
        let cos = self.axis.dot(middle) / length;
        let sin_radius = 0.5 * bounds.diagonal() / length;
        // NaN and what reaches around the eye fail the comparison.
        let cosine = if sin_radius < 1.0 && cos > 0.0 {
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            cos * (1.0 - sin_radius * sin_radius).sqrt() - sin * sin_radius
        } else {
            0.0
        };
        let cosine = cosine.max(self.corner_cosine);
        let along = -bounds.farthest_along(-self.axis) - self.axis.dot(self.eye);
        let reach = (distance * cosine * cosine).max(along * cosine);
        Sight { distance, reach, is_whole: false }
    }

    /// At most the distance of a visible point that is no farther than `radius` from the body's
    /// center; infinite if there can be none.
    ///
    /// The nearest point of that sphere along a ray is the farther the more the ray leans away from
    /// straight down, and rays in the picture lean by [`Self::down_cosine`] or more.
    fn nearest_within(&self, radius: f64) -> f64 {
        /// Against rounding, relative to the eye's distance from the center.
        const SLACK: f64 = 1e-12;
        let height2 = self.eye.length_squared();
        if height2 <= radius * radius {
            return 0.0;
        }
        let along = self.eye.length() * self.down_cosine;
        let under_root = radius * radius - (height2 - along * along);
        if along <= 0.0 || under_root < -1e-6 * height2 {
            return f64::INFINITY;
        }
        (along - under_root.max(0.0).sqrt() - SLACK * height2.sqrt()).max(0.0)
    }

    /// At most how far from the eye a page is where it is seen.
    pub(crate) fn farthest(&self, volume: &Volume) -> f64 {
        let beyond = volume.bounds().farthest_from(self.eye);
        let seen = self.horizon.map(|horizon| horizon.farthest_seen(volume.greatest_radius()).0);
        seen.map_or(beyond, |seen| seen.min(beyond)).min(self.farthest_ground)
    }

    /// How many times as long as wide a pixel is on level ground of a page at most, `reach` away:
    /// 1 / cos i with `cos i = (d_c² - ρ² - d²) / (2 ρ d)`.
    pub(crate) fn footprint_length(&self, volume: &Volume, reach: f64) -> f64 {
        let radius = volume.greatest_radius().0;
        let along = self.eye.length_squared() - radius * radius - reach * reach;
        if along > 0.0 { (2.0 * radius * reach / along).max(1.0) } else { f64::INFINITY }
    }

    /// Whether a point is in the picture, and not behind the body.
    pub(crate) fn shows(&self, point: DVec3) -> bool {
        self.frustum.iter().all(|side| side.normal.dot(point) >= side.offset)
            && !self.horizon.is_some_and(|horizon| horizon.hides_point(point))
    }

    /// Where a page lies, relative to the picture: outside if none of it can be seen, within if all of it
    /// is in the picture that the body does not hide.
    pub(crate) fn position(&self, volume: &Volume) -> Position {
        if self.horizon.is_some_and(|horizon| volume.hidden_by(&horizon)) {
            return Position::Outside;
        }
        match volume.position_in(&self.frustum) {
            Position::Across if self.is_beyond_a_face(volume) => Position::Outside,
            position => position,
        }
    }

    /// Whether the whole picture lies beyond one of the faces of a page's box: where a box is larger
    /// than the picture, it can miss it without lying outside any of the picture's sides.
    fn is_beyond_a_face(&self, volume: &Volume) -> bool {
        let OrientedBox { center, axes, half } = volume.bounds();
        let eye = self.eye - *center;
        let faces = [(axes.x_axis, half.x), (axes.y_axis, half.y), (axes.z_axis, half.z)];
        faces.into_iter().any(|(axis, half)| {
            let eye = axis.dot(eye);
            eye > half && self.corners.iter().all(|corner| axis.dot(*corner) >= 0.0)
                || eye < -half && self.corners.iter().all(|corner| axis.dot(*corner) <= 0.0)
        })
    }

    /// Where a box around terrain lies: outside if it is out of sight, within if all of it is in the picture and
    /// in front of what the body hides.
    pub(crate) fn position_of_box(&self, bounds: &Aabb) -> Position {
        match bounds.position_in(self.in_front.as_slice()) {
            Position::Within => bounds.position_in(&self.frustum),
            _ if self.misses_box(bounds) => Position::Outside,
            _ => Position::Across,
        }
    }

    /// Whether a box around terrain is out of sight.
    pub(crate) fn misses_box(&self, bounds: &Aabb) -> bool {
        bounds.outside(self.before.as_slice()) || bounds.outside(&self.frustum)
    }

    /// How large a length can be on the screen, at a reach: `ARCHITECTURE.md`, the error on the
    /// screen.
    pub(crate) fn pixels(&self, length_m: f64, reach_m: f64) -> f64 {
        if length_m > 0.0 {
            length_m * self.pixels_per_tangent / reach_m
        } else {
            // Nothing is not visible, however near.
            0.0
        }
    }
}

/// How far from the eye the ray enters a sphere that leans away from straight down by an angle of this
/// cosine; infinite if it does not, or leans up.
fn until_sphere(eye: DVec3, cosine: f64, radius: Meters) -> f64 {
    let along = eye.length() * cosine;
    let under_root = radius.0 * radius.0 - (eye.length_squared() - along * along);
    if along > 0.0 && under_root > 0.0 && eye.length() > radius.0 {
        along - under_root.sqrt()
    } else {
        f64::INFINITY
    }
}

/// The greatest cosine between `toward` and a ray within four planes through the eye that face inward:
/// toward itself, or toward the nearest of the planes' faces and edges.
fn greatest_cosine(normals: &[DVec3; 5], corners: &[DVec3; 4], toward: DVec3) -> f64 {
    let inside = |ray: DVec3| normals.iter().all(|normal| normal.dot(ray) >= -1e-12);
    if inside(toward) {
        return 1.0;
    }
    let onto = |normal: &DVec3| {
        let ray = toward - normal.dot(toward) / normal.length_squared() * *normal;
        ray.try_normalize().filter(|ray| inside(*ray))
    };
    let rays = normals[..4].iter().filter_map(onto).chain(corners.iter().copied());
    rays.map(|ray| ray.dot(toward)).fold(-1.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Degrees;

    /// A short stick across the line of sight, anywhere in the picture and turned any way, is
    /// never longer than promised, and at the corner nearly as long.
    #[test]
    fn a_stick_is_never_longer_on_the_screen() {
        let view = View {
            eye: DVec3::new(1.0, 2.0, 3.0),
            orientation: DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(0.3),
            vertical_fov: Degrees(45.0).into(),
            viewport: [1600, 900],
            tolerance_px: 1.0,
        };
        let lens = Lens::new(&view, [Meters(1.0); 2]);
        let screen = |point: DVec3| {
            let seen = view.orientation.transpose() * (point - view.eye);
            glam::DVec2::new(seen.x, seen.y) / -seen.z * lens.pixels_per_tangent
        };
        let (mut longest, stick) = (0.0_f64, 1e-3);
        for corner in 0..=20 {
            let share = f64::from(corner) / 20.0;
            let tangent = glam::DVec2::new(1600.0, 900.0) / 900.0 * 22.5_f64.to_radians().tan();
            let sight = DVec3::new(share * tangent.x, share * tangent.y, -1.0).normalize();
            let point = view.eye + view.orientation * (100.0 * sight);
            assert!(lens.frustum.iter().all(|side| side.normal.dot(point) >= side.offset - 1e-9));
            let cosine = (point - view.eye).normalize().dot(lens.axis);
            let promised = lens.pixels(stick, 100.0 * cosine * cosine);
            for turn in 0..36 {
                let along = DVec3::new(sight.y, -sight.x, 0.0).normalize_or(DVec3::X);
                let across = sight.cross(along);
                let (sine, cosine) = (f64::from(turn) * 10.0).to_radians().sin_cos();
                let end = point + view.orientation * (stick * (along * cosine + across * sine));
                let length = (screen(end) - screen(point)).length();
                assert!(length <= promised * (1.0 + 1e-4), "{length} > {promised}");
                longest = longest.max(length / promised);
            }
        }
        assert!(longest > 0.999, "{longest}");
    }

    /// The least angle to straight down, against a search over the picture.
    #[test]
    fn the_picture_is_as_far_from_straight_down_as_its_nearest_ray() {
        for step in 0..200 {
            let turn = f64::from(step);
            let view = View {
                eye: DVec3::new(3.0, 0.1 * turn.sin(), 0.2),
                orientation: DMat3::from_rotation_z(0.7 * turn)
                    * DMat3::from_rotation_x(0.031 * turn)
                    * DMat3::from_rotation_y(1.3 * turn),
                vertical_fov: Degrees(20.0 + 0.4 * turn).into(),
                viewport: [1600, 900],
                tolerance_px: 1.0,
            };
            let lens = Lens::new(&view, [Meters(1.0); 2]);
            let up = (view.vertical_fov.0 / 2.0).tan();
            let right = up * 1600.0 / 900.0;
            let grid = (0..=200).flat_map(|x| (0..=200).map(move |y| (x, y)));
            let nearest = grid
                .map(|(x, y)| [x, y].map(|step| f64::from(step) / 100.0 - 1.0))
                .map(|[x, y]| view.orientation * DVec3::new(x * right, y * up, -1.0).normalize())
                .map(|ray| ray.dot(-view.eye.normalize()))
                .fold(-1.0, f64::max);
            assert!(lens.down_cosine >= nearest - 1e-12, "{step}: {} {nearest}", lens.down_cosine);
            assert!(lens.down_cosine <= nearest + 1e-3, "{step}: {} {nearest}", lens.down_cosine);
        }
    }
}
