//! What pixels show, in numbers: places in f64 from the deferred buffer's patch and weights.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::geographic_from_normal;
use areoid_formats::units::Degrees;

use crate::mesh::patches::Mesh;

/// Numbers for every pixel, row by row from the top; NaN where no planet is.
#[derive(Clone, Debug, PartialEq)]
pub struct Aovs {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Body-fixed meters.
    pub position: Vec<[f64; 3]>,
    /// Longitude and latitude in degrees.
    pub geographic: Vec<[f64; 2]>,
    /// Composed meters above the reference surface, 0 where no dataset has any.
    pub height_m: Vec<f32>,
    /// The level it comes from, in the dataset with the largest share; NaN without one.
    pub level: Vec<f32>,
    /// Meters from the eye along the view's axis.
    pub depth_m: Vec<f32>,
}

impl Aovs {
    pub(crate) fn new(
        view: &View,
        ellipsoid: &Ellipsoid,
        exaggeration: f64,
        mesh: &Mesh,
        deferred: &[u8],
        measures: &[u8],
    ) -> Self {
        let [width, height] = view.viewport;
        let count = width as usize * height as usize;
        let mut aovs = Self {
            width,
            height,
            position: vec![[f64::NAN; 3]; count],
            geographic: vec![[f64::NAN; 2]; count],
            height_m: vec![f32::NAN; count],
            level: vec![f32::NAN; count],
            depth_m: vec![f32::NAN; count],
        };
        let pixels = deferred.chunks_exact(16).zip(measures.chunks_exact(8));
        for (i, (pixel, measure)) in pixels.enumerate() {
            let word = |at: usize| u32_at(pixel, at);
            let Some(patch) = word(0).checked_sub(1) else { continue };
            let weights = [word(4), word(8)].map(f32::from_bits);
            let (normal, reference, base_m) = mesh.place(ellipsoid, patch, weights);
            let height_m = base_m + f64::from(f32::from_bits(u32_at(measure, 0)));
            let level = f32::from_bits(u32_at(measure, 4));
            let position = reference + exaggeration * height_m * normal;
            let place = geographic_from_normal(normal);

            aovs.position[i] = position.to_array();
            aovs.geographic[i] =
                [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
            aovs.level[i] = if level < 0.0 { f32::NAN } else { level };
            let depth_m = -(position - view.eye).dot(view.orientation.z_axis);
            (aovs.height_m[i], aovs.depth_m[i]) = (single(height_m), single(depth_m));
        }
        aovs
    }
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

#[expect(clippy::cast_possible_truncation, reason = "rounded on purpose: heights and distances")]
fn single(meters: f64) -> f32 {
    meters as f32
}
