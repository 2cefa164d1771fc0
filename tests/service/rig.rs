//! A small catalog, a service of it, and requests byte by byte.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use areoid_cache::service::{Admin, Limits, Options, Service};
use serde_json::{Value, json};
use tempfile::TempDir;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::GrayI16;

pub(crate) const TOKEN: &str = "a token of some length";
pub(crate) const NAME: &str = "pole";

/// A minute: what takes longer hangs.
pub(crate) const LONG: Duration = Duration::from_secs(60);

pub(crate) fn raster() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars/mola_north_polar_4km.tif")
}

/// Made once, and copied by each test.
static CATALOG: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    ingest(&folder.path().join("catalog"), NAME, &[]);
    folder
});

pub(crate) fn ingest(catalog: &Path, name: &str, options: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    command.arg("ingest").arg(raster()).arg("--catalog").arg(catalog).args(["--name", name]);
    let output = command.args(["--page-size", "64", "--json"]).args(options).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Heights, in a file that does not say where they lie.
pub(crate) fn write_bare(path: &Path, width: u32, height: u32) {
    let heights: Vec<i16> = (0..width * height).map(|place| (place % 997) as i16).collect();
    let mut encoder = TiffEncoder::new(fs::File::create(path).unwrap()).unwrap();
    encoder.write_image::<GrayI16>(width, height, &heights).unwrap();
}

/// Where they lie: Mars's globe.
pub(crate) fn globe() -> Value {
    let (east, north) = (10_669_445.6, 5_334_722.8);
    json!({ "crs": EQUIRECTANGULAR, "extent": [-east, -north, east, north] })
}

pub(crate) const EQUIRECTANGULAR: &str = "+proj=eqc +R=3396190 +units=m";

/// A folder with a catalog, a token, and rasters that may be inserted.
pub(crate) struct Place {
    pub(crate) folder: TempDir,
}

impl Place {
    pub(crate) fn new() -> Self {
        let folder = TempDir::new().unwrap();
        copy(&CATALOG.path().join("catalog"), &folder.path().join("catalog"));
        fs::write(folder.path().join("token"), format!("{TOKEN}\n")).unwrap();
        fs::create_dir(folder.path().join("rasters")).unwrap();
        fs::copy(raster(), folder.path().join("rasters/pole.tif")).unwrap();
        Self { folder }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn catalog(&self) -> PathBuf {
        self.path("catalog")
    }

    pub(crate) fn archive(&self) -> PathBuf {
        let mut archives = fs::read_dir(self.path("catalog/archives")).unwrap();
        archives.next().unwrap().unwrap().path()
    }

    pub(crate) fn options(&self) -> Options {
        Options {
            folder: self.catalog(),
            listen: "127.0.0.1:0".parse().unwrap(),
            memory_bytes: 16 << 20,
            admin: Some(Admin {
                listen: "127.0.0.1:0".parse().unwrap(),
                is_optional: false,
                token_file: Some(self.path("token")),
                allowed: vec![self.path("rasters")],
            }),
            threads: Some(2),
            limits: Limits { drain: Duration::from_secs(2), ..Limits::default() },
        }
    }

    pub(crate) fn insertion(&self, name: &str, more: Value) -> String {
        let mut request = json!({
            "rasters": [self.path("rasters/pole.tif")], "name": name, "page_size": 64, "threads": 1,
        });
        let more = more.as_object().unwrap().clone();
        request.as_object_mut().unwrap().extend(more);
        request.to_string()
    }
}

/// An answer, taken apart.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: BTreeMap<String, String>,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    fn parse(bytes: &[u8]) -> Option<Self> {
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n")?;
        let head = String::from_utf8_lossy(&bytes[..end]);
        let mut lines = head.split("\r\n");
        let status = lines.next()?.split(' ').nth(1)?.parse().ok()?;
        let header = |line: &str| {
            let (name, value) = line.split_once(": ")?;
            Some((name.to_owned(), value.to_owned()))
        };
        let headers = lines.filter_map(header).collect();
        Some(Self { status, headers, body: bytes[end + 4..].to_vec() })
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", String::as_str)
    }
}

