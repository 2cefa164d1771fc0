// footprint.wgsl - the ground under a pixel, as a row of round samples.
//
// A pixel's cone cuts the plane of the ground in an ellipse: as wide as the pixel across the view, and
// wider along it by 1 / |direction · normal|. Seen from above, as maps see it, its axes become conjugate
// half-diameters of another ellipse, p and q: its longest is p cos θ + q sin θ with
// tan 2θ = 2 p·q / (p² - q²). Samples as wide as the pixel cover that one; where it takes too many,
// fewer and wider ones do.
//
// Space      the frame's axes, on the unit sphere
// Twin       testing/footprints.rs
// After      P. S. Heckbert, Fundamentals of Texture Mapping and Image Warping, §3.5.8

struct Footprint {
    // From one end to the other.
    axis: vec3f,
    samples: i32,
    // Ground meters to a sample.
    sample_m: f32,
}

// Longer ellipses are cut off.
const LEAST_FACING: f32 = 0.015625;

// What of a vector is seen from above.
fn from_above(axis: vec3f, frame: Frame, up: vec3f) -> vec3f {
    let level = axis - dot(axis, up) * up;
    return vec3f(dot(level, frame.east), dot(level, frame.north), dot(level, frame.up));
}

// The footprint of a pixel that looks in `direction` at ground with this normal, where the reference
// surface has `up`; all units.
fn footprint_of(frame: Frame, direction: vec3f, normal: vec3f, up: vec3f, pixel_m: f32) -> Footprint {
    if scene.anisotropy == 0 {
        return Footprint(vec3f(0.0), 1, pixel_m);
    }
    let sideways = cross(normal, direction);
    let facing = max(abs(dot(normal, direction)), LEAST_FACING);
    let across = sideways / max(length(sideways), 1e-6);
    let p = from_above(across, frame, up);
    let q = from_above(cross(across, normal) / facing, frame, up);
    // Of a circle any axis is the longest; WGSL has no angle for two zeros.
    let turn = 0.5 * atan2(2.0 * dot(p, q), dot(p, p) - dot(q, q) + 1e-12);
    let longest = cos(turn) * p + sin(turn) * q;
    let ratio = length(longest);
    let samples = clamp(i32(round(ratio)), 1, scene.anisotropy);
    let sample_m = pixel_m * max(ratio / f32(scene.anisotropy), 1.0);
    return Footprint(longest * (pixel_m / scene.equatorial_radius), samples, sample_m);
}

// The offset of a sample's place from the frame.
fn sample_place(footprint: Footprint, d: vec3f, index: i32) -> vec3f {
    let share = (f32(index) + 0.5) / f32(footprint.samples) - 0.5;
    return offset_from_chord(1.0, d + share * footprint.axis);
}
