//! Whatever is wrong with the input or the disk: one `error:` line with its cause, exit 1, and the
//! catalog is as it was.

#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

use areoid_preprocess::ingest::TargetGrid;
use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::target::TargetMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;
use tiff::tags::Tag;

const GEOGRAPHIC: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326];
const UTM: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32613];

/// A GeoTIFF of `side * side` samples of 1 degree, or 1 meter, each.
fn geotiff(side: u32, samples: &[f32], keys: &[u16]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<Gray32Float>(side, side).unwrap();
    let tags = image.encoder();
    tags.write_tag(Tag::Unknown(33550), &[1.0_f64, 1.0, 0.0][..]).unwrap();
    tags.write_tag(Tag::Unknown(33922), &[0.0_f64, 0.0, 0.0, 10.0, 50.0, 0.0][..]).unwrap();
    tags.write_tag(Tag::Unknown(34735), keys).unwrap();
    image.write_data(samples).unwrap();
    bytes.into_inner()
}

fn good() -> Vec<u8> {
    let samples: Vec<f32> = (0..1600_u16).map(f32::from).collect();
    geotiff(40, &samples, &GEOGRAPHIC)
}

/// A folder with a catalog that has one dataset.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: TempDir::new().unwrap() };
        fs::write(bench.path("good.tif"), good()).unwrap();
        let made = bench.ingest(&["good.tif"]);
        assert!(made.status.success(), "{made:?}");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn ingest(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        command.current_dir(self.folder.path()).arg("ingest").args(arguments);
        command.args(["--catalog", "catalog"]).output().unwrap()
    }

    /// The names and contents of the catalog, but for the leftovers of a failed build.
    fn catalog(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let mut files = Vec::new();
        for folder in [self.path("catalog"), self.path("catalog/archives")] {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_file() {
                    files.push((path.clone(), fs::read(path).unwrap()));
                }
            }
        }
        files.sort();
        files
    }

    fn refuses(&self, arguments: &[&str], expected: &[&str]) {
        let before = self.catalog();
        let output = self.ingest(arguments);
        assert_refused(&output, expected);
        assert_eq!(self.catalog(), before, "{arguments:?} changed the catalog");
    }

    fn refuses_raster(&self, name: &str, bytes: &[u8], expected: &[&str]) {
        fs::write(self.path(name), bytes).unwrap();
        self.refuses(&[name], expected);
    }
}

/// Exit 1, nothing on stdout, and one `error:` line that names all of `expected`; causes follow.
fn assert_refused(output: &Output, expected: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(output.stdout.is_empty(), "{output:?}");
    assert!(stderr.starts_with("error: "), "{stderr}");
    assert_eq!(stderr.matches("error: ").count(), 1, "{stderr}");
    for line in stderr.lines().skip(1) {
        assert!(line.starts_with("  caused by: "), "{stderr}");
    }
    for word in expected {
        assert!(stderr.contains(word), "{word:?} is not in: {stderr}");
    }
}

#[test]
fn a_truncated_tiff_is_refused_wherever_it_ends() {
    let bench = Bench::new();
    let whole = good();
    for length in [0, 1, 4, 7, 8, 9, 100, whole.len() / 2, whole.len() - 1] {
        bench.refuses_raster("cut.tif", &whole[..length], &["cut.tif"]);
    }
}

#[test]
fn a_coordinate_system_out_of_reach_is_named() {
    let bench = Bench::new();
    let utm = geotiff(2, &[1.0; 4], &UTM);
    bench.refuses_raster("utm.tif", &utm, &["utm.tif", "32613", "supported"]);
    bench.refuses(&["good.tif", "--name", "x", "--crs", "EPSG:32613"], &["32613"]);
    bench.refuses(&["good.tif", "--name", "x", "--crs", "nonsense"], &["nonsense"]);
}

#[test]
fn a_text_file_is_no_raster() {
    let bench = Bench::new();
    bench.refuses_raster("notes.tif", b"Dear diary, today", &["notes.tif", "Dear diary"]);
}

