//! How fast pages are encoded and decoded on one core, and how large they become.
//!
//! Decides whether the codec keeps up with the source: decoding 1 GB/s of int16 texels feeds a page
//! every half millisecond. Throughput is in bytes of the source (2 a height, 3 a color); sizes go to
//! the names of the benchmarks, in KiB.

use std::hint::black_box;

use areoid_formats::codec::{
    Quantum, Scratch, decode_color_planes_into, decode_heights_into, encode_color_planes_into,
    encode_heights_into,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const SIDE: usize = 512;

/// Fractal terrain by the diamond-square method, in meters: rougher as `roughness` grows.
fn terrain(roughness: f64) -> Vec<f64> {
    const N: usize = SIDE + 1;
    let mut state = 2026_u64;
    let mut noise = move |amplitude: f64| {
        // SplitMix64.
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        amplitude * (((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5)
    };
    let mut grid = vec![0.0; N * N];
    let (mut step, mut amplitude) = (SIDE, 6000.0);
    while step > 1 {
        let half = step / 2;
        for y in (half..N).step_by(step) {
            for x in (half..N).step_by(step) {
                let corners = grid[(y - half) * N + x - half]
                    + grid[(y - half) * N + x + half]
                    + grid[(y + half) * N + x - half]
                    + grid[(y + half) * N + x + half];
                grid[y * N + x] = corners / 4.0 + noise(amplitude);
            }
        }
        for y in (0..N).step_by(half) {
            let first = if (y / half) % 2 == 0 { half } else { 0 };
            for x in (first..N).step_by(step) {
                let mut around = Vec::new();
                if y >= half {
                    around.push(grid[(y - half) * N + x]);
                }
                if y + half < N {
                    around.push(grid[(y + half) * N + x]);
                }
                if x >= half {
                    around.push(grid[y * N + x - half]);
                }
                if x + half < N {
                    around.push(grid[y * N + x + half]);
                }
                let mean = around.iter().sum::<f64>() / around.len() as f64;
                grid[y * N + x] = mean + noise(amplitude);
            }
        }
        (step, amplitude) = (half, amplitude * roughness);
    }
    (0..SIDE * SIDE).map(|i| grid[i / SIDE * N + i % SIDE]).collect()
}

fn heights(c: &mut Criterion) {
    let meters = Quantum::new(1.0, 0.0).expect("a quantum");
    let centimeters = Quantum::new(0.01, 0.0).expect("a quantum");
    for (name, roughness, quantum) in [
        ("smooth 1 m", 0.5, meters),
        ("rough 1 m", 0.6, meters),
        ("smooth 1 cm", 0.5, centimeters),
        ("smooth float", 0.5, Quantum::NONE),
    ] {
        let texels: Vec<f32> = terrain(roughness)
            .into_iter()
            .map(|height| quantum.round(height).expect("a height in range"))
            .collect();
        let (mut scratch, mut payload) = (Scratch::default(), Vec::new());
        let mut encode = |payload: &mut Vec<u8>| {
            encode_heights_into(black_box(&texels), None, SIDE, quantum, &mut scratch, payload)
                .expect("heights on the step");
        };
        encode(&mut payload);
        let kib = payload.len() / 1024;

        let mut group = c.benchmark_group(format!("heights {name} ({kib} KiB)"));
        group.throughput(Throughput::Bytes((SIDE * SIDE * 2) as u64));
        group.bench_function("encode", |b| b.iter(|| encode(&mut payload)));
        let (mut decoded, mut coverage) = (Vec::new(), Vec::new());
        group.bench_function("decode", |b| {
            b.iter(|| {
                let bytes = black_box(&payload);
                let (texels, coverage) = (&mut decoded, &mut coverage);
                decode_heights_into(bytes, SIDE, quantum, &mut scratch, texels, coverage)
                    .expect("a payload");
            });
        });
        group.finish();
    }
}

fn colors(c: &mut Criterion) {
    let (smooth, rough) = (terrain(0.5), terrain(0.6));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let code = |value: f64| value as u8;
    let texels: Vec<[u8; 3]> = smooth
        .iter()
        .zip(&rough)
        .map(|(a, b)| [160.0 + a / 60.0, 120.0 + a / 80.0, 80.0 + a / 99.0 + b / 400.0].map(code))
        .collect();
    let planes: [Vec<u8>; 3] =
        [0, 1, 2].map(|channel| texels.iter().map(|texel| texel[channel]).collect());
    let (mut scratch, mut payload) = (Scratch::default(), Vec::new());
    let mut encode = |payload: &mut Vec<u8>| {
        let planes = planes.each_ref().map(|plane| &plane[..]);
        encode_color_planes_into(black_box(planes), None, SIDE, &mut scratch, payload)
            .expect("colors of a page");
    };
    encode(&mut payload);
    let kib = payload.len() / 1024;

    let mut group = c.benchmark_group(format!("colors ({kib} KiB)"));
    group.throughput(Throughput::Bytes((SIDE * SIDE * 3) as u64));
    group.bench_function("encode", |b| b.iter(|| encode(&mut payload)));
    let (mut decoded, mut coverage) = ([const { Vec::new() }; 3], Vec::new());
    group.bench_function("decode", |b| {
        b.iter(|| {
            let bytes = black_box(&payload);
            decode_color_planes_into(bytes, SIDE, &mut scratch, &mut decoded, &mut coverage)
                .expect("a payload");
        });
    });
    group.finish();
}

criterion_group!(benches, heights, colors);
criterion_main!(benches);
