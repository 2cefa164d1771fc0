//! Other programs that do a part of what an ingest does, used where they are installed.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

/// A program, if it is there.
#[derive(Clone, Debug)]
struct Peer {
    name: &'static str,
    found: Option<(PathBuf, String)>,
}

/// All that are looked for.
#[derive(Clone, Debug)]
pub(super) struct Peers {
    peers: Vec<Peer>,
}

/// The programs, and how each is asked for its version.
const PROGRAMS: [(&str, &str); 4] = [
    ("vips", "--version"),
    ("lz4", "--version"),
    ("gdal_translate", "--version"),
    ("gdalwarp", "--version"),
];

/// What a Python is called here that has GDAL.
const PYTHON: &str = "python osgeo";

impl Peers {
    /// Nobody to be compared with.
    pub(super) fn none() -> Self {
        Self { peers: Vec::new() }
    }

    /// Looks for all of them on the `PATH`; `python` is one that has GDAL.
    pub(super) fn find(python: Option<&Path>) -> Self {
        let find = |&(name, version): &(&'static str, &str)| {
            let found = on_path(name).map(|path| {
                let said = Command::new(&path).arg(version).output();
                let said = said.map(|said| String::from_utf8_lossy(&said.stdout).into_owned());
                let said = said.unwrap_or_default();
                let line = said.lines().next().unwrap_or_default();
                let line = line.trim_matches(['*', ' ']).to_owned();
                (path, line)
            });
            Peer { name, found }
        };
        let mut peers: Vec<Peer> = PROGRAMS.iter().map(find).collect();
        let found = python.and_then(|python| {
            let mut command = Command::new(python);
            command.args(["-c", "from osgeo import gdal; print(gdal.VersionInfo('--version'))"]);
            let said = command.output().ok().filter(|said| said.status.success())?;
            let line = String::from_utf8_lossy(&said.stdout).trim().to_owned();
            Some((python.to_owned(), line))
        });
        peers.push(Peer { name: PYTHON, found });
        Self { peers }
    }

    /// What serves files over HTTP, and what asks for them.
    pub(super) fn servers() -> Self {
        let find = |name| {
            let found = on_path(name).map(|path| {
                // Both say it where errors are said, and one takes it for one.
                let said = Command::new(&path).arg("-v").output();
                let said = said.map(|said| [said.stderr, said.stdout].concat()).unwrap_or_default();
                let said = String::from_utf8_lossy(&said).into_owned();
                (path, said.lines().next().unwrap_or_default().trim().to_owned())
            });
            Peer { name, found }
        };
        Self { peers: ["nginx", "wrk"].map(find).to_vec() }
    }

    /// Where a program is.
    pub(super) fn program(&self, name: &str) -> Option<&Path> {
        let peer = self.peers.iter().find(|peer| peer.name == name)?;
        peer.found.as_ref().map(|(path, _)| path.as_path())
    }

    pub(super) fn json(&self) -> Value {
        let peers = self.peers.iter().map(|peer| match &peer.found {
            Some((path, version)) => {
                json!({ "name": peer.name, "found": true, "path": path, "version": version })
            }
            None => json!({ "name": peer.name, "found": false }),
        });
        peers.collect()
    }

    /// Which are there and which are absent.
    pub(super) fn sentences(&self) -> String {
        let there = self.peers.iter().filter_map(|peer| {
            let (_, version) = peer.found.as_ref()?;
            Some(format!("{} ({version})", peer.name))
        });
        let there: Vec<String> = there.collect();
        let absent = self.peers.iter().filter(|peer| peer.found.is_none());
        let absent: Vec<&str> = absent.map(|peer| peer.name).collect();
        let mut text = String::new();
        if !there.is_empty() {
            text.push_str(&format!("Peers: {}.\n", there.join(", ")));
        }
        if !absent.is_empty() {
            text.push_str(&format!("Absent, and not compared with: {}.\n", absent.join(", ")));
        }
        text
    }

