// present.wgsl - the finished picture onto a part of a surface, of the picture's size.
//
// Units      sRGB codes in; codes out, or linear light where the surface encodes by itself

override ENCODES: bool = false;

@group(0) @binding(0) var picture: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4f,
    // 0 to 1 over the picture, from its top left.
    @location(0) place: vec2f,
}

@vertex
fn whole_screen(@builtin(vertex_index) index: u32) -> Corner {
    let clip = vec2f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    return Corner(vec4f(clip, 0.0, 1.0), vec2f(0.5, -0.5) * clip + 0.5);
}

@fragment
fn present(in: Corner) -> @location(0) vec4f {
    let size = vec2i(textureDimensions(picture));
    let at = clamp(vec2i(floor(in.place * vec2f(size))), vec2i(0), size - 1);
    let code = textureLoad(picture, at, 0).rgb;
    let linear = select(pow((code + 0.055) / 1.055, vec3f(2.4)), code / 12.92, code <= vec3f(0.04045));
    return vec4f(select(code, linear, ENCODES), 1.0);
}
