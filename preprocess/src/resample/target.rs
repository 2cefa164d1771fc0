//! The grid that sources are resampled to.
//!
//! ```text
//!   outlines of the sources ──▶ their rims on the target's map ──▶ whole pixels ──▶ even widths
//! ```
//!
//! Texels are as large as the finest source's pixels where its map is truest, or as asked, and
//! square. What goes around the body does so in a width that halves down to a pyramid's root, which
//! makes texels a little smaller. Edges on a pole are outlines: no texel's center lies there.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::{Grid, GridError, Placement};
use areoid_formats::projection::{
    Crs, Equirectangular, PolarScale, PolarStereographic, Pole, Projection,
};
use areoid_formats::pyramid::{Extent, PoleContact, PyramidError};
use areoid_formats::units::{Meters, Radians};

/// The map that texels lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetMap {
    /// The first source's.
    Native,
    /// Meridians and parallels as straight lines, to scale at the equator.
    Equirectangular,
    /// A hemisphere about a pole, to scale there.
    Polar(Pole),
}

/// What is asked of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetRequest {
    /// Its map.
    pub map: TargetMap,
    /// Ground meters to a texel where the map is truest; the finest source's if `None`.
    pub pixel_size: Option<Meters>,
    /// Texels along a page's side, border included.
    pub page_side: u32,
}

/// Why there is no target.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TargetError {
    /// No source.
    #[error("no raster to resample")]
    Empty,
    /// A size that texels cannot have.
    #[error("a texel of {0} m is not supported: expected a positive number")]
    PixelSize(f64),
    /// Sources that have no place on the map.
    #[error("the rasters show nothing of the hemisphere of the map")]
    NothingShown,
    /// The size makes no pyramid.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// Widths and heights a whole number of pixels to this accuracy are that number.
const ROUNDING_PX: f64 = 1e-6;

/// The grid for `sources` that `request` asks for.
///
/// # Errors
///
/// Any [`TargetError`].
pub fn target_grid(sources: &[Placement], request: TargetRequest) -> Result<Grid, TargetError> {
    let first = sources.first().ok_or(TargetError::Empty)?;
    let body = first.crs.body;
    let finest =
        sources.iter().map(|source| source.nominal_pixel().0).fold(f64::INFINITY, f64::min);
    let pixel_m = request.pixel_size.map_or(finest, |size| size.0);
    if !(pixel_m > 0.0 && pixel_m.is_finite()) {
        return Err(TargetError::PixelSize(pixel_m));
    }
    let crs = match request.map {
        TargetMap::Native if request.pixel_size.is_none() && sources.len() == 1 => {
            let Placement { crs, origin, pixel_size, .. } = *first;
            return Ok(Grid::new(crs, origin, pixel_size, first.extent(), request.page_side)?);
        }
        TargetMap::Native => first.crs,
        TargetMap::Equirectangular => {
            Crs::new(Projection::Equirectangular(Equirectangular::default()), body)
        }
        TargetMap::Polar(pole) => {
            let map = PolarStereographic {
                pole,
                central_meridian: Radians(0.0),
                scale: PolarScale::AtPole(1.0),
                false_easting: Meters(0.0),
                false_northing: Meters(0.0),
            };
            Crs::new(Projection::PolarStereographic(map), body)
        }
    };

    let mut area = Area::NONE;
    for source in sources {
        area = area.with(Area::of(source, &crs));
    }
    if area.is_empty() {
        return Err(TargetError::NothingShown);
    }
    match crs.wraps_with_period() {
        Some(period) => {
            let pixel = pixel_m * period / (TAU * crs.ellipsoid.a().0);
            straight(crs, area, pixel, period, request.page_side)
        }
        None => flat(crs, area, pixel_m, request.page_side),
    }
}

/// A rectangle of a map; around the body where it is as wide as a turn.
#[derive(Clone, Copy, Debug)]
struct Area {
    left: f64,
    right: f64,
    bottom: f64,
    top: f64,
}

