// frame.wgsl - places near a frame, by differences from it.
//
// A frame is a place of the reference surface with its axes; its neighborhood's normals are
// n0 + d, with d in the frame's axes. Nothing here is as large as the planet and then subtracted.
//
// Space      d: east, north, up of the frame; positions: eye-relative meters, body-fixed axes
// Precision  a few ulp of the offset from the frame, and of the frame's distance from the eye
// Mirrored   struct Frame <-> viewer/src/mirror.rs, made by mesh/frame.rs

struct Frame {
    // Eye-relative, exaggerated `height` above the reference surface.
    origin: vec3f,
    // Meters, not exaggerated: heights about the frame are told by their difference from it.
    height: f32,
    east: vec3f,
    pad0: u32,
    north: vec3f,
    pad1: u32,
    up: vec3f,
    // Where the anchors of heights, colors, luminances and normals start, and where the last end.
    lists: array<u32, 5>,
}

@group(0) @binding(1) var<storage, read> frames: array<Frame>;

// The normal's offset for the direction of (distance n0 + s), a point of a chord plane that is
// `distance` from the center: |m| - 1 in a form that does not cancel.
fn offset_from_chord(distance: f32, s: vec3f) -> vec3f {
    let along = distance + s.z;
    let across2 = dot(s.xy, s.xy);
    let length = sqrt(along * along + across2);
    return vec3f(s.xy, -across2 / (length + along)) / length;
}

// The position at d and `above` the frame's own height, in exaggerated meters.
//
// P = D n / w with D = (a², a², b²) and w² = a² - (a² - b²) nz², all in units of a; then
// P - P0 = (D d + P0 (w0 - w)) / w with w0 - w = e² dz (2 z0 + dz) / (w0 + w).
fn position_at(frame: Frame, d: vec3f, above: f32) -> vec3f {
    let world = frame.east * d.x + frame.north * d.y + frame.up * d.z;
    let flattened = vec3f(1.0, 1.0, 1.0 - scene.eccentricity2);
    let z0 = frame.up.z;
    let z = z0 + world.z;
    let w0 = sqrt(1.0 - scene.eccentricity2 * z0 * z0);
    let w = sqrt(1.0 - scene.eccentricity2 * z * z);
    let shrunk = scene.eccentricity2 * world.z * (2.0 * z0 + world.z) / (w0 + w);
    let offset = scene.equatorial_radius * (flattened * world + flattened * frame.up * (shrunk / w0)) / w;
    let climb = above * (frame.up + world) + scene.exaggeration * frame.height * world;
    return frame.origin + (offset + climb);
}
