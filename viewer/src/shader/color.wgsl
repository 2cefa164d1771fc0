// color.wgsl - the ground's color at a place, unlit.
//
//   bare ground ─▶ colors over it ─▶ ramp over both ─▶ luminances' luminance on all
//
// Units      sRGB codes, 0 to 1; heights in meters, not exaggerated
// Twin       surface.rs: Surface::color; style.rs: with_luminance_of
// After      W3C, Compositing and Blending Level 1, §10.2

fn luminance_of(color: vec3f) -> f32 {
    return dot(color, vec3f(0.3, 0.59, 0.11));
}

// A color with the luminance of another, kept within the cube.
fn with_luminance_of(color: vec3f, other: vec3f) -> vec3f {
    let wanted = luminance_of(other);
    let raised = color + (wanted - luminance_of(color));
    let least = min(raised.x, min(raised.y, raised.z));
    let most = max(raised.x, max(raised.y, raised.z));
    var factor = 1.0;
    if least < 0.0 {
        factor = wanted / (wanted - least);
    }
    if most > 1.0 {
        factor = min(factor, (1.0 - wanted) / (most - wanted));
    }
    return wanted + (raised - wanted) * factor;
}

// `height` above the reference surface, if any is known.
fn ground_color(colors: Composed, luminances: Composed, heights: Composed, height: f32) -> vec3f {
    var color = scene.bare + (colors.value - scene.bare) * colors.opacity;
    if scene.ramp_stops > 0u && heights.level >= 0.0 {
        color += (ramp_at(vec2u(0u, scene.ramp_stops), height) - color) * scene.ramp_opacity;
    }
    if luminances.opacity > 0.0 {
        color += (with_luminance_of(color, luminances.value) - color) * luminances.opacity;
    }
    return color;
}