#[test]
fn a_raster_of_nothing_but_nan_is_no_dataset() {
    let bench = Bench::new();
    let nan = geotiff(40, &[f32::NAN; 1600], &GEOGRAPHIC);
    bench.refuses_raster("nan.tif", &nan, &["nan", "no valid sample"]);
}

/// They were stored as constant pages of no number, and exit 0.
#[test]
fn heights_too_large_to_be_resampled_are_refused() {
    let bench = Bench::new();
    let large: Vec<f32> = (0..1600).map(|at| if at % 2 == 0 { 3e38 } else { -3e38 }).collect();
    fs::write(bench.path("large.tif"), geotiff(40, &large, &GEOGRAPHIC)).unwrap();
    for grid in ["equirectangular", "polar-north"] {
        bench.refuses(&["large.tif", "--grid", grid], &["large.tif", "not finite"]);
    }
}

#[test]
fn texels_too_fine_to_be_counted_are_refused() {
    let bench = Bench::new();
    let options = ["good.tif", "--name", "x", "--pixel-size-m", "1e-9"];
    bench.refuses(&options, &["texels in a row or column are too many"]);
}

#[test]
fn a_raster_without_pixels_is_refused() {
    let bench = Bench::new();
    let mut bytes = good();
    // Entries of 12 bytes follow the directory's count; tag 256 is ImageWidth.
    let directory = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
    let entry = (directory + 2..bytes.len()).step_by(12).find(|&at| bytes[at..at + 2] == [0, 1]);
    let value = entry.unwrap() + 8;
    bytes[value..value + 4].fill(0);
    bench.refuses_raster("empty.tif", &bytes, &["empty.tif", "0"]);
}

#[test]
fn an_image_without_a_world_file_is_refused() {
    let bench = Bench::new();
    let path = bench.path("photo.png");
    image::RgbImage::new(4, 4).save(path).unwrap();
    bench.refuses(&["photo.png", "--body", "earth"], &["photo.png", "photo.pgw"]);
}

#[test]
fn files_that_are_not_there_and_folders_are_refused() {
    let bench = Bench::new();
    bench.refuses(&["absent.tif"], &["absent.tif"]);
    fs::create_dir(bench.path("folder.tif")).unwrap();
    bench.refuses(&["folder.tif"], &["folder.tif"]);
}

#[test]
fn another_body_is_refused() {
    let bench = Bench::new();
    bench.refuses(&["good.tif", "--name", "x", "--body", "moon"], &["moon", "1737400"]);
    let moon = ["good.tif", "--name", "x", "--crs", "+proj=longlat +R=1737400 +no_defs"];
    bench.refuses(&moon, &["earth", "moon", "one body"]);
}

#[test]
fn a_name_taken_by_something_else_needs_force() {
    let bench = Bench::new();
    bench.refuses(&["good.tif", "--step-m", "10"], &["good", "--force"]);
    bench.refuses(&["good.tif", "--name", "../x"], &["../x"]);
    assert!(bench.ingest(&["good.tif", "--step-m", "10", "--force"]).status.success());
    assert!(bench.ingest(&["good.tif", "--step-m", "10"]).status.success());
}

/// They used to be found out behind the raster's header, and to be blamed on the raster.
#[test]
fn options_out_of_range_are_misuse_of_the_option() {
    let bench = Bench::new();
    let before = bench.catalog();
    let digits = format!("1{}", "0".repeat(300));
    for (option, value, range) in [
        ("--page-size", "6", "even number from 8 to 4096"),
        ("--page-size", "33", "even number from 8 to 4096"),
        ("--page-size", "4098", "even number from 8 to 4096"),
        ("--page-size", "99999999999", "number too large"),
        ("--step-m", "-1", "1e-30 to 1e28"),
        ("--step-m", "1e-31", "1e-30 to 1e28"),
        ("--step-m", "1e300", "1e-30 to 1e28"),
        ("--step-m", "nan", "1e-30 to 1e28"),
        ("--step-m", "inf", "1e-30 to 1e28"),
    ] {
        let output = bench.ingest(&["good.tif", "--name", "x", option, value]);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{option} {value}: {stderr}");
        assert!(stderr.contains(option) && stderr.contains(range), "{stderr}");
        assert!(!stderr.contains("good.tif") && !stderr.contains(&digits[..40]), "{stderr}");
    }
    assert_eq!(bench.catalog(), before);
    assert!(bench.ingest(&["good.tif", "--name", "x", "--step-m", "0"]).status.success());
    // In range, and too fine for these heights.
    bench.refuses(&["good.tif", "--name", "y", "--step-m", "1e-25"], &["step 1e-25"]);
}

