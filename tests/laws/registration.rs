//! Law 5: a texel's center is where the pixel's center was, however a file says where that is.
//!
//! Heights are a ramp in degrees, so a shift of a thousandth of a pixel shows as a thousandth of
//! the ramp from one pixel to the next.

use std::f64::consts::PI;
use std::fs;
use std::path::Path;

use areoid_formats::grid::Outline;
use tempfile::TempDir;

use crate::support::areoid::{heights, ingest};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster, pixel_center};

/// Meters from one pixel to the next, in each direction.
const STEP: f64 = 40.0;

/// A ramp over a region whose first pixel's *center* is at (longitude, latitude), in degrees.
struct Ramp {
    first: [f64; 2],
    pixel: [f64; 2],
    size: (usize, usize),
}

impl Ramp {
    fn height(&self, [longitude, latitude]: [f64; 2]) -> f64 {
        let col = (longitude - self.first[0]) / self.pixel[0];
        let row = (self.first[1] - latitude) / self.pixel[1];
        STEP * col + 2.0 * STEP * row
    }

    fn raster(&self) -> Raster {
        let (rows, cols) = self.size;
        let mut raster = Raster::new(Place::Region, self.size, None, |row, col| {
            (STEP * col as f64 + 2.0 * STEP * row as f64) as f32
        });
        raster.outline = Outline {
            origin: [self.first[0] - self.pixel[0] / 2.0, self.first[1] + self.pixel[1] / 2.0],
            pixel_size: self.pixel,
            width: u32::try_from(cols).unwrap(),
            height: u32::try_from(rows).unwrap(),
        };
        raster
    }

    /// Queries at all centers and in between.
    fn check(&self, catalog: &Path) {
        let (rows, cols) = self.size;
        let at =
            |x: f64, y: f64| [self.first[0] + x * self.pixel[0], self.first[1] - y * self.pixel[1]];
        let centers: Vec<[f64; 2]> = (0..rows * cols)
            .map(|place| at((place % cols) as f64, (place / cols) as f64))
            .collect();
        let mut random = Random(8);
        let between: Vec<[f64; 2]> = (0..500)
            .map(|_| at(random.unit() * (cols - 1) as f64, random.unit() * (rows - 1) as f64))
            .collect();
        let points = [centers, between].concat();
        for (point, found) in points.iter().zip(heights(catalog, &points, &[])) {
            let error = (found.unwrap() - self.height(*point)).abs();
            assert!(error < 1e-3 * STEP, "{point:?} is {} pixels off", error / STEP);
        }
    }
}

const RAMPS: [Ramp; 3] = [
    Ramp { first: [10.25, 50.125], pixel: [0.5, 0.25], size: (37, 53) },
    // Across the antimeridian.
    Ramp { first: [170.3, -10.0], pixel: [0.7, 0.9], size: (41, 29) },
    // Counted eastward past it.
    Ramp { first: [355.0, 89.0], pixel: [0.125, 0.125], size: (30, 90) },
];

#[test]
fn areas_and_points_lie_where_the_file_says() {
    for ramp in RAMPS {
        for points in [false, true] {
            let raster = ramp.raster();
            let writing = Writing { points, ..Writing::of(&raster, Samples::Float32) };
            let folder = TempDir::new().unwrap();
            let file = writing.write(&raster, folder.path(), "ramp.tif");
            let catalog = folder.path().join("catalog");
            ingest(&catalog, &file, &["--page-size", "18"]);
            ramp.check(&catalog);
        }
    }
}

/// The same place on a finer and on a coarser grid, away from the edges, past which there is nothing
/// to go on with.
#[test]
fn a_ramp_on_another_grid_keeps_its_place() {
    let ramp = Ramp { first: [170.3, -10.0], pixel: [0.5, 0.5], size: (81, 71) };
    let raster = ramp.raster();
    let folder = TempDir::new().unwrap();
    let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "ramp.tif");
    let mut random = Random(9);
    let points: Vec<[f64; 2]> =
        (0..500).map(|_| [178.0 + 20.0 * random.unit(), -20.0 - 20.0 * random.unit()]).collect();
    for (at, options) in
        [["--pixel-size-m", "31234"], ["--pixel-size-m", "77777"], ["--grid", "equirectangular"]]
            .into_iter()
            .enumerate()
    {
        for kernel in ["bilinear", "cubic", "lanczos", "spline"] {
            let catalog = folder.path().join(format!("{kernel} {at}"));
            let options = [&options[..], &["--kernel", kernel, "--page-size", "18"]].concat();
            ingest(&catalog, &file, &options);
            for (point, found) in points.iter().zip(heights(&catalog, &points, &[])) {
                let error = (found.unwrap() - ramp.height(*point)).abs();
                assert!(error < 1e-3 * STEP, "{options:?}: {point:?} is {error} m off");
            }
        }
    }
}

