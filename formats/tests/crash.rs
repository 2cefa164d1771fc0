//! Catalogs whose writers die at every step, and writers that meet.
//!
//! [`Dying`] does what it is told on a real folder until its steps are used up; from then on every
//! call fails, as nothing a killed process still wanted happens. What it leaves must be the catalog
//! before the change or after it.

#![expect(clippy::unwrap_used, reason = "tests: a panic is a failure")]

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{
    Archive, ArchiveWriter, ConstantTexel, Description, PageEntry, Payload, Source,
};
use areoid_formats::body::Body;
use areoid_formats::catalog::{
    Build, Catalog, CatalogError, Disk, Existing, NewDataset, RealDisk, publish_build,
    remove_dataset,
};
use areoid_formats::codec::{self, Quantum};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};

/// What happens to the append that has no step left.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Last {
    /// Nothing of it.
    Undone,
    /// The first half of its bytes is written.
    Torn,
}

/// The file system, until `steps` are used up.
#[derive(Debug)]
struct Dying {
    steps: usize,
    taken: AtomicUsize,
    last: Last,
    /// What was done, in words.
    log: Mutex<Vec<String>>,
}

impl Dying {
    fn after(steps: usize, last: Last) -> Self {
        Self { steps, taken: AtomicUsize::new(0), last, log: Mutex::default() }
    }

    fn step(&self, what: &str, path: &Path) -> io::Result<()> {
        if self.taken.fetch_add(1, Ordering::Relaxed) >= self.steps {
            return Err(io::Error::other("killed"));
        }
        self.log.lock().unwrap().push(format!("{what} {}", path.display()));
        Ok(())
    }

    fn died(&self) -> bool {
        self.taken.load(Ordering::Relaxed) > self.steps
    }
}

impl Disk for Dying {
    fn create_folders(&self, path: &Path) -> io::Result<()> {
        self.step("create", path)?;
        RealDisk.create_folders(path)
    }

    fn open_or_create(&self, path: &Path) -> io::Result<File> {
        self.step("open", path)?;
        RealDisk.open_or_create(path)
    }

    fn truncate(&self, file: &mut File, length: u64) -> io::Result<()> {
        self.step("truncate", Path::new(""))?;
        RealDisk.truncate(file, length)
    }

    fn append(&self, file: &mut File, bytes: &[u8]) -> io::Result<()> {
        let alive = self.step("append", Path::new(""));
        if alive.is_err()
            && self.last == Last::Torn
            && self.taken.load(Ordering::Relaxed) == self.steps + 1
        {
            RealDisk.append(file, &bytes[..bytes.len() / 2])?;
        }
        alive?;
        RealDisk.append(file, bytes)
    }

