//! How a TIFF file lays out its samples: types and bands here, chunks in [`super::chunks`].

use super::super::error::RasterError;
use super::super::samples::SampleType;
use super::directory::{Directory, Tag, TiffFile, tags};

/// What the samples of a pixel are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pixel {
    /// Samples stored for each pixel.
    pub(crate) stored: u16,
    /// Type of each sample.
    pub(crate) sample: SampleType,
    /// The stored samples that are handed out, in that order: bands, then alpha.
    pub(crate) kept: Vec<u16>,
    /// True if the last one kept is alpha.
    pub(crate) has_alpha: bool,
    /// What the samples mean.
    pub(crate) meaning: Meaning,
}

/// What has to be done to samples before they are bands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Meaning {
    /// Nothing.
    Bands,
    /// They are Y, Cb and Cr of JPEG.
    YCbCr,
    /// They are places in this table of colors.
    Palette(Vec<[u8; 3]>),
}

/// How the bytes of a chunk were compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compression {
    None,
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Zstd,
}

impl Pixel {
    pub(crate) fn read(tiff: &TiffFile, directory: &Directory) -> Result<Self, RasterError> {
        let stored = small(tiff, directory, tags::SAMPLES_PER_PIXEL, 1)?;
        if stored == 0 {
            return Err(tiff.wrong(directory, tags::SAMPLES_PER_PIXEL, 0, "at least 1"));
        }
        let sample = sample_type(tiff, directory)?;
        let photometric = small(tiff, directory, tags::PHOTOMETRIC, 1)?;
        let meaning = meaning(tiff, directory, photometric, stored, sample)?;

        let extra = tiff.integers(directory, tags::EXTRA_SAMPLES)?.unwrap_or_default();
        let Some(color) = usize::from(stored).checked_sub(extra.len()) else {
            let expected = format!("at most {stored} values");
            return Err(tiff.wrong(directory, tags::EXTRA_SAMPLES, extra.len(), expected));
        };
        // Red, green, blue and something that nothing is said of: the fourth is alpha by custom.
        let alpha = if matches!(photometric, 2) && extra.is_empty() && stored == 4 {
            Some(3)
        } else {
            (color..usize::from(stored)).find(|&at| matches!(extra.get(at - color), Some(1 | 2)))
        };
        // Unnamed extra samples are bands like the others of a gray raster, and none of a color's.
        let bands = if matches!(photometric, 0 | 1) { usize::from(stored) } else { color.min(3) };
        let mut kept: Vec<u16> =
            (0..stored).filter(|&at| usize::from(at) < bands && Some(at.into()) != alpha).collect();
        kept.extend((0..stored).find(|&at| Some(at.into()) == alpha));
        Ok(Self { stored, sample, kept, has_alpha: alpha.is_some(), meaning })
    }

    /// Bands handed out, without alpha.
    pub(crate) fn bands(&self) -> u16 {
        match self.meaning {
            Meaning::Palette(_) => 3,
            Meaning::Bands | Meaning::YCbCr => {
                let kept = u16::try_from(self.kept.len()).unwrap_or(u16::MAX);
                kept - u16::from(self.has_alpha)
            }
        }
    }
}

impl Compression {
    pub(crate) fn read(tiff: &TiffFile, directory: &Directory) -> Result<Self, RasterError> {
        let code = small(tiff, directory, tags::COMPRESSION, 1)?;
        let name = match code {
            1 => return Ok(Self::None),
            5 => return Ok(Self::Lzw),
            7 => return Ok(Self::Jpeg),
            8 | 32946 => return Ok(Self::Deflate),
            32773 => return Ok(Self::PackBits),
            50000 => return Ok(Self::Zstd),
            2..=4 => "CCITT fax",
            6 => "old-style JPEG",
            34712 => "JPEG 2000",
            34887 => "LERC",
            34925 => "LZMA",
            50001 => "WebP",
            50002 => "JPEG XL",
            _ => "unknown",
        };
        Err(RasterError::not_supported(
            tiff.file.path(),
            format!("{name} compression (code {code})"),
            "none, LZW, DEFLATE, ZSTD, PackBits, JPEG",
        ))
    }

    /// The code that tells the `tiff` crate how to decode a chunk.
    pub(crate) const fn code(self) -> u16 {
        match self {
            // ZSTD and LZW are undone before the crate sees a chunk.
            Self::None | Self::Zstd | Self::Lzw => 1,
            Self::Jpeg => 7,
            Self::Deflate => 8,
            Self::PackBits => 32773,
        }
    }