/// Samples along an edge of an outline. Between two of them a rim of 10⁵ pixels bends by 10⁻² of
/// one.
const SAMPLES: u32 = 4096;

impl Area {
    const NONE: Self = Self {
        left: f64::INFINITY,
        right: f64::NEG_INFINITY,
        bottom: f64::INFINITY,
        top: f64::NEG_INFINITY,
    };

    fn is_empty(&self) -> bool {
        self.left > self.right || self.bottom > self.top
    }

    fn with(self, other: Self) -> Self {
        Self {
            left: self.left.min(other.left),
            right: self.right.max(other.right),
            bottom: self.bottom.min(other.bottom),
            top: self.top.max(other.top),
        }
    }

    fn with_point(self, x: f64, y: f64) -> Self {
        self.with(Self { left: x, right: x, bottom: y, top: y })
    }

    /// What of the map of `crs` a source shows: from its rim, and the poles inside it.
    fn of(source: &Placement, crs: &Crs) -> Self {
        if *crs == source.crs {
            let [left, top] = source.origin;
            let [width, height] = [
                f64::from(source.width) * source.pixel_size[0],
                f64::from(source.height) * source.pixel_size[1],
            ];
            return Self { left, right: left + width, bottom: top - height, top }.within_poles(crs);
        }
        let center = match &crs.projection {
            Projection::PolarStereographic(map) => Some(map.pole),
            _ => None,
        };
        let period = crs.wraps_with_period();
        let mut area = Self::NONE;
        let mut last_x: Option<f64> = None;
        for position in rim(source) {
            let Some(point) = crs.project(onto_hemisphere(position, center)) else { continue };
            let mut x = point.x;
            // Around the body from sample to sample, the shorter way.
            if let (Some(period), Some(last)) = (period, last_x) {
                x -= period * ((x - last) / period).round();
            }
            last_x = Some(x);
            area = area.with_point(x, point.y);
        }
        for pole in [Pole::North, Pole::South] {
            if !shows(source, pole) || center.is_some_and(|center| center != pole) {
                continue;
            }
            let latitude = Radians(pole.sign() * FRAC_PI_2);
            if let Some(point) = crs.project(Geographic { latitude, ..Geographic::default() }) {
                let x = if period.is_some() { area.left } else { point.x };
                area = area.with_point(x, point.y);
            }
            if let Some(period) = period {
                area.right = area.left + period;
            }
        }
        if let Some(period) = period.filter(|_| source.wraps) {
            area.right = area.left + period;
        }
        if center.is_some_and(|pole| !reaches_hemisphere(source, pole)) {
            return Self::NONE;
        }
        area
    }

    fn within_poles(self, crs: &Crs) -> Self {
        let top = crs.y_of_pole(Pole::North).map_or(self.top, |y| y.min(self.top));
        let bottom = crs.y_of_pole(Pole::South).map_or(self.bottom, |y| y.max(self.bottom));
        Self { top, bottom, ..self }
    }
}

/// Positions along the outline of a source, around it once. An outline past a pole or the end of
/// its map has none there.
fn rim(source: &Placement) -> impl Iterator<Item = Geographic> + '_ {
    let (right, bottom) = (f64::from(source.width) - 0.5, f64::from(source.height) - 0.5);
    let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom), (-0.5, -0.5)];
    let sides = corners.into_iter().zip(corners.into_iter().skip(1));
    sides.flat_map(move |((u, v), (to_u, to_v))| {
        (0..SAMPLES).filter_map(move |at| {
            let share = f64::from(at) / f64::from(SAMPLES);
            let (u, v) = (u + (to_u - u) * share, v + (to_v - v) * share);
            let mut point = source.map_from_pixel(u, v);
            // Posts on a pole reach half a row past it.
            for pole in [Pole::North, Pole::South] {
                if let Some(y) = source.crs.y_of_pole(pole) {
                    point.y = pole.sign() * (pole.sign() * point.y).min(pole.sign() * y);
                }
            }
            source.crs.unproject(point)
        })
    })
}

