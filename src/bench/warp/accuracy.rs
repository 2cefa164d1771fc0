//! How far resampled waves are from the waves.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fs;
use std::io;
use std::path::Path;
use std::process::Stdio;

use areoid_preprocess::raster::{self, ReadOptions, Samples};
use rayon::prelude::*;
use serde::Serialize;

use super::ways::{Direction, Program, Way};
use crate::bench::geotiff::{Blocks, Format, Place};
use crate::bench::ingest::Setting;
use crate::bench::waves::{Position, STRENGTH_M, Waves};

/// Wavelengths, in pixels of the source where they are largest.
pub(super) const WAVELENGTHS_PX: [f64; 5] = [273.0, 16.0, 8.0, 4.0, 2.5];

/// Where errors are summed up.
pub(super) const ZONES: [&str; 3] = ["elsewhere", "pole", "antimeridian"];
const SEAM: usize = 2;

/// So near a pole is at the pole, in degrees.
const POLE_DEG: f64 = 2.0;

/// So near ±180° is at the antimeridian, in pixels of the source.
const SEAM_PX: f64 = 8.0;

/// Places like that at the pole, in degrees: as large, about these parallels, so far apart along them.
const LIKE_POLE_DEG: ([f64; 8], f64) = ([86.0, 80.0, 70.0, 60.0, 50.0, 40.0, 30.0, 20.0], 45.0);

/// The meridian that a quarter of a turn carries the antimeridian to, in radians. It carries maps and
/// pixels over into themselves: of a field turned with them, errors are to be the same there.
const LIKE_SEAM: f64 = -FRAC_PI_2;

/// Errors of a zone, in percent of the signal's strength; the mean of no texels is NaN.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Errors {
    pub(super) rms: f64,
    pub(super) max: f64,
    /// The largest root mean square of a place like the pole elsewhere, or that at the meridian that lies like
    /// the antimeridian, of a field that lies there as it does here; NaN of elsewhere itself, and of other
    /// programs' antimeridian.
    pub(super) like_it: f64,
    pub(super) texels: u64,
    /// Texels without a value where the source has data all around.
    pub(super) missing: u64,
}

/// Errors by wavelength and zone.
pub(super) type ByWave = [[Errors; ZONES.len()]; WAVELENGTHS_PX.len()];

/// Runs each way over waves of each length; `None` of programs that are not there.
pub(super) fn measure(
    setting: &Setting,
    direction: &Direction,
    ways: &[Way],
) -> io::Result<Vec<Option<ByWave>>> {
    let folder = setting.work().join("waves");
    fs::create_dir_all(&folder)?;
    let mut all: Vec<Option<ByWave>> = vec![Some(ByWave::default()); ways.len()];
    let (raster, out) = (folder.join("waves.tif"), folder.join("out.tif"));
    for (at, &wavelength) in WAVELENGTHS_PX.iter().enumerate() {
        let (place, size) = direction.source;
        let waves = Waves::new(wavelength * place.pixel_rad(size));
        for (is_turned, waves) in [(false, waves.clone()), (true, waves.turned())] {
            write(&raster, direction.source, &waves)?;
            let truth = Truth::new(direction, &waves);
            for (&way, found) in ways.iter().zip(&mut all) {
                if is_turned && way.program != Program::Areoid {
                    continue;
                }
                let command = direction.command(setting, way, &raster, &out);
                let (Some(mut command), Some(found)) = (command, found.as_mut()) else {
                    *found = None;
                    continue;
                };
                let done = command.stdin(Stdio::null()).stdout(Stdio::null()).status()?;
                if !done.success() {
                    return Err(io::Error::other(format!("{} failed", way.name())));
                }
                let samples = match way.program {
                    Program::Areoid => headerless(&fs::read(&out)?),
                    Program::GdalWarp | Program::Python => tiff(&out, direction.target.1)?,
                };
                fs::remove_file(&out)?;
                if is_turned {
                    found[at][SEAM].like_it = truth.like_the_seam(&samples);
                } else {
                    found[at] = truth.errors(way.program, &samples);
                }
            }
        }
    }
    fs::remove_dir_all(&folder)?;
    Ok(all)
}

/// A raster of waves, floating point.
#[expect(clippy::cast_possible_truncation, reason = "rounded as it is stored")]
fn write(
    path: &Path,
    (place, (width, height)): (Place, (u32, u32)),
    waves: &Waves,
) -> io::Result<()> {
    let format = Format {
        width,
        height,
        bands: 1,
        sample_bytes: 4,
        missing: None,
        place,
        blocks: Blocks::Tiles(512),
    };
    format.write(path, |rows| {
        let row = |row: u32| {
            let heights = (0..width).map(move |col| place.position((width, height), row, col));
            let heights = heights.map(|position| waves.at(position.vector()));
            heights.flat_map(|height| (height as f32).to_le_bytes()).collect::<Vec<u8>>()
        };
        rows.into_par_iter().map(row).collect::<Vec<_>>().concat()
    })
}

/// What a target should be.
struct Truth {
    heights: Vec<f64>,
    places: Vec<At>,
}

/// Where a texel is.
#[derive(Clone, Copy)]
struct At {
    /// In [`ZONES`]; past it where the source need not show anything.
    zone: u8,
    /// Elsewhere: which place like the pole it is in, if any.
    like_pole: Option<u8>,
    like_seam: bool,
}

