//! Flights: what an eye does over some time, as keys between which it moves smoothly.
//!
//! ```json
//! { "keys": [ { "seconds": 0,  "eye": [-133.8, 18.6, 900000], "look": [0, -90] },
//!             { "seconds": 10, "eye": [-120.0, 10.0, 30000],  "look": [45, -20] } ] }
//! ```
//!
//! `eye` is the longitude and the geographic latitude in degrees and meters above the reference
//! surface; `look` is heading and pitch in degrees. Between two keys the place goes along a great
//! circle, the height by equal factors in equal times (above the lower key, if that is below the
//! reference surface), and the camera turns about one axis. Two keys
//! of one time are a leap. Before the first key and after the last one the eye rests.

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::units::{Degrees, Meters};
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::camera::{Pose, local_axes};

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flight {
    keys: Vec<Key>,
}

/// Where an eye is at one time, and where it looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// Since the flight began.
    pub seconds: f64,
    /// Longitude and latitude in degrees, and meters above the reference surface.
    pub eye: [f64; 3],
    /// Heading, clockwise from north, and pitch, up from the horizon, in degrees.
    pub look: [f64; 2],
}

/// Why a text is no flight.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FlightError {
    /// It is not the JSON of one.
    #[error("no flight")]
    Json(#[from] serde_json::Error),

    /// It has no key.
    #[error("a flight needs at least one key")]
    Empty,

    /// A number that is none, or is no such angle, height or time.
    #[error("key {place}: {reason}")]
    Key {
        /// Which, from 0.
        place: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
}

impl Flight {
    /// The least height of an eye above the reference surface: basins lie below that.
    pub const LOWEST_M: f64 = -1e5;

    /// A flight through `keys`.
    ///
    /// # Errors
    ///
    /// [`FlightError`]: no key, latitudes past the poles, heights at which there is no eye, numbers
    /// that are none, or times that go back.
    pub fn new(keys: Vec<Key>) -> Result<Self, FlightError> {
        if keys.is_empty() {
            return Err(FlightError::Empty);
        }
        let mut last = 0.0;
        for (place, key) in keys.iter().enumerate() {
            let fail = |reason| Err(FlightError::Key { place, reason });
            let numbers = key.eye.iter().chain(&key.look).chain([&key.seconds]);
            if !numbers.clone().all(|number| number.is_finite()) {
                return fail("not a number");
            }
            if key.seconds < last {
                return fail("its time is before the one before");
            }
            if key.eye[1].abs() > 90.0 {
                return fail("its latitude is past a pole");
            }
            if !(Self::LOWEST_M..=1e12).contains(&key.eye[2]) {
                return fail("its height must be -1e5 to 1e12 m");
            }
            last = key.seconds;
        }
        Ok(Self { keys })
    }

    /// The flight that `json` describes.
    ///
    /// # Errors
    ///
    /// [`FlightError`].
    pub fn from_json(json: &str) -> Result<Self, FlightError> {
        let flight: Self = serde_json::from_str(json)?;
        Self::new(flight.keys)
    }

    /// How long it takes.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.keys.last().map_or(0.0, |key| key.seconds)
    }

    /// Where the eye is, and how it looks, after some seconds.
    #[must_use]
    pub fn pose(&self, ellipsoid: &Ellipsoid, seconds: f64) -> Pose {
        // The first one that is later; of keys of one time, the last is where the eye has leapt to.
        let next = self.keys.partition_point(|key| key.seconds <= seconds);
        let after = self.keys[next.min(self.keys.len() - 1)];
        let Some(before) = next.checked_sub(1).map(|place| self.keys[place]) else {
            return after.pose(ellipsoid);
        };
        let span = after.seconds - before.seconds;
        if span <= 0.0 {
            return before.pose(ellipsoid);
        }
        between(ellipsoid, [&before, &after], (seconds - before.seconds) / span)
    }
}

impl Key {
    fn position(&self) -> Geographic {
        let [longitude, latitude, _] = self.eye;
        Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
    }

    fn pose(&self, ellipsoid: &Ellipsoid) -> Pose {
        let ([.., altitude], [heading, pitch]) = (self.eye, self.look.map(Degrees));
        let position = self.position();
        Pose::from_eye(ellipsoid, position, Meters(altitude), heading.into(), pitch.into())
    }
}