/// A position, or that on the equator below it where it lies beyond.
fn onto_hemisphere(position: Geographic, center: Option<Pole>) -> Geographic {
    let Some(pole) = center else { return position };
    let latitude = pole.sign() * (pole.sign() * position.latitude.0).max(0.0);
    Geographic { latitude: Radians(latitude), ..position }
}

/// Whether any of the source is on the pole's side of the equator.
fn reaches_hemisphere(source: &Placement, pole: Pole) -> bool {
    shows(source, pole) || rim(source).any(|it| pole.sign() * it.latitude.0 > 1e-9)
}

/// Whether a pole lies in the outline of a source.
fn shows(source: &Placement, pole: Pole) -> bool {
    if source.crs.wraps_with_period().is_some() {
        let contact = if pole == Pole::North { source.north } else { source.south };
        return contact != PoleContact::None;
    }
    let latitude = Radians(pole.sign() * FRAC_PI_2);
    let Some(point) = source.crs.project(Geographic { latitude, ..Geographic::default() }) else {
        return false;
    };
    let (u, v) = source.pixel_from_map(point);
    (-0.5..=f64::from(source.width) - 0.5).contains(&u)
        && (-0.5..=f64::from(source.height) - 0.5).contains(&v)
}

/// A grid on a map of straight meridians.
fn straight(
    crs: Crs,
    area: Area,
    pixel: f64,
    period: f64,
    page_side: u32,
) -> Result<Grid, TargetError> {
    let y_of = |pole| crs.y_of_pole(pole).expect("maps of straight meridians draw poles");
    let (north, south) = (y_of(Pole::North), y_of(Pole::South));
    // Along meridians a map has its own scale: two right angles are so long.
    let per_x = (north - south) / PI * TAU / period;
    if area.right - area.left < period * (1.0 - ROUNDING_PX) {
        let pixel_y = pixel * per_x;
        let left = (area.left / pixel + ROUNDING_PX).floor() * pixel;
        let top = north - ((north - area.top) / pixel_y + ROUNDING_PX).floor() * pixel_y;
        let most = ((north - south) / pixel_y).round();
        let rows = whole(((top - area.bottom) / pixel_y).min(most))?;
        let extent = Extent {
            width: whole((area.right - left) / pixel)?,
            height: rows,
            wraps: false,
            north: PoleContact::None,
            south: PoleContact::None,
        };
        return Ok(Grid::new(crs, [left, top], [pixel, pixel_y], extent, page_side)?);
    }

    let mut width = whole(period / pixel)?;
    loop {
        let pixel = period / f64::from(width);
        match around(crs, area, width, [pixel, pixel * per_x], page_side) {
            Err(TargetError::Grid(GridError::Pyramid(PyramidError::Uneven {
                next_width, ..
            }))) if next_width > u64::from(width) => {
                width =
                    u32::try_from(next_width).map_err(|_| GridError::PixelSize(pixel, pixel))?;
            }
            made => return made,
        }
    }
}

