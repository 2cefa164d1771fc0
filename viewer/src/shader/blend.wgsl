// blend.wgsl - how far a page of heights shows over the coarser one beneath it.
//
// With errors a of the coarser page and b of the finer one, in tolerances at the place: the coarser
// one shows alone while a ≤ 1, the finer one from a = BLENDED on, and between them both. That is continuous
// in space and time, and a search brings the finer page when a passes 1. The error of a blend with the
// share w, a + (b - a) w, is at most 1 where w is at least (a - 1) / (a - b): so much it is, however
// alike the two are.
//
// Units      eye-relative meters
// Twin       blend.rs
// After      ARCHITECTURE.md, the error on the screen

// Tolerances from which on the finer page shows alone.
override BLENDED: f32 = 1.25;

// Meters of height at a place that show as large as the tolerance across the line of sight, exaggerated where
// that makes them larger: d cos² α times the pixel's angle at the center.
fn tolerance_m_at(position: vec3f) -> f32 {
    let along = dot(scene.backward, position);
    let distance = max(length(position), 1e-6);
    let tolerance_m = along * along / distance * scene.pixel_angle * scene.tolerance_px;
    return max(tolerance_m / max(scene.exaggeration, 1.0), 1e-9);
}

fn share_of_finer(coarser: f32, finer: f32) -> f32 {
    if coarser <= 1.0 {
        return 0.0;
    }
    let gradual = (coarser - 1.0) / (BLENDED - 1.0);
    let needed = (coarser - 1.0) / max(coarser - finer, 1e-6);
    return min(max(gradual, needed), 1.0);
}

// At most what a page of heights is off by, in meters.
fn bound_of(entry: u32) -> f32 {
    return bitcast<f32>(table[scene.slot_bounds + entry_slot(entry)]);
}
