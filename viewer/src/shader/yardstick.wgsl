// yardstick.wgsl - a picture that costs as little as one can.
//
// Units      a pattern of the pixels' places, so that no driver fills it in one go

@vertex
fn whole_screen(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fill(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return fract(position / 256.0);
}
