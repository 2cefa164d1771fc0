//! Who resamples, with which kernel, and from which map to which.

use std::path::Path;
use std::process::Command;

use crate::bench::geotiff::Place;
use crate::bench::ingest::Setting;

/// Who resamples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Program {
    Areoid,
    /// gdalwarp from the `PATH`.
    GdalWarp,
    /// The GDAL of the Python that was named.
    Python,
}

/// Whether places are found one by one, or as each program does by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Places {
    Own,
    Exact,
}

/// How a raster is resampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Way {
    pub(super) program: Program,
    pub(super) kernel: &'static str,
    pub(super) places: Places,
}

/// Kernels of this program; the last two are splines of degree 3 and 5.
const OURS: [&str; 7] =
    ["nearest", "bilinear", "cubic", PLAIN_LANCZOS, "lanczos", "spline 3", "spline 5"];

/// The Lanczos that others have; the one without a word is exact for ramps, too.
const PLAIN_LANCZOS: &str = "lanczos plain";

/// GDAL's kernels, but for its splines, which do not interpolate.
const THEIRS: [&str; 3] = ["bilinear", "cubic", "lanczos"];

/// Those and the ones of this program that are held against them.
pub(super) const SHARED: [(&str, &str); 4] = [
    ("bilinear", "bilinear"),
    ("cubic", "cubic"),
    ("lanczos", PLAIN_LANCZOS),
    ("lanczos", "lanczos"),
];

/// Kernels of this program that are measured with exact places, too.
pub(super) const EXACT: [&str; 2] = ["cubic", "spline 5"];

impl Way {
    pub(super) const fn new(program: Program, kernel: &'static str, places: Places) -> Self {
        Self { program, kernel, places }
    }

    /// All that are measured.
    pub(super) fn all() -> Vec<Self> {
        let ours = OURS.map(|kernel| Self::new(Program::Areoid, kernel, Places::Own));
        let exact = EXACT.map(|k| Self::new(Program::Areoid, k, Places::Exact));
        let theirs = [Program::GdalWarp, Program::Python].into_iter().flat_map(|program| {
            let places = [Places::Own, Places::Exact].into_iter();
            places.flat_map(move |places| THEIRS.map(|kernel| Self::new(program, kernel, places)))
        });
        ours.into_iter().chain(exact).chain(theirs).collect()
    }

    pub(super) fn name(self) -> String {
        let program = match self.program {
            Program::Areoid => "areoid",
            Program::GdalWarp => "gdalwarp",
            Program::Python => "python osgeo",
        };
        let exact = if self.places == Places::Exact { ", exact" } else { "" };
        format!("{program} {}{exact}", self.kernel)
    }
}

/// From a map to another, each with its size.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction {
    pub(super) name: &'static str,
    pub(super) source: (Place, (u32, u32)),
    pub(super) target: (Place, (u32, u32)),
}

impl Direction {
    /// Both ways between a polar map `side` pixels wide and straight ones of as many.
    pub(super) fn both(side: u32) -> [Self; 2] {
        let radius_px = side * 49 / 100;
        let polar = (Place::North { radius_px }, (side, side));
        let wide = (side * 59 / 32).next_multiple_of(128);
        let half = (Place::Half, (wide, wide / 4));
        let around = (side * 181 / 128).next_multiple_of(32);
        let globe = (Place::Globe, (around, around / 2));
        [
            Self { name: "polar to straight", source: polar, target: half },
            Self { name: "straight to polar", source: globe, target: polar },
        ]
    }

    /// Millions of texels made.
    pub(super) fn megapixels(&self) -> f64 {
        let (width, height) = self.target.1;
        f64::from(width) * f64::from(height) / 1e6
    }

    /// Makes `out` of a raster: a headerless file, or an uncompressed TIFF by GDAL; `None` if the
    /// program is not there.
    pub(super) fn command(
        &self,
        setting: &Setting,
        way: Way,
        raster: &Path,
        out: &Path,
    ) -> Option<Command> {
        let (place, (width, height)) = self.target;
        if way.program == Program::Areoid {
            let mut command = Command::new(&setting.areoid);
            command.args(["bench", "resample"]).arg(raster).arg("-o").arg(out);
            command.args(["--width", &width.to_string(), "--height", &height.to_string()]);
            let mut words = way.kernel.split(' ');
            command.arg("--kernel").args(words.next());
            match words.next() {
                Some("plain") => command.arg("--plain"),
                degree => command.arg("--spline-degree").arg(degree.unwrap_or("5")),
            };
            if let Place::North { radius_px } = place {
                command.args(["--radius-px", &radius_px.to_string()]);
            }
            if way.places == Places::Exact {
                command.arg("--exact");
            }
            return Some(command);
        }
        let [left, top, pixel_x, pixel_y] = place.corner_and_pixel((width, height));
        let (right, bottom) =
            (left + pixel_x * f64::from(width), top - pixel_y * f64::from(height));
        let mut arguments = onto(&place.proj(), [left, bottom, right, top], (width, height));
        arguments.extend(["-of", "GTiff", "-r", way.kernel].map(str::to_owned));
        if way.places == Places::Exact {
            arguments.extend(["-et", "0"].map(str::to_owned));
        }
        arguments.extend([raster, out].map(|path| path.to_string_lossy().into_owned()));
        match way.program {
            Program::GdalWarp => setting.peers.warp(&arguments),
            _ => setting.peers.python_warp(&arguments),
        }
    }
}

/// gdalwarp's arguments for a target, on all cores.
pub(super) fn onto(proj: &str, outline: [f64; 4], (width, height): (u32, u32)) -> Vec<String> {
    let fixed = ["-overwrite", "-multi", "-wo", "NUM_THREADS=ALL_CPUS", "-wm", "512", "-t_srs"];
    let mut arguments: Vec<String> = fixed.iter().map(ToString::to_string).collect();
    arguments.extend([proj.to_owned(), "-te".to_owned()]);
    arguments.extend(outline.iter().map(ToString::to_string));
    arguments.extend(["-ts".to_owned(), width.to_string(), height.to_string()]);
    arguments
}