    /// A byte of a chunk stands for no more than this many bytes of samples: an upper bound of what
    /// a chunk can hold, known before anything is allocated.
    pub(crate) const fn greatest_ratio(self) -> u64 {
        match self {
            Self::None => 1,
            // A block of 128 KiB of one byte takes four.
            Self::Zstd => 32 << 10,
            Self::PackBits => 128,
            Self::Deflate => 1040,
            // LZW's longest string; and a JPEG block of 64 samples takes two bits at least.
            Self::Lzw | Self::Jpeg => 4096,
        }
    }

    /// Whether the predictor is part of this compression; elsewhere its tag means nothing.
    pub(crate) const fn has_predictor(self) -> bool {
        matches!(self, Self::Lzw | Self::Deflate | Self::Zstd)
    }
}

fn sample_type(tiff: &TiffFile, directory: &Directory) -> Result<SampleType, RasterError> {
    let bits = uniform(tiff, directory, tags::BITS_PER_SAMPLE, 1)?;
    let format = uniform(tiff, directory, tags::SAMPLE_FORMAT, 1)?;
    Ok(match (format, bits) {
        // 4 is "undefined", which readers take for unsigned.
        (1 | 4, 8) => SampleType::U8,
        (1 | 4, 16) => SampleType::U16,
        (1 | 4, 32) => SampleType::U32,
        (2, 8) => SampleType::I8,
        (2, 16) => SampleType::I16,
        (2, 32) => SampleType::I32,
        (3, 32) => SampleType::F32,
        (3, 64) => SampleType::F64,
        _ => {
            let kind = match format {
                1 | 4 => "unsigned integers",
                2 => "signed integers",
                3 => "floating-point numbers",
                _ => "complex or unknown numbers",
            };
            return Err(RasterError::not_supported(
                tiff.file.path(),
                format!("{kind} of {bits} bits"),
                "integers of 8, 16 and 32 bits, floating-point numbers of 32 and 64 bits",
            ));
        }
    })
}

fn meaning(
    tiff: &TiffFile,
    directory: &Directory,
    photometric: u16,
    stored: u16,
    sample: SampleType,
) -> Result<Meaning, RasterError> {
    let path = tiff.file.path();
    let name = match photometric {
        // Numbers other than bytes are taken as they are, whichever end is called white.
        0 if sample != SampleType::U8 => return Ok(Meaning::Bands),
        1 => return Ok(Meaning::Bands),
        2 if stored >= 3 => return Ok(Meaning::Bands),
        3 if stored == 1 && sample == SampleType::U8 => {
            let map = tiff.integers(directory, tags::COLOR_MAP)?.unwrap_or_default();
            if map.len() < 768 {
                return Err(tiff.wrong(directory, tags::COLOR_MAP, map.len(), "768 values"));
            }
            #[expect(clippy::cast_possible_truncation, reason = "the upper byte of 16 bits")]
            let channel = |at: usize| (map[at] >> 8) as u8;
            let colors = (0..256).map(|at| [channel(at), channel(at + 256), channel(at + 512)]);
            return Ok(Meaning::Palette(colors.collect()));
        }
        6 if stored == 3
            && small(tiff, directory, tags::PLANAR_CONFIGURATION, 1)? == 1
            && Compression::read(tiff, directory)? == Compression::Jpeg =>
        {
            return Ok(Meaning::YCbCr);
        }
        0 => "white is zero",
        2 => "RGB of fewer than three samples",
        3 => "a palette of other than 8 bits",
        4 => "a transparency mask",
        5 => "CMYK",
        6 => "YCbCr without JPEG, or in planes",
        8..=10 => "CIE L*a*b*",
        _ => "an unknown color space",
    };
    Err(RasterError::not_supported(
        path,
        format!("{name} (PhotometricInterpretation {photometric})"),
        "gray, RGB, 8-bit palettes, YCbCr in JPEG, each with or without alpha",
    ))
}

/// The value of a tag of small whole numbers, or `default` if the tag is missing.
pub(crate) fn small(
    tiff: &TiffFile,
    directory: &Directory,
    tag: Tag,
    default: u16,
) -> Result<u16, RasterError> {
    let Some(value) = tiff.integer(directory, tag)? else { return Ok(default) };
    u16::try_from(value).map_err(|_| tiff.wrong(directory, tag, value, "0 to 65535"))
}

/// The one value that a tag repeats for every sample.
fn uniform(
    tiff: &TiffFile,
    directory: &Directory,
    tag: Tag,
    default: u64,
) -> Result<u64, RasterError> {
    let values = tiff.integers(directory, tag)?.unwrap_or_default();
    let Some(&first) = values.first() else { return Ok(default) };
    if values.iter().any(|&value| value != first) {
        return Err(RasterError::not_supported(
            tiff.file.path(),
            format!("a different {} in every sample", tag.1),
            "samples of one type",
        ));
    }
    Ok(first)
}
