//! How many views a window shows, and where they look.

use areoid_cache::View;
use areoid_formats::units::{Meters, Radians};
use glam::DMat3;

use crate::camera::Pose;

/// How many views the window shows, side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arrangement {
    Single,
    /// Two places of one planet.
    SideBySide,
    /// Two eyes on one place.
    Stereo,
    /// Three screens around one eye: their edges meet.
    Wall,
}

/// Eyes of a stereo pair stand this share of their distance from the ground apart.
const STEREO_BASE: f64 = 0.03;

impl Arrangement {
    /// All of them, and what they are called.
    pub(super) const ALL: [(Self, &str); 4] = [
        (Self::Single, "one"),
        (Self::SideBySide, "two places"),
        (Self::Stereo, "stereo"),
        (Self::Wall, "wall"),
    ];

    /// The one after it, around.
    pub(super) fn next(self) -> Self {
        match self {
            Self::Single => Self::SideBySide,
            Self::SideBySide => Self::Stereo,
            Self::Stereo => Self::Wall,
            Self::Wall => Self::Single,
        }
    }

    /// The place, from the left, of the view that the eye looks straight into.
    pub(super) fn middle(self) -> usize {
        usize::from(self == Self::Wall)
    }

    /// The place of the view after whose axes the light of one falls: a wall has one light.
    pub(super) fn lit_as(self, place: usize) -> usize {
        if self == Self::Wall { self.middle() } else { place }
    }

    /// Which of two poses the view at a place from the left shows.
    pub(super) fn pose_of(self, place: usize) -> usize {
        if self == Self::SideBySide { place } else { 0 }
    }

    /// The views of a picture of so many pixels, from the left; `range` is how far the first pose is from
    /// what it looks at.
    pub(super) fn views(
        self,
        poses: [Pose; 2],
        range: Meters,
        [width, height]: [u32; 2],
        (vertical_fov, tolerance_px): (Radians, f64),
    ) -> Vec<View> {
        let view = |pose: Pose, columns: u32| {
            pose.view(vertical_fov, [(width / columns).max(1), height], tolerance_px)
        };
        match self {
            Self::Single => vec![view(poses[0], 1)],
            Self::SideBySide => poses.map(|pose| view(pose, 2)).into(),
            Self::Stereo => {
                let view = view(poses[0], 2);
                let apart = STEREO_BASE * range.0 * view.orientation.x_axis;
                [-0.5, 0.5].map(|side| View { eye: view.eye + side * apart, ..view }).into()
            }
            Self::Wall => {
                let view = view(poses[0], 3);
                let [across, up] = view.viewport.map(|pixels| f64::from(pixels.max(1)));
                let screen = 2.0 * ((vertical_fov.0 / 2.0).tan() * across / up).atan();
                let turned =
                    |screens: f64| view.orientation * DMat3::from_rotation_y(screens * screen);
                [1.0, 0.0, -1.0].map(|left| View { orientation: turned(left), ..view }).into()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use areoid_formats::units::Degrees;
    use glam::DVec3;

    use super::*;

    fn views(arrangement: Arrangement) -> Vec<View> {
        let pose = |x: f64| Pose {
            eye: DVec3::new(x, 2.0, 3.0),
            orientation: DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(x),
        };
        let lens = (Degrees(45.0).into(), 1.0);
        arrangement.views([pose(1.0), pose(2.0)], Meters(100.0), [1201, 300], lens)
    }

    /// Toward a place of a picture: -1 to 1 from the left, and from below.
    fn ray(view: &View, [x, y]: [f64; 2]) -> DVec3 {
        let up = (view.vertical_fov.0 / 2.0).tan();
        let right = up * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
        (view.orientation * DVec3::new(x * right, y * up, -1.0)).normalize()
    }

    #[test]
    fn screens_of_a_wall_meet_along_their_edges() {
        let screens = views(Arrangement::Wall);
        assert_eq!(screens.len(), 3);
        for pair in screens.windows(2) {
            assert_eq!((pair[0].eye, pair[0].viewport), (pair[1].eye, [400, 300]));
            for height in [-1.0, -0.3, 0.0, 1.0] {
                let apart = ray(&pair[0], [1.0, height]) - ray(&pair[1], [-1.0, height]);
                assert!(apart.length() < 1e-12, "{apart}");
            }
        }
        let straight = views(Arrangement::Single)[0];
        let middle = screens[Arrangement::Wall.middle()];
        assert_eq!((middle.eye, middle.orientation), (straight.eye, straight.orientation));
    }

    #[test]
    fn all_fit_into_the_picture_and_come_around() {
        let mut next = Arrangement::Single;
        for (arrangement, _) in Arrangement::ALL {
            assert_eq!(arrangement, next);
            next = arrangement.next();
            let views = views(arrangement);
            assert!(views.iter().map(|view| view.viewport[0]).sum::<u32>() <= 1201);
            assert!(arrangement.middle() < views.len());
            let eye = |place: usize| 1.0 + arrangement.pose_of(place) as f64;
            for (place, view) in views.iter().enumerate() {
                assert!((view.eye.x - eye(place)).abs() < 2.0, "{arrangement:?} {place}");
            }
        }
        assert_eq!(next, Arrangement::Single);
        let [left, right]: [View; 2] = views(Arrangement::Stereo).try_into().unwrap();
        let apart = left.orientation.transpose() * (right.eye - left.eye);
        assert!((apart - DVec3::new(3.0, 0.0, 0.0)).length() < 1e-12, "{apart}");
    }
}
