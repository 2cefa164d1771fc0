// scene.wgsl - what all passes of a picture share.
//
// Space      eye-relative meters along the body-fixed axes
// Mirrored   struct Scene <-> viewer/src/mirror.rs

struct Scene {
    // The axes of the picture.
    right: vec3f,
    // Half a viewport over the tangent of half the field of view: 1 is 90 degrees.
    focal_x: f32,
    up: vec3f,
    focal_y: f32,
    backward: vec3f,
    // Distance of the near plane; the far one is infinitely far.
    near: f32,
    // Toward the sun.
    sun: vec3f,
    // Share of light that comes from everywhere.
    ambient: f32,
    // sRGB, 0 to 1, where no planet is.
    background: vec3f,
    // Factor on heights.
    exaggeration: f32,
    // Pixels.
    viewport: vec2u,
    equatorial_radius: f32,
    // First eccentricity squared.
    eccentricity2: f32,
    // sRGB, 0 to 1, where no dataset has colors.
    bare: vec3f,
    // Radians to a pixel at the center.
    pixel_angle: f32,
    // Colors, and the heights in meters that they stand for: of the ramp of composed heights, then of datasets.
    stops: array<vec4f, 256>,
    // How many are of the former: 0 for no ramp.
    ramp_stops: u32,
    ramp_opacity: f32,
    // Samples of color that a pixel takes at most; 0 for round footprints.
    anisotropy: i32,
    // Factor on light.
    exposure: f32,
    // Toward a light that is the same everywhere on the map: east, north, up. Null for the sun's.
    relief: vec3f,
    // What is shown of how the picture was made: debug.wgsl.
    debug: u32,
    // Where in the page table the bounds of the slots of heights start, as bits of f32.
    slot_bounds: i32,
    // What errors of heights may show as.
    tolerance_px: f32,
    // How many there are.
    edges: u32,
    patches: u32,
}

// Not uniform: Mesa's llvmpipe compiles a shader anew for the values of uniforms that it branches on.
@group(0) @binding(0) var<storage, read> scene: Scene;

// Reversed depth: 1 at the near plane, 0 infinitely far.
fn clip_from_eye(position: vec3f) -> vec4f {
    return vec4f(
        scene.focal_x * dot(scene.right, position),
        scene.focal_y * dot(scene.up, position),
        scene.near,
        -dot(scene.backward, position),
    );
}
