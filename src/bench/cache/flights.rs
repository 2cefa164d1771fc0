//! Flights that are measured on.

use areoid_cache::flight::{Flight, Key};

use crate::failure::Failure;

/// A flight and what it is called.
#[derive(Clone, Debug)]
pub(super) struct Named {
    pub(super) name: &'static str,
    pub(super) flight: Flight,
}

fn named(
    name: &'static str,
    seconds: f64,
    keys: &[([f64; 3], [f64; 2])],
) -> Result<Named, Failure> {
    let legs = keys.len().saturating_sub(1).max(1) as f64;
    let keys = keys.iter().enumerate().map(|(place, &(eye, look))| Key {
        seconds: seconds * place as f64 / legs,
        eye,
        look,
    });
    let flight = Flight::new(keys.collect()).map_err(|error| Failure::Failed(error.into()))?;
    Ok(Named { name, flight })
}

/// From orbit, obliquely, near the ground, over a pole, and from far away down to the ground, each of
/// so many seconds.
pub(super) fn flights(seconds: f64) -> Result<Vec<Named>, Failure> {
    // Degrees that are passed over in a second at twenty seconds, and as many in a shorter flight.
    let of = |degrees: f64| degrees * seconds / 20.0;
    Ok(vec![
        named(
            "orbit",
            seconds,
            &[([10.0, -10.0, 4e5], [60.0, -90.0]), ([10.0 + of(40.0), 10.0, 4e5], [60.0, -90.0])],
        )?,
        named(
            "oblique",
            seconds,
            &[([-60.0, 20.0, 1e5], [70.0, -25.0]), ([-60.0 + of(20.0), 25.0, 1e5], [80.0, -25.0])],
        )?,
        named(
            "ground",
            seconds,
            &[([100.0, 5.0, 5e3], [90.0, -5.0]), ([100.0 + of(3.0), 5.0, 5e3], [80.0, -5.0])],
        )?,
        named(
            "pole",
            seconds,
            &[
                ([0.0, 90.0 - of(10.0), 2e5], [0.0, -60.0]),
                ([180.0, 90.0 - of(10.0), 2e5], [180.0, -60.0]),
            ],
        )?,
        named(
            "descent",
            seconds,
            &[([-130.0, 15.0, 5e6], [0.0, -90.0]), ([-130.0 + of(2.0), 18.0, 2e4], [30.0, -30.0])],
        )?,
    ])
}

/// A flight with a leap to another place every few seconds, and turns on the spot.
pub(super) fn leaps(seconds: f64) -> Result<Flight, Failure> {
    const LEG_S: f64 = 5.0;
    let mut keys = Vec::new();
    let mut start = 0.0;
    let mut number = 0.0_f64;
    while start < seconds {
        let longitude = (137.5 * number).rem_euclid(360.0) - 180.0;
        let latitude = 80.0 * (2.4 * number).sin();
        let altitude = 10.0_f64.powf(4.3 + 2.0 * (1.3 * number).sin().powi(2));
        let heading = (77.0 * number).rem_euclid(360.0);
        let end = (start + LEG_S).min(seconds);
        keys.push(Key {
            seconds: start,
            eye: [longitude, latitude, altitude],
            look: [heading, -35.0],
        });
        keys.push(Key {
            seconds: end,
            eye: [longitude + 2.0, latitude, altitude],
            look: [heading + 60.0, -50.0],
        });
        (start, number) = (end, number + 1.0);
    }
    Flight::new(keys).map_err(|error| Failure::Failed(error.into()))
}

/// There and back along one way, and around on the spot at its ends: what was seen is seen again.
pub(super) fn returns(seconds: f64) -> Result<Flight, Failure> {
    const LEG_S: f64 = 10.0;
    const ENDS: [[f64; 3]; 2] = [[-80.0, 10.0, 6e4], [-72.0, 14.0, 6e4]];
    let (mut keys, mut start, mut leg) = (Vec::new(), 0.0, 0);
    while start < seconds {
        let eye = ENDS[leg % 2];
        let heading = if leg % 2 == 0 { 60.0 } else { 240.0 };
        keys.push(Key { seconds: start, eye, look: [heading, -35.0] });
        keys.push(Key { seconds: start + 0.3 * LEG_S, eye, look: [heading + 170.0, -35.0] });
        (start, leg) = (start + LEG_S, leg + 1);
    }
    Flight::new(keys).map_err(|error| Failure::Failed(error.into()))
}
