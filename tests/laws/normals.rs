//! Normals made of heights by the command line, against the gradient of an analytic planet, and against
//! the laws.

use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use areoid_formats::grid::TexelPoint;
use areoid_formats::normal::normal_from_codes;
use areoid_formats::page::{Kind, Page, Texels};
use tempfile::TempDir;

use crate::support::areoid::{areoid_json, assert_verified, heights, ingest, only_archive};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Raster, pixel_center, planet};

/// Steeper than any planet, so that normals say something: up to 200 km on Mars.
fn steep(longitude_rad: f64, latitude_rad: f64) -> f64 {
    40.0 * planet(longitude_rad, latitude_rad)
}

const MARS_M: f64 = 3_396_190.0;
const MARS: &str = "+proj=longlat +R=3396190 +no_defs";

type Vector = [f64; 3];

fn scaled(vector: Vector, by: f64) -> Vector {
    vector.map(|component| component * by)
}

fn sum(one: Vector, other: Vector) -> Vector {
    [0, 1, 2].map(|axis| one[axis] + other[axis])
}

fn unit(vector: Vector) -> Vector {
    scaled(vector, 1.0 / vector.iter().map(|component| component * component).sum::<f64>().sqrt())
}

/// The unit normal of the steep planet and that of its sphere: r² times the gradient of r − R − H.
fn exact(longitude: f64, latitude: f64) -> (Vector, Vector) {
    let (sin_latitude, cos_latitude) = latitude.sin_cos();
    let (sin, cos) = longitude.sin_cos();
    let up = [cos_latitude * cos, cos_latitude * sin, sin_latitude];
    let north = [-sin_latitude * cos, -sin_latitude * sin, cos_latitude];
    let east = [-sin, cos, 0.0];
    // Along great circles, where a pole is no special place.
    let height = |along: Vector, angle: f64| {
        let [x, y, z] = sum(scaled(up, angle.cos()), scaled(along, angle.sin()));
        steep(y.atan2(x), z.atan2(x.hypot(y)))
    };
    let slope = |along: Vector| (height(along, 1e-4) - height(along, -1e-4)) / 2e-4;
    let radius = MARS_M + steep(longitude, latitude);
    let tilt = sum(scaled(north, -slope(north) / radius), scaled(east, -slope(east) / radius));
    (unit(sum(up, tilt)), up)
}

/// How far the codes of the finest level are from those of the planet, and how many are held against
/// them; not those on the outline of a map that does not go around.
fn farthest(archive: &Archive) -> (f64, usize) {
    let grid = &archive.description().grid;
    let (pyramid, extent) = (grid.pyramid(), grid.pyramid().extent());
    let (mut largest, mut count) = (0.0_f64, 0);
    for entry in archive.entries().unwrap() {
        if entry.page.level != pyramid.finest() {
            continue;
        }
        let page: Page = archive.page(&entry).unwrap();
        let Texels::Color(texels) = page.texels() else { panic!("normals are codes") };
        let (rows, cols) = pyramid.interior_size(entry.page);
        let [top, left] = [entry.page.row, entry.page.col].map(|index| index * pyramid.interior());
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let (in_row, in_col) = (top + row, left + col);
            let beside = |at: u32, length: u32| at == 0 || at + 1 == length;
            if page.coverage_at(row as usize + 1, col as usize + 1) == 0
                || !extent.wraps && (beside(in_row, extent.height) || beside(in_col, extent.width))
            {
                continue;
            }
            let center = TexelPoint { x: f64::from(in_col) + 0.5, y: f64::from(in_row) + 0.5 };
            let at = grid.geographic_from_texel(pyramid.finest(), center).unwrap();
            let (normal, up) = exact(at.longitude.0, at.latitude.0);
            let codes = texels[(row as usize + 1) * page.side() + col as usize + 1];
            for axis in 0..3 {
                let exact = 128.0 + 127.0 * (normal[axis] - up[axis]);
                largest = largest.max((f64::from(codes[axis]) - exact).abs());
            }
            let read = normal_from_codes(codes.map(f64::from), glam::DVec3::from_array(up));
            let off = read.distance(glam::DVec3::from_array(normal));
            assert!(off < 0.02, "{codes:?} at {at:?} are {off} off {normal:?}");
            count += 1;
        }
    }
    (largest, count)
}

fn globe(size: (usize, usize)) -> Raster {
    let areas = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    Raster::new(areas, size, None, |row, col| {
        let (latitude, longitude) = pixel_center((row, col), size);
        steep(longitude, latitude) as f32
    })
}

/// Half a code for rounding, and a sixth of the square of a degree's 0.0175 times third derivatives of
/// up to 0.07 · 8³ or so, times 127.
const ALLOWED: f64 = 0.5 + 0.25;

#[test]
fn a_planet_has_its_normals_on_its_own_grid_and_on_others() {
    let raster = globe((180, 360));
    let folder = TempDir::new().unwrap();
    let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "planet.tif");
    for (grid, least) in [("native", 180 * 360), ("polar-north", 9000), ("polar-south", 9000)] {
        let catalog = folder.path().join(grid);
        let of_normals = ["--kind", "normal", "--name", "raster", "--crs", MARS];
        ingest(
            &catalog,
            &file,
            &[&of_normals[..], &["--page-size", "66", "--grid", grid]].concat(),
        );
        if grid == "native" {
            assert_verified(&catalog, &file);
        } else {
            let report = areoid_json(&["verify", catalog.to_str().unwrap()]);
            assert_eq!(report["ok"], true, "{report}");
        }
        let archive = only_archive(&catalog);
        let (off, count) = farthest(&archive);
        assert!(count >= least, "{count} texels on {grid}");
        assert!(off > 0.4 && off < ALLOWED, "{off} on {grid}");
    }
}

/// Heights and normals of one file stand beside one another; heights are asked of the heights alone.
#[test]
fn heights_and_their_normals_share_a_catalog() {
    let raster = Raster::new(Place::Region, (50, 70), Some((1.0, 0.0)), |row, col| {
        let is_hole = (row / 5 + col / 7) % 4 == 0;
        if is_hole { f32::NAN } else { (row * row + 3 * col) as f32 }
    });
    let folder = TempDir::new().unwrap();
    let writing = Writing::of(&raster, Samples::Int16(-1));
    let file = writing.write(&raster, folder.path(), "raster.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--page-size", "18"]);
    let before = heights(&catalog, &[[12.0, 3.0], [20.0, -7.0]], &[]);
    let made = ingest(&catalog, &file, &["--page-size", "18", "--kind", "normal"]);
    assert_eq!(made["dataset"], "raster.normal");
    assert_verified(&catalog, &file);
    assert_eq!(heights(&catalog, &[[12.0, 3.0], [20.0, -7.0]], &[]), before);

    let (opened, archives) = Catalog::open_with_archives(&catalog).unwrap();
    assert_eq!(opened.datasets().len(), 2);
    let [of_heights, of_normals] = &archives[..] else { panic!("two archives") };
    assert_eq!(of_normals.description().kind, Kind::Normal);
    // A normal is where a height is, and covers as much.
    for entry in of_heights.entries().unwrap() {
        let twin = of_normals.find(entry.page).unwrap().unwrap();
        let [one, other] =
            [(of_heights, entry), (of_normals, twin)].map(|(of, entry)| of.page(&entry).unwrap());
        assert_eq!(one.coverage(), other.coverage(), "{}", entry.page);
    }
}