/// A ramp on a map of a pole, painted on a globe: on that map's own pixels it is where it was, at the pole
/// and across the antimeridian, too.
#[test]
fn a_ramp_on_a_polar_grid_keeps_its_place() {
    let size = (360, 720);
    let mut random = Random(10);
    for (grid, sign) in [("polar-north", 1.0), ("polar-south", -1.0)] {
        // A pixel at the pole is half a degree, and the plane touches the sphere there.
        let ramp = |longitude: f64, latitude: f64| {
            let from_pole = PI / 2.0 - sign * latitude;
            let pixels = 2.0 * (from_pole / 2.0).tan() / (PI / 360.0);
            STEP * pixels * (longitude.sin() + 0.5 * longitude.cos())
        };
        let globe = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
        let raster = Raster::new(globe, size, None, |row, col| {
            let (latitude, longitude) = pixel_center((row, col), size);
            let is_near = sign * latitude > -0.1;
            if is_near { ramp(longitude, latitude) as f32 } else { 0.0 }
        });
        let folder = TempDir::new().unwrap();
        let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "ramp.tif");
        let mut points: Vec<[f64; 2]> = (0..1000)
            .map(|_| [360.0 * random.unit() - 180.0, sign * (15.0 + 75.0 * random.unit())])
            .collect();
        points.extend((0..100).map(|at| [f64::from(at) * 3.6, sign * 89.9]));
        points.extend((0..100).map(|at| [180.0 - 1e-3 * f64::from(at), sign * 50.0]));
        points.extend((0..100).map(|at| [1e-3 * f64::from(at) - 180.0, sign * 50.0]));
        for kernel in ["cubic", "lanczos", "spline"] {
            let catalog = folder.path().join(kernel);
            let options = ["--grid", grid, "--kernel", kernel, "--page-size", "34"];
            ingest(&catalog, &file, &options);
            for ([longitude, latitude], found) in points.iter().zip(heights(&catalog, &points, &[]))
            {
                let truth = ramp(longitude.to_radians(), latitude.to_radians());
                let error = (found.unwrap() - truth).abs() / STEP;
                assert!(error < 1e-3, "{grid} {kernel}: {longitude}, {latitude} is {error} off");
            }
        }
    }
}

/// A world file gives the center of the first pixel.
#[test]
fn a_picture_lies_where_its_world_file_says() {
    let ramp = Ramp { first: [10.25, 50.125], pixel: [0.5, 0.25], size: (2, 3) };
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("ramp.png");
    let samples: Vec<u8> = ramp.raster().planes[0].iter().map(|&height| height as u8).collect();
    image::GrayImage::from_raw(3, 2, samples).unwrap().save(&file).unwrap();
    fs::write(folder.path().join("ramp.pgw"), "0.5\n0\n0\n-0.25\n10.25\n50.125\n").unwrap();
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--body", "mars", "--kind", "height"]);
    ramp.check(&catalog);
}

#[test]
fn an_extent_on_the_command_line_is_that_of_the_outer_edges() {
    let ramp = Ramp { first: [-9.75, 7.0], pixel: [0.5, 2.0], size: (21, 40) };
    let raster = ramp.raster();
    let writing = Writing { points: true, ..Writing::of(&raster, Samples::Float32) };
    let folder = TempDir::new().unwrap();
    let file = writing.write(&raster, folder.path(), "ramp.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--extent", "-10,-34,10,8"]);
    ramp.check(&catalog);
}

/// Rows on both poles and a column that repeats the first: the posts stay where they are.
#[test]
fn posts_of_a_closed_globe_stay_where_they_are() {
    let place = Place::Globe(Edge::PoleOnPosts, Edge::PoleOnPosts);
    let (rows, cols) = (91, 180);
    let mut random = Random(6);
    let raster = Raster::new(place, (rows, cols), None, |row, _| {
        // At a pole all longitudes are one place.
        let turns = if row == 0 || row == rows - 1 { 0.0 } else { random.unit() };
        (STEP * (row as f64 + turns)) as f32
    });
    for points in [false, true] {
        // The first column of posts is on 0°, the last on 360°.
        let pixel = 360.0 / cols as f64;
        let outline = Outline {
            origin: [-pixel / 2.0, 90.0 + pixel / 2.0],
            pixel_size: [pixel; 2],
            ..raster.outline
        };
        let samples = Samples::Float32;
        let writing = Writing { points, closed: true, outline, projected: None, samples };
        let folder = TempDir::new().unwrap();
        let file = writing.write(&raster, folder.path(), "posts.tif");
        let catalog = folder.path().join("catalog");
        ingest(&catalog, &file, &["--page-size", "34"]);
        for turn in [-360.0, 0.0, 360.0] {
            let posts: Vec<[f64; 2]> = (0..rows * cols)
                .map(|at| [pixel * (at % cols) as f64 + turn, 90.0 - pixel * (at / cols) as f64])
                .collect();
            for (post, (found, sample)) in
                posts.iter().zip(heights(&catalog, &posts, &[]).iter().zip(&raster.planes[0]))
            {
                let error = (found.unwrap() - f64::from(*sample)).abs();
                assert!(error < 1e-3 * STEP, "{post:?} is {} pixels off", error / STEP);
            }
        }
    }
}
