//! What GDAL adds to a TIFF file: no-data, scale, offset and unit.
//!
//! ```xml
//! <GDALMetadata>
//!   <Item name="SCALE" sample="0" role="scale">0.5</Item>
//!   <Item name="OFFSET" sample="0" role="offset">-10</Item>
//!   <Item name="UNITTYPE" sample="0" role="unittype">ft</Item>
//! </GDALMetadata>
//! ```

use super::super::error::RasterError;
use super::directory::{Directory, TiffFile, tags};

/// How samples become heights, as `sample * scale + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scaling {
    pub(super) scale: f64,
    pub(super) offset: f64,
}

/// The sample that stands for no data.
pub(super) fn nodata(tiff: &TiffFile, directory: &Directory) -> Result<Option<f64>, RasterError> {
    let text = tiff.text(directory, tags::GDAL_NODATA)?.unwrap_or_default();
    let text = text.trim();
    if text.is_empty() {
        return Ok(None);
    }
    let number = text.parse().map_err(|_| {
        tiff.wrong(directory, tags::GDAL_NODATA, format!("{text:?}"), "a number or nan")
    })?;
    Ok(Some(number))
}

/// The scale and offset of the first band, in meters; `meters_per_height` is the unit that the geo
/// keys give, if any.
pub(super) fn scaling(
    tiff: &TiffFile,
    directory: &Directory,
    meters_per_height: Option<f64>,
) -> Result<Scaling, RasterError> {
    let text = tiff.text(directory, tags::GDAL_METADATA)?.unwrap_or_default();
    let number = |role: &str, default: f64| -> Result<f64, RasterError> {
        let Some(value) = item(&text, role) else { return Ok(default) };
        let number: Option<f64> = value.parse().ok();
        number.filter(|number| number.is_finite()).ok_or_else(|| {
            let found = format!("{role} {value:?}");
            tiff.wrong(directory, tags::GDAL_METADATA, found, "a finite number")
        })
    };
    let (scale, offset) = (number("scale", 1.0)?, number("offset", 0.0)?);
    let unit = match item(&text, "unittype").map(str::to_ascii_lowercase).as_deref() {
        Some("ft" | "foot" | "feet") => 0.3048,
        Some("us-ft" | "us survey foot" | "us_survey_foot") => 1200.0 / 3937.0,
        Some("km" | "kilometer" | "kilometre" | "kilometers" | "kilometres") => 1000.0,
        Some("m" | "meter" | "metre" | "meters" | "metres") => 1.0,
        _ => meters_per_height.unwrap_or(1.0),
    };
    Ok(Scaling { scale: scale * unit, offset: offset * unit })
}

/// The text of the first band's item with this role.
fn item<'text>(text: &'text str, role: &str) -> Option<&'text str> {
    text.split("<Item ").skip(1).find_map(|item| {
        let (attributes, rest) = item.split_once('>')?;
        let attribute = |name: &str| {
            let (_, value) = attributes.split_once(&format!("{name}=\""))?;
            value.split('"').next()
        };
        let first_band = matches!(attribute("sample"), None | Some("0"));
        let has_role = attribute("role").is_some_and(|found| found.eq_ignore_ascii_case(role));
        (first_band && has_role).then(|| rest.split('<').next().unwrap_or_default().trim())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_are_found_by_their_role_in_the_first_band() {
        let text = r#"<GDALMetadata>
            <Item name="STATISTICS_MEAN" sample="0">5</Item>
            <Item name="SCALE" sample="1" role="scale">7</Item>
            <Item name="SCALE" sample="0" role="scale">0.5</Item>
            <Item name="UNITTYPE" sample="0" role="unittype"> ft </Item>"#;
        assert_eq!(item(text, "scale"), Some("0.5"));
        assert_eq!(item(text, "unittype"), Some("ft"));
        assert_eq!(item(text, "offset"), None);
        assert_eq!(item("<Item ", "scale"), None);
        assert_eq!(item("<Item role=\"scale", "scale"), None);
    }
}
