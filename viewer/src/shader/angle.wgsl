// angle.wgsl - the angle of a vector, the same on every device.
//
// WGSL allows atan2 an error of 4096 ulp and drivers differ; texel addresses need more, and
// pictures that agree need the same.
//
// Precision  3 ulp of the result, also for small angles
// After      S. Moshier, Cephes library, atanf: reduction at tan(pi/8), odd polynomial

const HALF_PI: f32 = 1.57079632679;
const QUARTER_PI: f32 = 0.785398163397;
const TAN_EIGHTH_PI: f32 = 0.414213562373;

// The arctangent of t in [0, 1].
fn arctangent(t: f32) -> f32 {
    let upper = t > TAN_EIGHTH_PI;
    let x = select(t, (t - 1.0) / (t + 1.0), upper);
    let x2 = x * x;
    let p = ((8.05374449538e-2 * x2 - 1.38776856032e-1) * x2 + 1.99777106478e-1) * x2 - 3.33329491539e-1;
    return select(0.0, QUARTER_PI, upper) + (p * x2 * x + x);
}

// The angle from the x axis to (x, y), in [-pi, pi]; 0 for the null vector.
fn angle_of(y: f32, x: f32) -> f32 {
    let across = abs(y);
    let along = abs(x);
    let larger = max(across, along);
    if larger == 0.0 {
        return 0.0;
    }
    var angle = arctangent(min(across, along) / larger);
    if across > along {
        angle = HALF_PI - angle;
    }
    if x < 0.0 {
        angle = 2.0 * HALF_PI - angle;
    }
    return select(angle, -angle, y < 0.0);
}
