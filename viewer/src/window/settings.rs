//! What the user of a window may set.

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::units::Degrees;
use glam::DVec3;

use super::arrangement::Arrangement;
use crate::Atmosphere;
use crate::render::{Debug, Light, Options, Relief};
use crate::style::{Layer, Ramp, Stop, Style};
use crate::sun::{days_of_utc, subsolar};

/// How the picture is lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lighting {
    /// From over the left shoulder.
    Headlamp,
    /// From the sun, wherever it is put.
    Sun,
    /// From the northwest everywhere.
    Relief,
}

/// Everything that the panel changes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Settings {
    pub(super) tolerance_px: f64,
    pub(super) exaggeration: f64,
    pub(super) exposure: f64,
    pub(super) lighting: Lighting,
    /// Longitude and latitude in degrees.
    pub(super) sun: [f64; 2],
    /// Azimuth and elevation in degrees.
    pub(super) relief: [f64; 2],
    pub(super) has_air: bool,
    pub(super) has_ramp: bool,
    pub(super) style: Style,
    pub(super) debug: Debug,
    pub(super) arrangement: Arrangement,
}

impl Settings {
    pub(super) fn new(tolerance_px: f64, style: Style) -> Self {
        Self {
            tolerance_px,
            exaggeration: 1.0,
            exposure: 1.0,
            lighting: Lighting::Headlamp,
            sun: [0.0, 0.0],
            relief: [315.0, 45.0],
            has_air: false,
            has_ramp: style.ramp.is_some(),
            style,
            debug: Debug::Off,
            arrangement: Arrangement::Single,
        }
    }

    /// The light on what an eye of this orientation, over this place, sees.
    pub(super) fn light(&self, focus: Geographic, right: DVec3, up: DVec3) -> Light {
        let toward_sun = match self.lighting {
            Lighting::Sun => {
                let [longitude, latitude] = self.sun.map(Degrees);
                surface_normal(Geographic::from_degrees(longitude, latitude))
            }
            _ => surface_normal(focus) - 0.7 * right + 0.5 * up,
        };
        Light { toward_sun, ambient: Light::AMBIENT }
    }

    /// How to draw at a time.
    pub(super) fn options(&self, body: &Ellipsoid, seconds: f64) -> Options {
        let is_relief = self.lighting == Lighting::Relief;
        let style = Style { ramp: self.ramp(), ..self.style.clone() };
        Options {
            vertical_exaggeration: self.exaggeration,
            style,
            atmosphere: if self.has_air { Atmosphere::of(body) } else { None },
            relief: is_relief.then(|| Relief::from_degrees(self.relief)),
            exposure: self.exposure,
            debug: self.debug,
            seconds,
            ..Options::interactive()
        }
    }

    /// The colors of heights, if they are shown.
    pub(super) fn ramp(&self) -> Option<Ramp> {
        self.has_ramp.then(|| self.style.ramp.clone().unwrap_or_else(ramp))
    }

    /// Puts the sun where it stands over `body` at a time.
    ///
    /// # Errors
    ///
    /// A sentence for the user.
    pub(super) fn set_date(&mut self, text: &str, body: &Ellipsoid) -> Result<(), &'static str> {
        let days = days_of_utc(text).ok_or("no date: YYYY-MM-DD, or YYYY-MM-DDTHH:MM:SS in UTC")?;
        let sun = subsolar(body, days).ok_or("dates are known of the Earth and Mars alone")?;
        self.sun = [sun.longitude, sun.latitude].map(|angle| Degrees::from(angle).0);
        Ok(())
    }

    /// What is said of a dataset.
    pub(super) fn layer(&self, dataset: &str) -> Layer {
        let layer = self.style.layer(dataset).cloned().unwrap_or(Layer::of(dataset));
        Layer { dataset: dataset.to_owned(), ..layer }
    }

    /// Says it, instead of what was said of the parts.
    pub(super) fn set_layer(&mut self, layer: Layer, parts: &[&str]) {
        let is_meant = |name: &str| name == layer.dataset || parts.contains(&name);
        self.style.layers.retain(|other| !is_meant(&other.dataset));
        self.style.layers.push(layer);
    }
}

/// Dark blue to white over the heights of planets.
pub(super) fn ramp() -> Ramp {
    let stop = |height_m, color| Stop { height_m, color };
    let stops = vec![
        stop(-8000.0, [24, 26, 90]),
        stop(-3000.0, [40, 110, 160]),
        stop(0.0, [70, 150, 90]),
        stop(3000.0, [210, 190, 110]),
        stop(9000.0, [170, 90, 50]),
        stop(20_000.0, [250, 250, 250]),
    ];
    Ramp { stops, opacity: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::body::Body;

    #[test]
    fn a_date_puts_the_sun_where_it_stood_and_what_is_none_leaves_it() {
        let mut settings = Settings::new(1.0, Style::default());
        let body = |name| Body::parse(name).unwrap().ellipsoid;
        // At an equinox at noon in Greenwich, give or take the equation of time.
        settings.set_date("2000-03-20T12:00:00", &body("earth")).unwrap();
        assert!(settings.sun[0].abs() < 4.0 && settings.sun[1].abs() < 0.3, "{:?}", settings.sun);
        let before = settings.sun;
        assert!(settings.set_date("soon", &body("earth")).unwrap_err().contains("no date"));
        assert!(settings.set_date("2000-03-20", &body("moon")).unwrap_err().contains("Mars"));
        assert_eq!(settings.sun, before);
    }

    #[test]
    fn parts_follow_what_is_said_of_their_group_and_nothing_else_does() {
        let weight = |dataset: &str, weight| Layer { weight, ..Layer::of(dataset) };
        let layers = vec![weight("mola.north", 0.2), weight("mola.x", 0.3), weight("mola", 0.4)];
        let mut settings = Settings::new(1.0, Style { layers, ramp: None });
        settings.set_layer(weight("mola", 0.9), &["mola.band", "mola.north"]);
        let weight_of = |name: &str| settings.layer(name).weight;
        assert_eq!(["mola", "mola.north", "mola.band"].map(weight_of), [0.9; 3]);
        assert_eq!(weight_of("mola.x"), 0.3);
    }
}