    fn sync_file(&self, file: &File) -> io::Result<()> {
        self.step("sync file", Path::new(""))?;
        RealDisk.sync_file(file)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.step("sync", path)?;
        RealDisk.sync_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step("rename", to)?;
        RealDisk.rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step("link", to)?;
        RealDisk.link(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.step("remove", path)?;
        RealDisk.remove(path)
    }
}

/// A dataset of two pages: a constant one of `height` and one that is not.
fn publish(disk: &dyn Disk, folder: &Path, name: &str, height: u16) -> Result<u64, CatalogError> {
    publish_over(Existing::Replace, disk, folder, name, height)
}

fn publish_over(
    existing: Existing,
    disk: &dyn Disk,
    folder: &Path,
    name: &str,
    height: u16,
) -> Result<u64, CatalogError> {
    let body = Body::parse("mars").unwrap();
    let crs = Crs::new(Projection::Geographic, body.ellipsoid);
    let outline = Outline { origin: [0.0, 10.0], pixel_size: [1.0; 2], width: 12, height: 5 };
    let description = Description {
        dataset: name.to_owned(),
        kind: Kind::Height,
        body: body.clone(),
        grid: Grid::from_outline(crs, outline, 10).unwrap().grid,
        quantum: Quantum::NONE,
        priority: 0,
        feather_texels: 32,
        unit_pages: 8,
        source: Source::default(),
    };
    let height = f32::from(height);
    let entry = PageEntry {
        page: PageAddress::new(Level(1), 0, 0),
        payload: Payload::Constant(ConstantTexel(height.to_le_bytes())),
        valid_fraction: 1.0,
        min: height,
        max: height,
        lowest: height,
        highest: height,
        bound: 0.0,
        source_error: 0.0,
        full: true,
    };
    let stored = Payload::Record { offset: 0, length: 0, checksum: 0 };
    let beside = PageEntry { page: PageAddress::new(Level(1), 0, 1), payload: stored, ..entry };
    let texels: Vec<f32> = (0..100_u8).map(|texel| height + f32::from(texel)).collect();
    let payload = codec::encode_heights(&texels, None, 10, Quantum::NONE).unwrap();

    let build = Build::start(disk, folder, name)?;
    let written = |source| CatalogError::io("write", folder, source);
    let mut writer = ArchiveWriter::new(build, &description).map_err(written)?;
    writer.page(entry, &[]).map_err(written)?;
    writer.page(beside, &payload).map_err(written)?;
    writer.end_unit().map_err(written)?;
    let (build, written) = writer.finish().map_err(written)?;
    publish_build(
        build,
        NewDataset {
            name: name.to_owned(),
            kind: Kind::Height,
            priority: 0,
            body,
            bytes: written.bytes,
            content: written.content,
            source: Source::default(),
            existing,
        },
    )
}

/// What a catalog shows: the height of each dataset. Every archive must be whole.
type Shown = BTreeMap<String, f32>;

fn height_of(archive: &Archive) -> f32 {
    let entry = archive.find(PageAddress::new(Level(1), 0, 0)).unwrap().unwrap();
    archive.page(&entry).unwrap();
    entry.min
}

fn shown(folder: &Path) -> Shown {
    let (catalog, archives) = match Catalog::open_with_archives(folder) {
        Err(CatalogError::NotACatalog { .. }) => return Shown::new(),
        opened => opened.unwrap(),
    };
    let datasets = catalog.datasets().iter().zip(&archives);
    datasets
        .map(|(record, archive)| {
            assert_eq!(archive.damage().unwrap(), Vec::<String>::new(), "{}", record.name);
            assert_eq!(archive.description().dataset, record.name);
            assert_eq!(archive.len(), record.bytes);
            (record.name.clone(), height_of(archive))
        })
        .collect()
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Checks that a catalog holds what its manifest names and nothing else, but for unfinished builds.
fn check_swept(folder: &Path) {
    let catalog = Catalog::open(folder).unwrap();
    let mut expected: Vec<_> =
        catalog.datasets().iter().map(|record| record.file.clone()).collect();
    expected.sort();
    assert_eq!(names_in(&folder.join("archives")), expected);
    let manifest = format!("manifest.{}", catalog.generation());
    assert_eq!(names_in(folder), ["archives", "build", "catalog.lock", &manifest]);
}

type Change = fn(&dyn Disk, &Path) -> Result<u64, CatalogError>;

const CHANGES: [(&str, Change); 5] = [
    ("publish", |disk, folder| publish(disk, folder, "new", 7)),
    ("replace", |disk, folder| publish(disk, folder, "old", 7)),
    ("replace by the same", |disk, folder| publish(disk, folder, "old", 1)),
    ("remove", |disk, folder| remove_dataset(disk, folder, "old")),
    ("remove the other", |disk, folder| remove_dataset(disk, folder, "older")),
];

fn two_datasets() -> (tempfile::TempDir, PathBuf) {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    publish(&RealDisk, &folder, "old", 1).unwrap();
    publish(&RealDisk, &folder, "older", 2).unwrap();
    (home, folder)
}

#[test]
fn a_writer_killed_at_any_step_leaves_the_catalog_before_or_after() {
    for (name, change) in CHANGES {
        let (_home, folder) = two_datasets();
        let before = shown(&folder);
        change(&RealDisk, &folder).unwrap();
        let after = shown(&folder);

        for last in [Last::Undone, Last::Torn] {
            let mut seen_after = false;
            for steps in 0.. {
                let (_home, folder) = two_datasets();
                let disk = Dying::after(steps, last);
                let result = change(&disk, &folder);
                let left = shown(&folder);
                let what = format!("{name} killed after {steps} steps");
                assert!(left == before || left == after, "{what}: {left:?}");
                let linked = disk.log.lock().unwrap().iter().any(|step| step.starts_with("link"));
                assert_eq!(left == after, linked || before == after, "{what}");
                assert_eq!(result.is_ok(), !disk.died(), "{what}");
                seen_after |= left == after;

                // A live writer, which is another process, takes no notice and clears up.
                for name in names_in(&folder) {
                    if let Some(process) = name.strip_prefix("manifest-") {
                        let of_the_dead = folder.join(format!("manifest-{process}0"));
                        fs::rename(folder.join(&name), of_the_dead).unwrap();
                    }
                }
                publish(&RealDisk, &folder, "live", 3).unwrap();
                let mut expected = left;
                expected.insert("live".to_owned(), 3.0);
                assert_eq!(shown(&folder), expected, "{what}");
                check_swept(&folder);
                // And the dead one's name is free again.
                publish(&RealDisk, &folder, "new", 9).unwrap();
                publish(&RealDisk, &folder, "old", 9).unwrap();
                assert_eq!(names_in(&folder.join("build")), [] as [&str; 0], "{what}");
                check_swept(&folder);
                if !disk.died() {
                    break;
                }
            }
            assert!(seen_after, "{name}");
        }
    }
}

#[test]
fn a_first_writer_killed_at_any_step_leaves_no_catalog_or_one() {
    for steps in 0.. {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("a/b");
        let disk = Dying::after(steps, Last::Torn);
        let result = publish(&disk, &folder, "first", 1);
        let left = shown(&folder);
        assert!(left.is_empty() || left == Shown::from([("first".to_owned(), 1.0)]));
        assert!(result.is_err() || !left.is_empty());
        publish(&RealDisk, &folder, "live", 3).unwrap();
        assert_eq!(shown(&folder).len(), left.len() + 1, "{steps}");
        check_swept(&folder);
        if !disk.died() {
            break;
        }
    }
}

/// What must survive a power failure is synced before anything relies on it.
#[test]
fn nothing_is_relied_on_before_it_is_synced() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("a/b");
    let disk = Dying::after(usize::MAX, Last::Undone);
    publish(&disk, &folder, "old", 1).unwrap();
    let first = std::mem::take(&mut *disk.log.lock().unwrap());
    publish(&disk, &folder, "old", 2).unwrap();
    let second = std::mem::take(&mut *disk.log.lock().unwrap());

    let place = |log: &[String], what: &str, path: &Path| {
        let step = format!("{what} {}", path.display()).trim_end().to_owned();
        let found = log.iter().position(|done| done.trim_end().starts_with(&step));
        found.unwrap_or_else(|| panic!("no {step:?} in {log:#?}"))
    };
    // New folders, each in the one above it, before the build is opened.
    let opened = place(&first, "open", &folder.join("build"));
    for parent in [home.path().to_owned(), home.path().join("a"), folder.clone()] {
        let synced = first.iter().position(|step| *step == format!("sync {}", parent.display()));
        assert!(synced.is_some_and(|synced| synced < opened), "{parent:?} in {first:#?}");
    }

    let archives = folder.join("archives");
    let renamed = place(&second, "rename", &archives);
    let linked = place(&second, "link", &folder.join("manifest.2"));
    let archive_synced = place(&second, "sync file", Path::new(""));
    let name_synced = place(&second, "sync", &archives);
    let manifest_synced = second.iter().rposition(|step| step.starts_with("sync file")).unwrap();
    let generation_synced =
        second.iter().rposition(|step| *step == format!("sync {}", folder.display())).unwrap();
    let old_removed = place(&second, "remove", &folder.join("manifest.1"));
    let archive_removed = place(&second, "remove", &archives);
    assert!(archive_synced < renamed && renamed < name_synced, "{second:#?}");
    // The manifest before the rename: what may find no room comes while the build is still one.
    assert!(manifest_synced < renamed && name_synced < linked, "{second:#?}");
    assert!(linked < generation_synced, "{second:#?}");
    assert!(generation_synced < old_removed && generation_synced < archive_removed, "{second:#?}");
}

#[test]
fn a_second_builder_of_a_name_is_told() {
    let home = tempfile::tempdir().unwrap();
    let one = Build::start(&RealDisk, home.path(), "mola").unwrap();
    let busy =
        |name| matches!(Build::start(&RealDisk, home.path(), name), Err(CatalogError::Busy { .. }));
    assert!(busy("mola"));
    assert!(!busy("viking"));
    drop(one);
    assert!(!busy("mola"), "a lock goes with its builder");

    let one = Build::start(&RealDisk, home.path(), "mola").unwrap();
    one.discard().unwrap();
    assert!(!home.path().join("build/mola.part").exists());
}

#[test]
fn names_that_are_not_plain_are_refused() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    let long = "x".repeat(200);
    for name in
        ["", "../x", "..", ".", ".hidden", "a/b", "a\\b", "a b", "a\0", "-x", "ä", "a\n", &long]
    {
        let refused = Build::start(&RealDisk, &folder, name);
        assert!(matches!(refused, Err(CatalogError::Name { .. })), "{name:?}");
        assert!(!folder.exists(), "{name:?} leaves something behind");
    }
    for name in ["a", "mola.band", "9-x_Y.", &long[..100]] {
        publish(&RealDisk, &folder, name, 1).unwrap();
    }
    assert_eq!(shown(&folder).len(), 4);
    check_swept(&folder);
}