pub(crate) fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream
}

/// What the server has to say yet.
pub(crate) fn rest(mut stream: TcpStream) -> Option<Answer> {
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    Answer::parse(&answer)
}

/// Sends bytes and reads until the server has no more to say.
pub(crate) fn exchange(address: SocketAddr, bytes: &[u8]) -> Option<Answer> {
    let mut stream = connect(address);
    // A server that has refused already does not read on.
    let _ = stream.write_all(bytes);
    rest(stream)
}

pub(crate) fn ask(
    address: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &str,
) -> Answer {
    let headers: String =
        headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let length = body.len();
    let request = format!(
        "{method} {path} HTTP/1.1\r\nhost: here\r\nconnection: close\r\ncontent-length: {length}\r\n{headers}\r\n{body}"
    );
    exchange(address, request.as_bytes()).unwrap_or_else(|| panic!("no answer to {method} {path}"))
}

/// Asks an admin listener for an insertion and does not wait for the answer.
pub(crate) fn begin_to_insert(admin: SocketAddr, body: &str) -> TcpStream {
    let mut stream = connect(admin);
    let length = body.len();
    write!(
        stream,
        "POST /v1/datasets HTTP/1.1\r\nhost: here\r\nconnection: close\r\nauthorization: Bearer {TOKEN}\r\ncontent-length: {length}\r\n\r\n{body}"
    )
    .unwrap();
    stream
}

pub(crate) fn get(address: SocketAddr, path: &str) -> Answer {
    ask(address, "GET", path, &[], "")
}

/// A service of a place.
pub(crate) struct Serving {
    pub(crate) place: Place,
    pub(crate) service: Service,
}

impl Serving {
    pub(crate) fn new() -> Self {
        Self::with(|_| {})
    }

    pub(crate) fn with(change: impl FnOnce(&mut Options)) -> Self {
        let place = Place::new();
        let mut options = place.options();
        change(&mut options);
        let service = Service::start(&options).unwrap();
        Self { place, service }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.service.public()
    }

    pub(crate) fn admin(&self) -> SocketAddr {
        self.service.admin().unwrap()
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        get(self.address(), path)
    }

    /// The first dataset's URL of pages, and its file.
    pub(crate) fn subject(&self) -> (String, String) {
        let catalog = self.get("/v1/catalog").json();
        let dataset = &catalog["datasets"][0];
        let text = |key: &str| dataset[key].as_str().unwrap().to_owned();
        (format!("/v1/pages/{}/{}", text("name"), text("content")), text("file"))
    }

    pub(crate) fn insert(&self, body: &str) -> Answer {
        let token = format!("Bearer {TOKEN}");
        ask(self.admin(), "POST", "/v1/datasets", &[("authorization", &token)], body)
    }

    /// Asks for an insertion and does not wait for the answer.
    pub(crate) fn begin_to_insert(&self, body: &str) -> TcpStream {
        begin_to_insert(self.admin(), body)
    }

    pub(crate) fn remove(&self, name: &str) -> Answer {
        let token = format!("Bearer {TOKEN}");
        ask(
            self.admin(),
            "DELETE",
            &format!("/v1/datasets/{name}"),
            &[("authorization", &token)],
            "",
        )
    }

    pub(crate) fn names(&self) -> Vec<String> {
        let catalog = self.get("/v1/catalog").json();
        let datasets = catalog["datasets"].as_array().unwrap();
        datasets.iter().map(|one| one["name"].as_str().unwrap().to_owned()).collect()
    }

    pub(crate) fn metric(&self, name: &str) -> f64 {
        let text = get(self.admin(), "/metrics").text();
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("no {name}")).parse().unwrap()
    }
}

/// Waits for what another thread or process is about to do.
pub(crate) fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < LONG, "never: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

pub(crate) fn soak() -> bool {
    std::env::var_os("AREOID_SOAK").is_some_and(|value| value == "1")
}
