//! How much of what was drawn last shows: each figure beside the least that would have done.

use std::collections::HashSet;

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::geographic_from_normal;

use super::aovs::u32_at;
use crate::blend::Vantage;
use crate::camera::pixel_angle;
use crate::mesh::patches::Mesh;
use crate::surface::Surface;

/// What a picture was made of, and what of that shows in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Pixels that show the planet: so many are composed, each once.
    pub visible_pixels: usize,
    /// Points of the mesh at which the surface was composed.
    pub composed_points: usize,
    /// Patches drawn.
    pub patches: usize,
    /// Of them, those that some pixel shows.
    pub patches_seen: usize,
    /// Pages that the selection has for the picture.
    pub pages: usize,
    /// Of them, those from which some pixel's height, color, normal or luminance is made.
    pub pages_seen: usize,
    /// Bytes of `pages`.
    pub bytes: u64,
    /// Bytes of `pages_seen`.
    pub bytes_seen: u64,
}

impl Usage {
    /// Of a picture, by its deferred buffer.
    pub(crate) fn new(
        (view, exaggeration): (&View, f64),
        ellipsoid: &Ellipsoid,
        mesh: &Mesh,
        surface: &Surface,
        deferred: &[u8],
    ) -> Self {
        let (mut patches, mut pages) = (HashSet::new(), HashSet::new());
        let vantage = Vantage::new(view, exaggeration);
        let mut visible_pixels = 0;
        for pixel in deferred.chunks_exact(16) {
            let Some(patch) = u32_at(pixel, 0).checked_sub(1) else { continue };
            visible_pixels += 1;
            patches.insert(patch);
            let weights = [4, 8].map(|at| f32::from_bits(u32_at(pixel, at)));
            let (normal, reference, _) = mesh.place(ellipsoid, patch, weights);
            let footprint_m = reference.distance(view.eye) * pixel_angle(view);
            surface.read_at(geographic_from_normal(normal), footprint_m, &vantage, &mut pages);
        }
        let bytes_of = |page: &areoid_cache::ResidentPage| page.page.bytes() as u64;
        Self {
            visible_pixels,
            composed_points: mesh.composed_points(),
            patches: mesh.patches.len(),
            patches_seen: patches.len(),
            pages: surface.pages().count(),
            pages_seen: pages.len(),
            bytes: surface.pages().map(|page| bytes_of(page)).sum(),
            bytes_seen: surface
                .pages()
                .filter(|page| pages.contains(&(page.dataset, page.entry.page)))
                .map(|page| bytes_of(page))
                .sum(),
        }
    }
}
