// present.wgsl - the finished picture onto a surface of the same size.
//
// Units      sRGB codes in; codes out, or linear light where the surface encodes by itself

override ENCODES: bool = false;

@group(0) @binding(0) var picture: texture_2d<f32>;

@vertex
fn whole_screen(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn present(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let code = textureLoad(picture, vec2i(position.xy), 0).rgb;
    let linear = select(pow((code + 0.055) / 1.055, vec3f(2.4)), code / 12.92, code <= vec3f(0.04045));
    return vec4f(select(code, linear, ENCODES), 1.0);
}