#[test]
fn a_catalog_that_cannot_be_written_is_an_error() {
    let bench = Bench::new();
    // A file where the catalog's folder should be, which stops even the superuser.
    fs::write(bench.path("occupied"), b"").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    command.current_dir(bench.folder.path()).args(["ingest", "good.tif", "--catalog", "occupied"]);
    assert_refused(&command.output().unwrap(), &["occupied"]);
}

/// Refused before anything is built: nothing is left of it.
#[test]
fn a_refused_ingest_leaves_no_build() {
    let bench = Bench::new();
    let moon = ["good.tif", "--name", "x", "--crs", "+proj=longlat +R=1737400 +no_defs"];
    assert!(!bench.ingest(&moon).status.success());
    assert!(bench.path("catalog/build").read_dir().unwrap().next().is_none());
}

/// An archive that is gone, or another's under its name: the other dataset answers, `verify` tells,
/// and `ingest --force` mends.
#[test]
fn damage_to_one_dataset_is_confined_to_it() {
    let bench = Bench::new();
    assert!(bench.ingest(&["good.tif", "--name", "other", "--step-m", "10"]).status.success());
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        command.current_dir(bench.folder.path()).args(arguments).output().unwrap()
    };
    let archive = |name: &str| {
        let folder = bench.path("catalog/archives").read_dir().unwrap();
        let mut paths = folder.map(|entry| entry.unwrap().path());
        paths.find(|path| path.file_name().unwrap().to_str().unwrap().starts_with(name)).unwrap()
    };
    let victim = archive("other-");
    for swapped in [true, false] {
        if swapped {
            fs::copy(archive("good-"), &victim).unwrap();
        } else {
            fs::remove_file(&victim).unwrap();
        }
        let verified = run(&["verify", "catalog", "--json"]);
        let report = String::from_utf8(verified.stdout).unwrap();
        assert_eq!(verified.status.code(), Some(1), "{report}");
        assert!(report.contains("\"ok\": false") && report.contains("other"), "{report}");
        let info = run(&["info", "catalog", "--json"]);
        let listed = String::from_utf8(info.stdout).unwrap();
        assert_eq!(info.status.code(), Some(1));
        assert!(listed.contains("\"good\"") && listed.contains("\"error\""), "{listed}");
        let height = |dataset| run(&["height", "catalog", "--at", "20,40", "--dataset", dataset]);
        assert!(height("good").status.success());
        assert_refused(&height("other"), &["other"]);
        let again = ["good.tif", "--name", "other", "--step-m", "10", "--force"];
        let mended = bench.ingest(&again);
        assert!(mended.status.success(), "{mended:?}");
        assert!(run(&["verify", "catalog"]).status.success());
    }
}

/// What is left of an archive may have no pages at all: that is no empty dataset.
#[test]
fn an_archive_that_was_cut_is_told() {
    let bench = Bench::new();
    let mut archives = bench.path("catalog/archives").read_dir().unwrap();
    let archive = archives.next().unwrap().unwrap().path();
    let bytes = fs::read(&archive).unwrap();
    for left in [bytes.len() / 2, bytes.len() - 1] {
        fs::write(&archive, &bytes[..left]).unwrap();
        for arguments in [&["info", "catalog"][..], &["info", "catalog", "--json"]] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
            let info = command.current_dir(bench.folder.path()).args(arguments).output().unwrap();
            let text = String::from_utf8(info.stdout).unwrap();
            assert_eq!(info.status.code(), Some(1), "{text}");
            assert!(text.contains("is damaged: of"), "{text}");
        }
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        let height = command.current_dir(bench.folder.path());
        let height = height.args(["height", "catalog", "--at", "20,40"]).output().unwrap();
        let warned = String::from_utf8(height.stderr).unwrap();
        assert!(warned.contains("warning: ") && warned.contains("is damaged: of"), "{warned}");
    }
}