    /// libvips' page pyramid of a raster: 510 + 1 uncompressed, then each page through LZ4.
    pub(super) fn dzsave_and_lz4(
        &self,
        raster: &Path,
        folder: &Path,
        cores: usize,
    ) -> Option<Vec<Command>> {
        let (vips, lz4) = (self.program("vips")?, self.program("lz4")?);
        let shell =
            on_path("sh").filter(|_| on_path("find").is_some() && on_path("xargs").is_some())?;
        let mut pages = Command::new(vips);
        pages
            .arg("dzsave")
            .arg(raster)
            .arg(folder.join("pages"))
            .args(["--tile-size", "510", "--overlap", "1", "--depth", "onetile"])
            // libvips writes no headerless pages; an uncompressed TIFF is one behind 242 bytes.
            .args(["--suffix", ".tif[compression=none]"])
            .env("VIPS_WARNING", "0");
        let mut compress = Command::new(shell);
        compress
            .arg("-c")
            .arg(r#"find "$1" -type f -print0 | xargs -0 -n 64 -P "$2" "$3" -1 -q -f -m"#)
            .arg("sh")
            .arg(folder.join("pages_files"))
            .arg(cores.to_string())
            .arg(lz4);
        Some(vec![pages, compress])
    }

    /// GDAL's pyramid: a cloud-optimized `GeoTIFF`, ZSTD at its fastest.
    pub(super) fn cog(&self, raster: &Path, folder: &Path) -> Option<Vec<Command>> {
        let mut command = Command::new(self.program("gdal_translate")?);
        command.args(["-q", "-of", "COG"]);
        for option in [
            "COMPRESS=ZSTD",
            "LEVEL=1",
            "PREDICTOR=YES",
            "OVERVIEW_RESAMPLING=AVERAGE",
            "NUM_THREADS=ALL_CPUS",
            "BIGTIFF=IF_SAFER",
        ] {
            command.args(["-co", option]);
        }
        command.arg(raster).arg(folder.join("cog.tif"));
        Some(vec![command])
    }

    /// gdalwarp from the `PATH` with `arguments`, a raster and what is made of it last.
    pub(super) fn warp(&self, arguments: &[String]) -> Option<Command> {
        let mut command = Command::new(self.program("gdalwarp")?);
        command.arg("-q").args(arguments);
        Some(command)
    }

    /// The same by the Python that has GDAL.
    pub(super) fn python_warp(&self, arguments: &[String]) -> Option<Command> {
        const SCRIPT: &str = "import sys\nfrom osgeo import gdal\ngdal.UseExceptions()\n\
                              sys.exit(gdal.Warp(sys.argv[-1], sys.argv[-2], options=sys.argv[1:-2]) is None)";
        let mut command = Command::new(self.program(PYTHON)?);
        command.args(["-c", SCRIPT]).args(arguments);
        Some(command)
    }

    /// GDAL decoding a raster into memory, on one thread.
    pub(super) fn decode(&self, raster: &Path) -> Option<Vec<Command>> {
        let mut command = Command::new(self.program("gdal_translate")?);
        command.args(["-q", "-of", "MEM"]).arg(raster).arg("decoded");
        command.env("GDAL_NUM_THREADS", "1");
        Some(vec![command])
    }

    /// GDAL writing pages that lie below one another in a headerless file, each as a DEFLATE tile.
    pub(super) fn deflate_pages(&self, pages: &Path, side: usize, to: &Path) -> Option<Command> {
        let mut command = Command::new(self.program("gdal_translate")?);
        command.args(["-q", "-of", "GTiff", "-co", "TILED=YES", "-co", "COMPRESS=DEFLATE"]);
        command.args(["-co", "ZLEVEL=6", "-co", "PREDICTOR=2"]);
        command.args(["-co", &format!("BLOCKXSIZE={side}"), "-co", &format!("BLOCKYSIZE={side}")]);
        command.arg(pages).arg(to);
        Some(command)
    }
}

/// The program of that name that a shell would run.
fn on_path(name: &str) -> Option<PathBuf> {
    let folders = env::var_os("PATH")?;
    // Empty entries mean the current folder to a shell; nothing of it is run here.
    let folders = env::split_paths(&folders).filter(|folder| !folder.as_os_str().is_empty());
    folders.map(|folder| folder.join(name)).find(|path| path.is_file())
}
