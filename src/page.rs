//! `areoid page`.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, PageEntry, Payload};
use areoid_formats::catalog::{Catalog, CatalogError};
use areoid_formats::page::{Kind, Page, Texels};
use image::{DynamicImage, ImageBuffer, ImageFormat};
use serde_json::{Value, json};
use tiff::encoder::{TiffEncoder, colortype};

use crate::failure::Failure;
use crate::{npy, output};

/// Write the texels of a page with its border, and say what its record says.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog.
    #[arg(value_name = "DIR")]
    catalog: PathBuf,

    /// The dataset: of a group, one part.
    dataset: String,

    /// The level, 0 coarsest.
    level: u8,

    /// Pages from the top.
    row: u32,

    /// Pages from the left.
    col: u32,

    /// Where to write the texels: .npy (heights float32, NaN without data; colors RGBA), .png
    /// (heights stretched to 16 bits) or .tif (heights float32; colors RGBA).
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Print the record as JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let archive = open(&self.catalog, &self.dataset)?;
        let page = PageAddress::new(Level(self.level), self.row, self.col);
        let pyramid = archive.description().grid.pyramid();
        if !pyramid.contains(page) {
            return Err(Failure::Misused(match pyramid.pages(page.level) {
                Some((rows, cols)) => format!(
                    "no page {}/{page}: level {} has {rows} rows of {cols} pages",
                    self.dataset, self.level
                ),
                None => format!(
                    "no level {} in {}: its finest is {}",
                    self.level,
                    self.dataset,
                    pyramid.finest().0
                ),
            }));
        }
        let entry = archive.find(page)?;
        if let Some(path) = &self.output {
            let texels = match &entry {
                Some(entry) => archive.page(entry)?,
                None => blank(&archive),
            };
            output::write_file(path, &encode(path, &texels)?)?;
        }
        let record = record(&self.dataset, page, entry.as_ref());
        if self.json {
            output::json(&record)?;
        } else {
            output::line(format_args!(
                "{}/{page}: min {}, max {}, bound {}, {:.2} % valid, {} bytes",
                self.dataset,
                record["min"],
                record["max"],
                record["bound"],
                record["valid_fraction"].as_f64().unwrap_or_default() * 100.0,
                record["bytes"],
            ))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// The archive of one dataset, of a newer generation if this one is gone.
fn open(folder: &Path, dataset: &str) -> Result<Archive, CatalogError> {
    let catalog = Catalog::open(folder)?;
    match catalog.archive(catalog.dataset(dataset)?) {
        Err(CatalogError::Missing { .. })
            if Catalog::open(folder)?.generation() > catalog.generation() =>
        {
            open(folder, dataset)
        }
        opened => opened,
    }
}

fn record(dataset: &str, page: PageAddress, entry: Option<&PageEntry>) -> Value {
    let mut record = json!({
        "dataset": dataset, "level": page.level.0, "row": page.row, "col": page.col,
        "min": null, "max": null, "bound": 0.0, "source_error": 0.0, "valid_fraction": 0.0,
        "constant": false, "full": false, "bytes": 0, "offset": null, "checksum": null,
    });
    let Some(entry) = entry else { return record };
    // JSON has no NaN: a page whose interior is empty has no least height.
    let number = |value: f32| if value.is_nan() { Value::Null } else { json!(value) };
    record["min"] = number(entry.min);
    record["max"] = number(entry.max);
    record["lowest"] = number(entry.lowest);
    record["highest"] = number(entry.highest);
    record["bound"] = json!(entry.bound);
    record["source_error"] = json!(entry.source_error);
    record["valid_fraction"] = json!(entry.valid_fraction);
    record["full"] = json!(entry.full);
    match entry.payload {
        Payload::Constant(_) => record["constant"] = json!(true),
        Payload::Record { offset, length, checksum } => {
            record["bytes"] = json!(length);
            record["offset"] = json!(offset);
            record["checksum"] = json!(format!("{checksum:016x}"));
        }
    }
    record
}

/// A page without a valid texel.
fn blank(archive: &Archive) -> Page {
    let description = archive.description();
    let side = description.grid.pyramid().page_side() as usize;
    let texels = match description.kind {
        Kind::Height => Texels::Height(vec![f32::NAN; side * side]),
        Kind::Color | Kind::Normal => Texels::Color(vec![[0; 3]; side * side]),
    };
    Page::new(side, texels, Some(vec![0; side * side]))
}

fn encode(path: &Path, page: &Page) -> Result<Vec<u8>, Failure> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let side = page.side();
    let length = u32::try_from(side).expect("a page's side");
    let mut file = Cursor::new(Vec::new());
    match (extension, page.texels()) {
        ("npy", Texels::Height(heights)) => return Ok(npy::to_bytes(&[side, side], heights)),
        ("npy", Texels::Color(_)) => return Ok(npy::to_bytes(&[side, side, 4], &rgba(page))),
        ("tif" | "tiff", Texels::Height(heights)) => {
            TiffEncoder::new(&mut file)?
                .write_image::<colortype::Gray32Float>(length, length, heights)?;
        }
        ("tif" | "tiff", Texels::Color(_)) => {
            TiffEncoder::new(&mut file)?.write_image::<colortype::RGBA8>(
                length,
                length,
                &rgba(page),
            )?;
        }
        ("png", Texels::Height(heights)) => {
            let samples = stretched(heights);
            let image = ImageBuffer::from_raw(length, length, samples);
            DynamicImage::ImageLumaA16(image.expect("two samples a texel"))
                .write_to(&mut file, ImageFormat::Png)?;
        }
        ("png", Texels::Color(_)) => {
            let image = ImageBuffer::from_raw(length, length, rgba(page));
            DynamicImage::ImageRgba8(image.expect("four samples a texel"))
                .write_to(&mut file, ImageFormat::Png)?;
        }
        _ => {
            let name = path.display();
            return Err(Failure::Misused(format!("{name}: expected .npy, .png or .tif")));
        }
    }
    Ok(file.into_inner())
}

/// Red, green, blue and coverage of each texel.
fn rgba(page: &Page) -> Vec<u8> {
    let Texels::Color(colors) = page.texels() else { return Vec::new() };
    let coverage = |at: usize| page.coverage().map_or(u8::MAX, |coverage| coverage[at]);
    let texels = colors.iter().enumerate();
    texels.flat_map(|(at, &[red, green, blue])| [red, green, blue, coverage(at)]).collect()
}

/// Heights stretched from the least to the greatest, each with its alpha.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 65535")]
fn stretched(heights: &[f32]) -> Vec<u16> {
    let valid = || heights.iter().copied().filter(|height| !height.is_nan()).map(f64::from);
    let (low, high) = (valid().fold(f64::NAN, f64::min), valid().fold(f64::NAN, f64::max));
    let scale = if high > low { 65535.0 / (high - low) } else { 0.0 };
    let samples = heights.iter().map(|&height| match height.is_nan() {
        true => [0, 0],
        false => [((f64::from(height) - low) * scale).round() as u16, u16::MAX],
    });
    samples.flatten().collect()
}