/// A disk that fills up while the archive is written: what was written waits for `--resume`.
#[test]
fn a_full_disk_is_an_error_and_changes_nothing() {
    let bench = Bench::new();
    let before = bench.catalog();
    let request = areoid_preprocess::ingest::Request {
        rasters: vec![bench.path("good.tif")],
        catalog: bench.path("catalog"),
        name: Some("second".to_owned()),
        kind: None,
        step_m: None,
        grid: TargetGrid::One(TargetMap::Native),
        pixel_size: None,
        kernel: Kernel::QuinticSpline,
        limit: RangeLimit::None,
        mip: areoid_formats::archive::MipRule::Mean,
        page_side: 8,
        priority: 0,
        threads: Some(1),
        existing: areoid_preprocess::ingest::Existing::Keep,
        unfinished: areoid_preprocess::ingest::Unfinished::Discard,
        memory_bytes: 1 << 30,
        note_every: std::time::Duration::from_secs(60),
        reading: areoid_preprocess::ingest::Reading::default(),
    };
    let proceed = |_| areoid_preprocess::build::Proceed::Yes;
    let real = areoid_formats::catalog::RealDisk;
    let elsewhere =
        areoid_preprocess::ingest::Request { catalog: bench.path("elsewhere"), ..request.clone() };
    let whole = areoid_preprocess::ingest::ingest(&real, &elsewhere, proceed).unwrap();
    let room = usize::try_from(whole.bytes).unwrap() * 3 / 4;
    let disk = FullDisk { room: std::sync::atomic::AtomicUsize::new(room) };
    let error = areoid_preprocess::ingest::ingest(&disk, &request, proceed).unwrap_err();
    let causes = std::iter::successors(Some(&error as &dyn std::error::Error), |e| e.source());
    let text: Vec<String> = causes.map(ToString::to_string).collect();
    assert!(text.join(": ").contains("no space left"), "{text:?}");
    assert_eq!(bench.catalog(), before);

    // With room, the same ingest comes to its end.
    let request = areoid_preprocess::ingest::Request {
        unfinished: areoid_preprocess::ingest::Unfinished::Resume,
        ..request
    };
    let outcome = areoid_preprocess::ingest::ingest(&real, &request, proceed).unwrap();
    assert_eq!((outcome.bytes, outcome.parts), (whole.bytes, whole.parts));
    assert!(Path::new(&bench.path("catalog/build")).read_dir().unwrap().next().is_none());
}

/// The file system with room for so many bytes more.
struct FullDisk {
    room: std::sync::atomic::AtomicUsize,
}

impl areoid_formats::catalog::Disk for FullDisk {
    fn create_folders(&self, path: &Path) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.create_folders(path)
    }

    fn open_or_create(&self, path: &Path) -> std::io::Result<fs::File> {
        areoid_formats::catalog::RealDisk.open_or_create(path)
    }

    fn truncate(&self, file: &mut fs::File, length: u64) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.truncate(file, length)
    }

    fn append(&self, file: &mut fs::File, bytes: &[u8]) -> std::io::Result<()> {
        let order = std::sync::atomic::Ordering::Relaxed;
        let room = self.room.load(order);
        if bytes.len() > room {
            return Err(std::io::Error::new(std::io::ErrorKind::StorageFull, "no space left"));
        }
        self.room.store(room - bytes.len(), order);
        areoid_formats::catalog::RealDisk.append(file, bytes)
    }

    fn sync_file(&self, file: &fs::File) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.sync_file(file)
    }

    fn sync_folder(&self, path: &Path) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.sync_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.link(from, to)
    }

    fn remove(&self, path: &Path) -> std::io::Result<()> {
        areoid_formats::catalog::RealDisk.remove(path)
    }
}