#[test]
fn a_refused_change_leaves_everything() {
    let (_home, folder) = two_datasets();
    let before = (shown(&folder), names_in(&folder));
    let gone = remove_dataset(&RealDisk, &folder, "oldest");
    assert!(matches!(gone, Err(CatalogError::NoSuchDataset { .. })));
    let nowhere = remove_dataset(&RealDisk, &folder.join("build"), "old");
    assert!(matches!(nowhere, Err(CatalogError::NotACatalog { .. })));
    let build = Build::start(&RealDisk, &folder, "moon").unwrap();
    let dataset = NewDataset {
        name: "moon".to_owned(),
        kind: Kind::Height,
        priority: 0,
        body: Body::parse("moon").unwrap(),
        bytes: 0,
        content: 0,
        source: Source::default(),
        existing: Existing::Replace,
    };
    let other = publish_build(build, dataset);
    assert!(matches!(other, Err(CatalogError::OtherBody { .. })));
    assert_eq!((shown(&folder), names_in(&folder)), before);
    assert!(names_in(&folder.join("build")).is_empty());
}

/// Two builders without `--force` who both found no dataset of the name: one looked before the other
/// published and locked the build after. The second replaced what the first had published.
#[test]
fn what_was_published_meanwhile_is_not_replaced_unasked() {
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    let refused = publish_over(Existing::Keep, &RealDisk, &folder, "old", 7);
    assert!(matches!(refused, Err(CatalogError::Exists { .. })), "{refused:?}");
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), [] as [&str; 0]);
    check_swept(&folder);
    // The same again is no loss.
    publish_over(Existing::Keep, &RealDisk, &folder, "old", 1).unwrap();
    assert_eq!(shown(&folder), before);
}