impl Truth {
    fn new(direction: &Direction, waves: &Waves) -> Self {
        let (place, (width, height)) = direction.target;
        let (source, size) = direction.source;
        let seam = SEAM_PX * source.pixel_rad(size);
        let poles = &like_the_pole();
        let texels = (0..height).into_par_iter().flat_map_iter(|row| {
            (0..width).map(move |col| {
                let position = place.position((width, height), row, col);
                (waves.at(position.vector()), at(position, seam, poles))
            })
        });
        let (heights, places) = texels.unzip();
        Self { heights, places }
    }

    fn errors(&self, program: Program, samples: &[f32]) -> [Errors; ZONES.len()] {
        assert_eq!(samples.len(), self.heights.len(), "as many samples as the target has texels");
        let mut found = [Errors::default(); ZONES.len()];
        // Squares and texels of places like the pole.
        let mut like = [(0.0, 0.0_f64); 256];
        for ((&height, at), &sample) in self.heights.iter().zip(&self.places).zip(samples) {
            let Some(errors) = found.get_mut(usize::from(at.zone)) else { continue };
            // GDAL leaves 0 where it finds nothing; here it is a height.
            if sample.is_nan() || program != Program::Areoid && sample == 0.0 {
                errors.missing += 1;
                continue;
            }
            let error = 100.0 * (f64::from(sample) - height).abs() / STRENGTH_M;
            errors.texels += 1;
            errors.rms += error * error;
            errors.max = errors.max.max(error);
            if let Some((squares, texels)) = at.like_pole.map(|place| &mut like[usize::from(place)])
            {
                *squares += error * error;
                *texels += 1.0;
            }
        }
        for errors in &mut found {
            errors.rms = (errors.rms / errors.texels as f64).sqrt();
            errors.like_it = f64::NAN;
        }
        let rms = like.iter().map(|(squares, texels)| (squares / texels).sqrt());
        found[1].like_it = rms.fold(f64::NAN, f64::max);
        found
    }

    /// The root mean square at the meridian that lies like the antimeridian, in percent.
    fn like_the_seam(&self, samples: &[f32]) -> f64 {
        let texels = self.heights.iter().zip(&self.places).zip(samples);
        let there = texels.filter(|((_, at), sample)| at.like_seam && !sample.is_nan());
        let (squares, count) = there.fold((0.0, 0.0), |(squares, count), ((height, _), sample)| {
            let error = 100.0 * (f64::from(*sample) - height) / STRENGTH_M;
            (squares + error * error, count + 1.0)
        });
        (squares / count).sqrt()
    }
}

/// The samples of a headerless file.
fn headerless(bytes: &[u8]) -> Vec<f32> {
    let samples = bytes.chunks_exact(4);
    samples.map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four of them"))).collect()
}

/// The samples of a TIFF of floating-point numbers.
fn tiff(path: &Path, (width, height): (u32, u32)) -> io::Result<Vec<f32>> {
    let raster = raster::open(path, &ReadOptions::default()).map_err(io::Error::other)?;
    let mut samples = vec![f32::NAN; width as usize * height as usize];
    let (across, down) = raster.info().blocks();
    for (row, col) in (0..down).flat_map(|row| (0..across).map(move |col| (row, col))) {
        let block = raster.read_block(col, row).map_err(io::Error::other)?;
        let Samples::F32(read) = &block.samples else {
            return Err(io::Error::other(format!("{} is not of 32-bit floats", path.display())));
        };
        let lines = read.chunks_exact(block.width as usize).zip(block.row as usize..);
        for (line, row) in lines.take(block.height as usize) {
            let at = row * width as usize + block.col as usize;
            samples[at..at + line.len()].copy_from_slice(line);
        }
    }
    Ok(samples)
}

/// The centers of places like that at the pole.
fn like_the_pole() -> Vec<[f64; 3]> {
    let (parallels, apart) = LIKE_POLE_DEG;
    let around = || (0..8).map(|step| (f64::from(step) + 0.3) * apart);
    let positions = parallels.into_iter().flat_map(|parallel| {
        around().map(move |longitude| Position {
            longitude: longitude.to_radians(),
            latitude: parallel.to_radians(),
        })
    });
    positions.map(Position::vector).collect()
}

/// Where a texel is; `seam` is half the width of the antimeridian, in radians.
fn at(position: Position, seam: f64, like_pole: &[[f64; 3]]) -> At {
    let latitude_deg = position.latitude.to_degrees();
    let from_seam = (PI - position.longitude.abs()) * position.latitude.cos();
    let zone = match () {
        () if latitude_deg < 0.0 => 3,
        () if latitude_deg > 90.0 - POLE_DEG => 1,
        () if from_seam < seam => 2,
        () => 0,
    };
    if zone != 0 {
        return At { zone, like_pole: None, like_seam: false };
    }
    let here = position.vector();
    let near = POLE_DEG.to_radians().cos();
    let dot = |there: &[f64; 3]| here.iter().zip(there).map(|(a, b)| a * b).sum::<f64>();
    let pole = like_pole.iter().position(|there| dot(there) > near);
    let off = (position.longitude - LIKE_SEAM) * position.latitude.cos();
    let like_pole = pole.and_then(|place| u8::try_from(place).ok());
    At { zone, like_pole, like_seam: off.abs() < seam }
}