/// A share of the way from one key to another.
fn between(ellipsoid: &Ellipsoid, keys: [&Key; 2], share: f64) -> Pose {
    let normals = keys.map(|key| surface_normal(key.position()));
    let arc = DQuat::from_rotation_arc(normals[0], normals[1]);
    let normal = DQuat::IDENTITY.slerp(arc, share) * normals[0];
    let position = geographic(normal);
    // Above the reference surface, or the lower key. So that an eye there can rise, a meter is added.
    let [first, last] = keys.map(|key| key.eye[2]);
    let base = first.min(last).min(0.0);
    let logs = [first, last].map(|height| (height - base).ln_1p());
    let altitude = base + (logs[0] + share * (logs[1] - logs[0])).exp_m1();
    let eye = ellipsoid.cartesian_from_geographic(position, Meters(altitude));

    // The cameras relative to axes that are carried along the arc.
    let axes = local_axes(keys[0].position());
    let carried = |share: f64| DMat3::from_quat(DQuat::IDENTITY.slerp(arc, share)) * axes;
    let relative = [0.0, 1.0].map(|end: f64| {
        let key = keys[usize::from(end > 0.5)];
        DQuat::from_mat3(&(carried(end).transpose() * key.pose(ellipsoid).orientation))
    });
    let turned = relative[0].slerp(relative[1], share);
    Pose { eye, orientation: carried(share) * DMat3::from_quat(turned) }
}

/// The position whose surface normal it is.
fn geographic(normal: DVec3) -> Geographic {
    let latitude = normal.z.atan2(normal.x.hypot(normal.y));
    let longitude = normal.y.atan2(normal.x);
    Geographic::from_degrees(Degrees(longitude.to_degrees()), Degrees(latitude.to_degrees()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARS: &str = "mars";

    fn ellipsoid() -> Ellipsoid {
        areoid_formats::body::Body::parse(MARS).unwrap().ellipsoid
    }

    fn key(seconds: f64, eye: [f64; 3], look: [f64; 2]) -> Key {
        Key { seconds, eye, look }
    }

    #[test]
    fn keys_are_met_and_steps_between_them_are_even() {
        let keys = vec![
            key(0.0, [170.0, 80.0, 5e5], [0.0, -90.0]),
            key(2.0, [-10.0, 85.0, 1e3], [30.0, -20.0]),
            key(2.0, [0.0, 0.0, 1e6], [0.0, -45.0]),
            key(5.0, [0.0, 0.0, 1e6], [90.0, -45.0]),
            key(6.0, [70.0, -42.0, -5e3], [90.0, -10.0]),
        ];
        let (flight, ellipsoid) = (Flight::new(keys.clone()).unwrap(), ellipsoid());
        for (at, key) in
            [(0.0, keys[0]), (2.0, keys[2]), (5.0, keys[3]), (6.0, keys[4]), (9.0, keys[4])]
        {
            let (pose, truth) = (flight.pose(&ellipsoid, at), key.pose(&ellipsoid));
            assert!((pose.eye - truth.eye).length() < 1e-3, "{at}");
            assert!(pose.orientation.abs_diff_eq(truth.orientation, 1e-9), "{at}");
        }
        let before = flight.pose(&ellipsoid, 2.0 - 1e-9);
        assert!((before.eye - keys[1].pose(&ellipsoid).eye).length() < 1.0);
        assert!(before.orientation.abs_diff_eq(keys[1].pose(&ellipsoid).orientation, 1e-6));
        // Over the pole, with no corner in the way and none in the turning.
        let poses: Vec<_> =
            (0..200).map(|step| flight.pose(&ellipsoid, f64::from(step) / 100.0)).collect();
        let turns = poses.windows(2).map(|pair| {
            let turn = pair[1].orientation * pair[0].orientation.transpose();
            DQuat::from_mat3(&turn).to_scaled_axis().length()
        });
        let turns: Vec<f64> = turns.collect();
        let mean = turns.iter().sum::<f64>() / turns.len() as f64;
        assert!(turns.iter().all(|turn| *turn < 3.0 * mean), "{turns:?}");
    }

    #[test]
    fn what_is_no_flight_says_why() {
        let good = r#"{"keys":[{"seconds":0,"eye":[0,0,1000],"look":[0,-90]}]}"#;
        let flight = Flight::from_json(good).unwrap();
        assert_eq!((flight.seconds(), flight.keys.len()), (0.0, 1));
        let again = serde_json::to_string(&flight).unwrap();
        assert_eq!(Flight::from_json(&again).unwrap(), flight);
        for (bad, why) in [
            ("", "no flight"),
            (r#"{"keys":[]}"#, "at least one key"),
            (r#"{"keys":[{"seconds":0,"eye":[0,91,1],"look":[0,0]}]}"#, "past a pole"),
            (r#"{"keys":[{"seconds":0,"eye":[0,0,-1e6],"look":[0,0]}]}"#, "height"),
            (r#"{"keys":[{"seconds":-1,"eye":[0,0,1],"look":[0,0]}]}"#, "before the one before"),
            (r#"{"keys":[{"seconds":0,"eye":[0,0,1e999],"look":[0,0]}]}"#, "no flight"),
            (r#"{"keys":[],"more":1}"#, "no flight"),
        ] {
            let error = Flight::from_json(bad).unwrap_err().to_string();
            assert!(error.contains(why), "{bad}: {error}");
        }
    }
}
