//! World files: six numbers beside an image that say where it lies.
//!
//! ```text
//!   0.125      map units to the next column, eastward
//!   0          rotation
//!   0          rotation
//!  -0.125      map units to the next row
//!   0.0625     x of the *centre* of the first pixel
//!  89.9375     y of the centre of the first pixel
//! ```

use std::path::{Path, PathBuf};

use super::error::RasterError;
use super::fence::Fence;
use super::file::{Witness, read_text};
use super::outline::Steps;

/// The world files that could belong to a raster: `.jgw`, `.jpgw` and `.wld` for a `.jpg`, each in
/// lower case and in upper case.
pub(crate) fn candidates(path: &Path) -> Vec<PathBuf> {
    let extension = path.extension().and_then(|text| text.to_str()).unwrap_or_default();
    let lower = extension.to_ascii_lowercase();
    let mut letters = lower.chars();
    let mut names = Vec::new();
    if let (Some(first), Some(last)) = (letters.next(), letters.last()) {
        names.extend([format!("{first}{last}w"), format!("{lower}w")]);
    }
    names.push("wld".to_owned());
    names
        .iter()
        .flat_map(|name| [name.clone(), name.to_ascii_uppercase()])
        .map(|name| path.with_extension(name))
        .collect()
}

/// The geotransform of the first world file there is; it must lie `within`.
pub(crate) fn read_beside(
    path: &Path,
    within: Option<&Fence>,
) -> Result<Option<(Steps, Witness)>, RasterError> {
    for candidate in candidates(path) {
        if let Some((text, witness)) = read_text(&candidate, within)? {
            return parse(&candidate, &text).map(|steps| Some((steps, witness)));
        }
    }
    Ok(None)
}

fn parse(path: &Path, text: &str) -> Result<Steps, RasterError> {
    let mut numbers = [0.0; 6];
    let mut words = text.split_whitespace();
    for (line, number) in numbers.iter_mut().enumerate() {
        let word = words.next().unwrap_or("missing");
        let parsed: Option<f64> = word.parse().ok();
        *number = parsed.filter(|value| value.is_finite()).ok_or_else(|| {
            let field = format!("line {} of the world file", line + 1);
            RasterError::field(path, field, 0, word, "a number")
        })?;
    }
    let [dx, turn_y, turn_x, dy, x, y] = numbers;
    if turn_x != 0.0 || turn_y != 0.0 {
        let found = "a rotated world file (lines 2 and 3 are not 0)";
        return Err(RasterError::not_supported(path, found, "rows along x, columns along y"));
    }
    Ok(Steps { corner: [x - dx / 2.0, y - dy / 2.0], step: [dx, dy] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_the_first_pixel_becomes_its_corner() {
        let steps =
            parse(Path::new("a.jgw"), "0.125\r\n0\r\n0.0\r\n-0.125\n0.0625\n89.9375").unwrap();
        assert_eq!(steps, Steps { corner: [0.0, 90.0], step: [0.125, -0.125] });
    }

    #[test]
    fn rotated_or_broken_world_files_are_errors() {
        let message = |text| parse(Path::new("a.jgw"), text).unwrap_err().to_string();
        assert!(message("1 0.1 0 -1 0 0").contains("rotated"));
        assert!(message("1 0 0 -1 0").contains("line 6"), "{}", message("1 0 0 -1 0"));
        assert!(message("1 0 0 x 0 0").contains("line 4 of the world file at byte 0 is x"));
        assert!(message("1 0 0 -1 nan 0").contains("line 5"));
    }

    #[test]
    fn every_customary_name_is_tried() {
        let names: Vec<String> =
            candidates(Path::new("/d/a.b.JPG")).iter().map(|p| p.display().to_string()).collect();
        assert_eq!(names[..3], ["/d/a.b.jgw", "/d/a.b.JGW", "/d/a.b.jpgw"]);
        assert!(names.contains(&"/d/a.b.WLD".to_owned()));
        assert!(candidates(Path::new("/d/a.tiff")).contains(&"/d/a.tfw".into()));
    }
}