/// A grid of `width` columns around the body that covers the rows of `area`.
fn around(
    crs: Crs,
    area: Area,
    width: u32,
    [pixel_x, pixel_y]: [f64; 2],
    page_side: u32,
) -> Result<Grid, TargetError> {
    let y_of = |pole| crs.y_of_pole(pole).expect("maps of straight meridians draw poles");
    let (north_y, south_y) = (y_of(Pole::North), y_of(Pole::South));
    let rows_of = |y: f64| (north_y - y) / pixel_y;
    // Within half a row of a pole the grid reaches it.
    let all = whole(rows_of(south_y))?;
    let mut first = (rows_of(area.top) + ROUNDING_PX).floor().max(0.0);
    let mut last = (rows_of(area.bottom) - ROUNDING_PX).ceil().min(f64::from(all));
    if rows_of(area.top) < 0.5 {
        first = 0.0;
    }
    if rows_of(area.bottom) > f64::from(all) - 0.5 {
        last = f64::from(all);
    }
    let contact = |reached| if reached { PoleContact::Outline } else { PoleContact::None };
    let (north, south) = (contact(first == 0.0), contact(last == f64::from(all)));
    let height = whole(last - first)?;
    // Rows that end at the south pole halve down to it: more of them, upward.
    let mut refused = None;
    for halvings in 0..32 {
        let height = height.div_ceil(1 << halvings).saturating_mul(1 << halvings);
        if height > all {
            break;
        }
        let north = if height == all { contact(true) } else { north };
        let first = if south == PoleContact::None { first } else { f64::from(all - height) };
        let north = if first == 0.0 { north } else { PoleContact::None };
        let extent = Extent { width, height, wraps: true, north, south };
        let origin = [west(&crs, area), north_y - first * pixel_y];
        match Grid::new(crs, origin, [pixel_x, pixel_y], extent, page_side) {
            Err(error @ GridError::Pyramid(PyramidError::Uneven { .. })) => {
                refused = refused.or(Some(error));
            }
            made => return Ok(made?),
        }
        if south == PoleContact::None {
            break;
        }
    }
    Err(refused.unwrap_or(GridError::OutsideProjection).into())
}

/// The west end of a whole turn: the sources' own on their map, else half a turn west of the
/// central meridian.
fn west(crs: &Crs, area: Area) -> f64 {
    match &crs.projection {
        Projection::Equirectangular(map) if *map == Equirectangular::default() => {
            -crs.wraps_with_period().unwrap_or(0.0) / 2.0
        }
        _ => area.left,
    }
}

/// A grid on a map that does not go around the body.
fn flat(crs: Crs, area: Area, pixel: f64, page_side: u32) -> Result<Grid, TargetError> {
    let left = (area.left / pixel + ROUNDING_PX).floor() * pixel;
    let top = (area.top / pixel - ROUNDING_PX).ceil() * pixel;
    let extent = Extent {
        width: whole((area.right - left) / pixel)?,
        height: whole((top - area.bottom) / pixel)?,
        wraps: false,
        north: PoleContact::None,
        south: PoleContact::None,
    };
    Ok(Grid::new(crs, [left, top], [pixel; 2], extent, page_side)?)
}

