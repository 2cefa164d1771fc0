// ramp.wgsl - a color for each height: straight between stops, and that of the nearest beyond them.
//
// Units      sRGB codes, 0 to 1; heights in meters, not exaggerated
// Twin       style.rs: Ramp::color

// `stops`: the first of them, and how many there are, at least one.
fn ramp_at(stops: vec2u, height: f32) -> vec3f {
    var color = scene.stops[stops.x].rgb;
    for (var i = stops.x + 1u; i < stops.x + stops.y; i++) {
        let below = scene.stops[i - 1u];
        let above = scene.stops[i];
        if height >= below.w {
            let t = clamp((height - below.w) / (above.w - below.w), 0.0, 1.0);
            color = below.rgb + (above.rgb - below.rgb) * t;
        }
    }
    return color;
}