/// Whatever a build put beside its archive is gone before a manifest names the dataset: a writer
/// killed behind the link used to leave notes and scratch files that nobody came for, because the
/// next ingest found nothing to do; and a note half written stayed for good.
#[test]
fn nothing_stands_beside_a_published_archive() {
    for steps in 0.. {
        let (_home, folder) = two_datasets();
        let mut build = Build::start(&RealDisk, &folder, "new").unwrap();
        build.scratch().unwrap();
        build.note(b"note").unwrap();
        fs::write(folder.join("build/new.note-new"), b"no").unwrap();
        drop(build);
        let disk = Dying::after(steps, Last::Undone);
        let _ = publish(&disk, &folder, "new", 7);
        if shown(&folder).contains_key("new") {
            assert_eq!(names_in(&folder.join("build")), [] as [&str; 0], "{steps}");
        }
        if !disk.died() {
            break;
        }
    }
}

/// No room for the manifest, which is written last: the build used to be thrown away.
#[test]
fn a_build_is_kept_when_its_manifest_finds_no_room() {
    let (_home, folder) = two_datasets();
    let whole = Dying::after(usize::MAX, Last::Undone);
    publish(&whole, &folder, "old", 7).unwrap();
    let steps = whole.log.lock().unwrap().clone();
    let manifest = steps.iter().rposition(|step| step.starts_with("append")).unwrap();
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    let full = Dying::after(manifest, Last::Torn);
    assert!(matches!(publish(&full, &folder, "old", 7), Err(CatalogError::Io { .. })));
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), ["old.part"]);
}

/// Files with names like a manifest's: somebody's copies, links to nowhere, the last generation.
#[test]
fn odd_files_do_not_hang_or_mislead() {
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    for name in
        ["manifest.007", "manifest.+9", "manifest.9x", "manifest.", "manifest.99999999999999999999"]
    {
        fs::write(folder.join(name), "nothing").unwrap();
        assert_eq!(shown(&folder), before, "{name}");
        fs::remove_file(folder.join(name)).unwrap();
    }
    let generation = Catalog::open(&folder).unwrap().generation();
    // Generation 2 under the name of generation 8.
    fs::copy(folder.join(format!("manifest.{generation}")), folder.join("manifest.8")).unwrap();
    assert!(matches!(Catalog::open(&folder), Err(CatalogError::Manifest { .. })));
    assert!(publish(&RealDisk, &folder, "x", 1).is_err());
    fs::remove_file(folder.join("manifest.8")).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nowhere", folder.join("manifest.8")).unwrap();
        assert!(matches!(Catalog::open(&folder), Err(CatalogError::Io { .. })));
        fs::remove_file(folder.join("manifest.8")).unwrap();
    }
    assert_eq!(shown(&folder), before);
}

