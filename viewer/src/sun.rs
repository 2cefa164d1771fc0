//! Where the sun stands over the Earth and Mars at a time.
//!
//! # Units
//!
//! Times are days since J2000.0, 2000-01-01 12:00, in UTC for the Earth and for Mars: the minute by
//! which clocks differ moves the sun by a quarter of a degree.
//!
//! # Precision
//!
//! 0.05° for the Earth, 0.3° for Mars, from 1950 to 2100.
//!
//! # References
//!
//! * *Astronomical Almanac*, section C, "Low precision formulas for the Sun".
//! * M. Allison and M. `McEwen`, "A post-Pathfinder evaluation of areocentric solar coordinates with
//!   improved timing recipes for Mars seasonal/diurnal climate studies", Planetary and Space Science
//!   48, 2000: equations 16-19, 24-26.

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use areoid_formats::units::Degrees;

use crate::known_body::KnownBody;

/// Days since J2000.0 of a UTC date, as in `2026-11-29` or `2026-11-29T08:41:46Z`.
///
/// ```
/// use areoid_viewer::sun::days_of_utc;
/// assert_eq!(days_of_utc("2000-01-01T12:00:00Z"), Some(0.0));
/// assert_eq!(days_of_utc("2000-01-02"), Some(0.5));
/// assert_eq!(days_of_utc("soon"), None);
/// ```
#[must_use]
pub fn days_of_utc(text: &str) -> Option<f64> {
    let text = text.trim().trim_end_matches('Z');
    let (date, time) = text.split_once('T').unwrap_or((text, "00:00:00"));
    let mut parts = date.splitn(3, '-');
    let year: i64 = parts.next()?.parse().ok().filter(|year| (1..=9999).contains(year))?;
    let month: i64 = parts.next()?.parse().ok().filter(|month| (1..=12).contains(month))?;
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let length = match month {
        2 => 28 + i64::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    let day: i64 = parts.next()?.parse().ok().filter(|day| (1..=length).contains(day))?;
    let mut clock = time.splitn(3, ':');
    let mut next = |below: f64| match clock.next() {
        None => Some(0.0),
        Some(text) => text.parse().ok().filter(|&n: &f64| n >= 0.0 && n < below),
    };
    let (hours, minutes, seconds) = (next(24.0)?, next(60.0)?, next(61.0)?);
    // Days of the proleptic Gregorian calendar, years from March on.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day;
    #[expect(clippy::cast_precision_loss, reason = "millions of days")]
    let since_j2000 = (days - 730_426) as f64 - 0.5;
    Some(since_j2000 + (hours + (minutes + seconds / 60.0) / 60.0) / 24.0)
}

/// Where the sun is in the zenith: on the Earth or on Mars, told by the body's size.
#[must_use]
pub fn subsolar(body: &Ellipsoid, days: f64) -> Option<Geographic> {
    let (longitude, declination) = match KnownBody::of(body)? {
        KnownBody::Earth => over_earth(days),
        KnownBody::Mars => over_mars(days),
    };
    // The sun's rays are the ellipsoid's normals there: a declination is a geographic latitude.
    Some(Geographic::from_degrees(Degrees(turned(longitude)), Degrees(declination)))
}

fn turned(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

/// East longitude and declination in degrees.
fn over_earth(days: f64) -> (f64, f64) {
    let mean_longitude = 280.460 + 0.985_647_4 * days;
    let anomaly = (357.528 + 0.985_600_3 * days).to_radians();
    let longitude =
        (mean_longitude + 1.915 * anomaly.sin() + 0.020 * (2.0 * anomaly).sin()).to_radians();
    let obliquity = (23.439 - 4e-7 * days).to_radians();
    let ascension = (obliquity.cos() * longitude.sin()).atan2(longitude.cos()).to_degrees();
    let declination = (obliquity.sin() * longitude.sin()).asin().to_degrees();
    // Greenwich mean sidereal time.
    let sidereal = 280.460_618_37 + 360.985_647_366_29 * days;
    (ascension - sidereal, declination)
}

/// East longitude and declination in degrees.
fn over_mars(days: f64) -> (f64, f64) {
    let anomaly = (19.387 + 0.524_020_75 * days).to_radians();
    let mean = 270.3863 + 0.524_038_40 * days;
    let perturbations: f64 = [
        (0.0071, 2.2353, 49.409),
        (0.0057, 2.7543, 168.173),
        (0.0039, 1.1177, 191.837),
        (0.0037, 15.7866, 21.736),
        (0.0021, 2.1354, 15.704),
        (0.0020, 2.4694, 95.528),
        (0.0018, 32.8493, 49.095),
    ]
    .iter()
    .map(|&(size, years, phase)| size * (0.985_626_f64 * days / years + phase).to_radians().cos())
    .sum();
    let center = (10.691 + 3.0e-7 * days) * anomaly.sin()
        + 0.623 * (2.0 * anomaly).sin()
        + 0.050 * (3.0 * anomaly).sin()
        + 0.005 * (4.0 * anomaly).sin()
        + 0.0005 * (5.0 * anomaly).sin()
        + perturbations;
    let solar = (mean + center).to_radians();
    let equation_of_time = 2.861 * (2.0 * solar).sin() - 0.071 * (4.0 * solar).sin()
        + 0.002 * (6.0 * solar).sin()
        - center;
    // Mean solar time at the prime meridian, from the Mars sol date; 64.2 to 69.2 s from UTC.
    let terrestrial = days + 66.7 / 86_400.0;
    let sols = (terrestrial - 4.5) / 1.027_491_251_7 + 44_796.0 - 0.000_962_6;
    let west = 360.0 * sols.rem_euclid(1.0) + equation_of_time + 180.0;
    let declination = (0.425_65 * solar.sin()).asin().to_degrees() + 0.25 * solar.sin();
    (-west, declination)
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Meters;

    fn over(body: &Ellipsoid, time: &str) -> (f64, f64) {
        let place = subsolar(body, days_of_utc(time).unwrap()).unwrap();
        (Degrees::from(place.longitude).0, Degrees::from(place.latitude).0)
    }

    #[test]
    fn days_count_over_leap_years() {
        assert_eq!(days_of_utc("2000-03-01T12:00:00Z"), Some(60.0));
        assert_eq!(days_of_utc("2001-01-01T12:00"), Some(366.0));
        assert_eq!(days_of_utc("1999-12-31T12:00:00"), Some(-1.0));
        assert_eq!(days_of_utc("2000-02-29T12:00:00"), Some(59.0));
        for text in ["", "2000", "2000-13-01", "2000-01-01T25:00", "2000-01-01T10:99", "2026-02-29"]
        {
            assert_eq!(days_of_utc(text), None, "{text}");
        }
    }

    /// Equinoxes and solstices of the *Astronomical Almanac*, and the equation of time there.
    #[test]
    fn the_seasons_of_the_earth_come_when_they_do() {
        let earth = Ellipsoid::WGS84;
        for (time, declination) in [
            ("2024-03-20T03:06:00Z", 0.0),
            ("2024-06-20T20:51:00Z", 23.44),
            ("2024-09-22T12:44:00Z", 0.0),
            ("2024-12-21T09:20:00Z", -23.44),
        ] {
            assert!((over(&earth, time).1 - declination).abs() < 0.02, "{time}");
        }
        // On 3 November sundials are 16 min 25 s ahead: at 12:00 UTC the sun is as far west.
        let (longitude, _) = over(&earth, "2024-11-03T12:00:00Z");
        assert!((longitude - -16.42 / 4.0).abs() < 0.05, "{longitude}");
    }

    /// The worked example of Allison and `McEwen` 2000 as NASA GISS gives it for Mars24:
    /// 2000-01-06 00:00 UTC: subsolar longitude 174.726° west, declination -25.2°.
    #[test]
    fn the_sun_over_mars_is_that_of_the_worked_example() {
        let mars = Ellipsoid::sphere(Meters(3_396_190.0)).unwrap();
        let (longitude, declination) = over(&mars, "2000-01-06T00:00:00Z");
        assert!((turned(longitude + 174.726)).abs() < 0.3, "{longitude}");
        assert!((declination + 25.2).abs() < 0.3, "{declination}");
    }
}