/// A number of pixels rounded up, at least 1.
fn whole(pixels: f64) -> Result<u32, TargetError> {
    let up = (pixels - ROUNDING_PX).ceil().max(1.0);
    if up.is_nan() || up > f64::from(u32::MAX) {
        return Err(GridError::PixelSize(pixels, pixels).into());
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
    Ok(up as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::body::Body;
    use areoid_formats::grid::Outline;

    fn request(map: TargetMap, pixel_m: Option<f64>) -> TargetRequest {
        TargetRequest { map, pixel_size: pixel_m.map(Meters), page_side: 512 }
    }

    fn degrees(origin: [f64; 2], pixel: f64, width: u32, height: u32) -> Placement {
        let crs = Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid);
        let outline = Outline { origin, pixel_size: [pixel; 2], width, height };
        Placement::from_outline(crs, outline).unwrap()
    }

    fn polar(pole: Pole, half: u32, pixel: f64) -> Placement {
        let map = PolarStereographic {
            pole,
            central_meridian: Radians(0.0),
            scale: PolarScale::AtPole(1.0),
            false_easting: Meters(0.0),
            false_northing: Meters(0.0),
        };
        let body = Body::parse("mars").unwrap().ellipsoid;
        let edge = f64::from(half) * pixel;
        let outline = Outline {
            origin: [-edge, edge],
            pixel_size: [pixel; 2],
            width: 2 * half,
            height: 2 * half,
        };
        let crs = Crs::new(Projection::PolarStereographic(map), body);
        Placement::from_outline(crs, outline).unwrap()
    }

    /// Every pixel's center of a source lies in the target, a whole pixel inside its edges at most.
    fn covers(grid: &Grid, source: &Placement) {
        let finest = grid.pyramid().finest();
        for at in 0..=64 {
            for end in [0.0, 1.0] {
                let share = f64::from(at) / 64.0;
                for (u, v) in [(share, end), (end, share)] {
                    let u = u * (f64::from(source.width) - 1.0);
                    let v = v * (f64::from(source.height) - 1.0);
                    let position = source.crs.unproject(source.map_from_pixel(u, v)).unwrap();
                    assert!(grid.locate(finest, position).is_some(), "{u} {v} {position:?}");
                }
            }
        }
    }

    #[test]
    fn an_uneven_globe_gets_the_next_even_width() {
        let globe = degrees([-180.0, 90.0], 360.0 / 106_694.0, 106_694, 53_347);
        let grid = target_grid(&[globe], request(TargetMap::Equirectangular, None)).unwrap();
        let extent = grid.pyramid().extent();
        assert_eq!((extent.width, extent.height), (106_752, 53_376));
        assert_eq!((extent.north, extent.south), (PoleContact::Outline, PoleContact::Outline));
        covers(&grid, &globe);
    }

    #[test]
    fn a_cap_becomes_a_band_around_the_body_that_ends_at_its_pole() {
        for pole in [Pole::North, Pole::South] {
            let cap = polar(pole, 2048, 500.0);
            let grid = target_grid(&[cap], request(TargetMap::Equirectangular, None)).unwrap();
            let extent = grid.pyramid().extent();
            let reached = [extent.north, extent.south].map(|it| it == PoleContact::Outline);
            assert!(extent.wraps && reached == [pole == Pole::North, pole == Pole::South]);
            // Square pixels, the last of an even width smaller by a little.
            let [x, y] = grid.pixel_size();
            assert!((x - y).abs() < 1e-9 && x <= 500.0 && x > 470.0, "{x} {y}");
            covers(&grid, &cap);
        }
    }

    #[test]
    fn a_globe_becomes_a_hemisphere_about_a_pole() {
        let globe = degrees([-180.0, 90.0], 0.125, 2880, 1440);
        let grid = target_grid(&[globe], request(TargetMap::Polar(Pole::South), Some(5000.0)));
        let extent = grid.unwrap().pyramid().extent();
        // The equator is two radii from the pole.
        let across = 2717;
        assert!(extent.width.abs_diff(across) <= 1 && extent.height.abs_diff(across) <= 1);
    }

    #[test]
    fn a_region_over_the_antimeridian_stays_one() {
        let region = degrees([170.0, 20.0], 0.1, 200, 100);
        let grid = target_grid(&[region], request(TargetMap::Equirectangular, None)).unwrap();
        let extent = grid.pyramid().extent();
        assert!(!extent.wraps && (200..=201).contains(&extent.width));
        assert!((100..=101).contains(&extent.height), "{extent:?}");
        covers(&grid, &region);
        let grid = target_grid(&[region], request(TargetMap::Polar(Pole::North), None)).unwrap();
        covers(&grid, &region);
    }

    #[test]
    fn the_native_grid_is_kept_or_made_coarser_from_its_corner() {
        let region = degrees([350.0, 20.0], 0.1, 200, 100);
        let same = target_grid(&[region], request(TargetMap::Native, None)).unwrap();
        assert_eq!((same.origin(), same.pixel_size()), ([350.0, 20.0], [0.1; 2]));
        let twice = 2.0 * region.nominal_pixel().0;
        let grid = target_grid(&[region], request(TargetMap::Native, Some(twice))).unwrap();
        let extent = grid.pyramid().extent();
        assert_eq!((extent.width, extent.height), (100, 50));
        covers(&grid, &region);
    }

    #[test]
    fn what_makes_no_target_is_refused() {
        let south = degrees([0.0, -20.0], 0.1, 200, 100);
        let map = TargetMap::Polar(Pole::North);
        assert_eq!(target_grid(&[south], request(map, None)), Err(TargetError::NothingShown));
        assert_eq!(target_grid(&[], request(map, None)), Err(TargetError::Empty));
        let flat = target_grid(&[south], request(map, Some(0.0)));
        assert_eq!(flat, Err(TargetError::PixelSize(0.0)));
    }
}