/// A manifest whose checksum holds leads nowhere but into the folder of archives.
#[test]
fn a_forged_manifest_is_refused() {
    let (_home, folder) = two_datasets();
    let path = folder.join("manifest.2");
    let good = String::from_utf8(fs::read(&path).unwrap()).unwrap();
    let json = good.split_once('\n').unwrap().1;
    let file = Catalog::open(&folder).unwrap().dataset("old").unwrap().file.clone();
    let forge = |from: &str, to: &str| {
        assert!(json.contains(from), "{from}");
        let json = json.replace(from, to);
        let sum = xxhash_rust::xxh3::xxh3_64(json.as_bytes());
        fs::write(&path, format!("areoid-manifest 1 {sum:016x}\n{json}")).unwrap();
        Catalog::open(&folder)
    };
    forge("old", "old").unwrap();
    for (from, to) in [
        (file.as_str(), "../../secret"),
        (file.as_str(), "/etc/passwd"),
        (file.as_str(), ""),
        (r#""name":"old""#, r#""name":"../x""#),
        (r#""name":"older""#, r#""name":"old""#),
        (r#""generation":2"#, r#""generation":18446744073709551615"#),
        (r#""generation":2"#, r#""generation":-1"#),
    ] {
        let refused = forge(from, to);
        assert!(matches!(refused, Err(CatalogError::Manifest { .. })), "{to}: {refused:?}");
    }
    fs::rename(&path, folder.join("manifest.18446744073709551615")).unwrap();
    assert!(publish(&RealDisk, &folder, "x", 1).is_err());
}

/// Publishes, replaces and removes datasets of its own, and keeps the last.
fn bustle(folder: &Path, who: &str, rounds: u16) {
    for round in 0..rounds {
        let (kept, passing) = (format!("{who}-kept"), format!("{who}-passing"));
        publish(&RealDisk, folder, &kept, round).unwrap();
        publish(&RealDisk, folder, &passing, round).unwrap();
        assert_eq!(shown(folder)[&kept], f32::from(round));
        remove_dataset(&RealDisk, folder, &passing).unwrap();
    }
}

const ROUNDS: u16 = 25;

/// Run by the test below as a process of its own, which says where in the environment.
#[test]
fn child_process() {
    if let Some(folder) = std::env::var_os("AREOID_TEST_CATALOG") {
        bustle(Path::new(&folder), "child", ROUNDS);
    }
}

#[test]
fn writers_that_meet_lose_nothing_and_readers_never_err() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    publish(&RealDisk, &folder, "first", 1).unwrap();
    let mut child = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child_process"])
        .env("AREOID_TEST_CATALOG", &folder)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let (mut generation, mut looks) = (0, 0);
            while !done.load(Ordering::Relaxed) {
                let (catalog, archives) = Catalog::open_with_archives(&folder).unwrap();
                assert!(catalog.generation() >= generation, "a catalog does not go back");
                generation = catalog.generation();
                let first = catalog.datasets().iter().position(|record| record.name == "first");
                assert_eq!(height_of(&archives[first.unwrap()]), 1.0);
                looks += 1;
            }
            looks
        });
        let writers = ["one", "two"].map(|who| {
            let folder = &folder;
            scope.spawn(move || bustle(folder, who, ROUNDS))
        });
        let ended = writers.map(|writer| writer.join());
        let child = child.wait();
        done.store(true, Ordering::Relaxed);
        ended.into_iter().for_each(Result::unwrap);
        assert!(child.unwrap().success());
        assert!(reader.join().unwrap() > 0);
    });
    let last = f32::from(ROUNDS - 1);
    let expected = [("child-kept", last), ("first", 1.0), ("one-kept", last), ("two-kept", last)];
    assert_eq!(shown(&folder), expected.map(|(name, height)| (name.to_owned(), height)).into());
    assert_eq!(Catalog::open(&folder).unwrap().generation(), 1 + 3 * 3 * u64::from(ROUNDS));
    check_swept(&folder);
}
