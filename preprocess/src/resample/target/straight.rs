//! Grids on maps of straight meridians.

use std::f64::consts::{PI, TAU};

use areoid_formats::grid::{Grid, GridError};
use areoid_formats::projection::{Crs, Equirectangular, Pole, Projection};
use areoid_formats::pyramid::{Extent, PoleContact, PyramidError};

use super::area::Area;
use super::{ROUNDING_PX, TargetError, whole};

/// A grid on a map of straight meridians.
pub(super) fn straight(
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
