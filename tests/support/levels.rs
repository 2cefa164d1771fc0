//! The oracle: what every level holds, worked out anew and without haste from the words of
//! `formats/FORMAT.md`.
//!
//! Levels are counted in *halvings*: 0 is the finest. A level of k halvings has texels of 2^k
//! finest texels. Whatever is asked outside a level is its extension.

use areoid_formats::archive::MipRule;

use super::raster::{Codes, Raster};

/// What lies past an edge of a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Edge {
    /// The edge texel, over and over.
    Repeat,
    /// The pole lies on the outline.
    PoleOnOutline,
    /// The pole lies on the centers of the outermost finest texels.
    PoleOnPosts,
}

/// The finest level's size and surroundings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shape {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) wraps: bool,
    pub(crate) north: Edge,
    pub(crate) south: Edge,
}

/// One level as it should be stored.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// One plane a channel; NaN where invalid.
    pub(crate) planes: Vec<Vec<f32>>,
    pub(crate) coverage: Vec<u8>,
}

/// All levels, finest first.
#[derive(Debug)]
pub(crate) struct Levels {
    pub(crate) shape: Shape,
    step: Option<(f64, f64)>,
    codes: Codes,
    levels: Vec<Level>,
}

impl Levels {
    /// The levels of `raster` after up to `halvings` halvings.
    pub(crate) fn new(raster: &Raster, halvings: usize) -> Self {
        let shape = raster.shape;
        let stored = |&height: &f32| match raster.step {
            _ if height.is_nan() => f32::NAN,
            Some(step) if raster.planes.len() == 1 => on_step(f64::from(height), step),
            _ => height,
        };
        let planes: Vec<Vec<f32>> =
            raster.planes.iter().map(|plane| plane.iter().map(stored).collect()).collect();
        let mut finest =
            Level { width: shape.width, height: shape.height, planes, coverage: Vec::new() };
        finest.coverage = feather(shape, &finest.planes[0]);
        let mut made = Self { shape, step: raster.step, codes: raster.codes, levels: vec![finest] };
        for halvings in 0..halvings {
            let mut coarser = made.halved(&made.levels[halvings]);
            if raster.mip == MipRule::Kaiser {
                made.low_pass(halvings, &mut coarser);
            }
            made.levels.push(coarser);
        }
        made
    }

    pub(crate) fn level(&self, halvings: usize) -> &Level {
        &self.levels[halvings]
    }

    pub(crate) fn count(&self) -> usize {
        self.levels.len()
    }

    /// The mean of the valid children, on the step; coverage the mean of all that there are.
    fn halved(&self, finer: &Level) -> Level {
        let (width, height) = (finer.width.div_ceil(2), finer.height.div_ceil(2));
        let mut planes = vec![vec![f32::NAN; width * height]; finer.planes.len()];
        let mut coverage = vec![0; width * height];
        for at in 0..width * height {
            let (row, col) = (2 * (at / width), 2 * (at % width));
            let children: Vec<usize> = [(0, 0), (0, 1), (1, 0), (1, 1)]
                .into_iter()
                .filter(|(down, right)| row + down < finer.height && col + right < finer.width)
                .map(|(down, right)| (row + down) * finer.width + col + right)
                .collect();
            for (plane, below) in planes.iter_mut().zip(&finer.planes) {
                let valid = children.iter().map(|&child| below[child]).filter(|t| !t.is_nan());
                let valid: Vec<f64> = valid.map(f64::from).collect();
                if !valid.is_empty() {
                    plane[at] = self.mean(&valid, finer.planes.len());
                }
            }
            let sum: f64 = children.iter().map(|&child| f64::from(finer.coverage[child])).sum();
            let mean = sum / children.len() as f64;
            // Full only where all are, invalid only where all are.
            let nearest = (mean + 0.5).floor();
            coverage[at] = match mean {
                0.0 => 0,
                255.0 => 255,
                _ => nearest.clamp(1.0, 254.0) as u8,
            };
        }
        Level { width, height, planes, coverage }
    }

    /// Puts in place of means what the words on the Kaiser rule say, wherever they apply.
    fn low_pass(&self, halvings: usize, coarser: &mut Level) {
        for row in 0..coarser.height {
            for col in 0..coarser.width {
                let [rows, cols] = [row, col].map(|at| 2 * at as i64 - 5..=2 * at as i64 + 6);
                let around = || rows.clone().flat_map(|r| cols.clone().map(move |c| (r, c)));
                if around().any(|(row, col)| self.coverage(halvings, row, col) == 0) {
                    continue;
                }
                let channels = coarser.planes.len();
                for channel in 0..channels {
                    let texel = |(row, col)| self.texel(halvings, channel, row, col);
                    let least = around().map(texel).fold(f32::INFINITY, f32::min);
                    let greatest = around().map(texel).fold(f32::NEG_INFINITY, f32::max);
                    let is_light = channels == 3 && self.codes == Codes::Colors;
                    let sums: Vec<f64> = rows
                        .clone()
                        .map(|row| cols.clone().map(|col| f64::from(texel((row, col)))).collect())
                        .map(|row: Vec<f64>| match is_light {
                            true => row.into_iter().map(|code| units(code, WHITE) as f64).collect(),
                            false => row,
                        })
                        .map(|row| weighted(&row))
                        .collect();
                    let sum = weighted(&sums);
                    let nearest = match self.step {
                        _ if is_light => code_of((4.0 * sum).floor() as i64),
                        _ if channels == 3 => sum.round_ties_even() as f32,
                        Some(step) => on_step(sum, step),
                        None => sum as f32,
                    };
                    coarser.planes[channel][row * coarser.width + col] =
                        nearest.clamp(least, greatest);
                }
            }
        }
    }

    fn mean(&self, valid: &[f64], channels: usize) -> f32 {
        let count = valid.len() as f64;
        if channels == 1 {
            let mean = valid.iter().sum::<f64>() / count;
            return self.step.map_or(mean as f32, |step| on_step(mean, step));
        }
        if self.codes == Codes::Normals {
            return (valid.iter().sum::<f64>() / count).round_ties_even() as f32;
        }
        mean_of_colors(valid)
    }

    /// The texel at any row and column of the extended level.
    pub(crate) fn texel(&self, halvings: usize, channel: usize, row: i64, col: i64) -> f32 {
        let level = &self.levels[halvings];
        let plane = &level.planes[channel];
        let Extended { place, next } = self.extended(halvings, row, col);
        let Some((next, below)) = next else { return plane[place] };
        let taps = [(place, 1.0 - below), (next, below)];
        let valid = || taps.iter().filter(|&&(place, _)| level.coverage[place] != 0);
        let weight: f64 = valid().map(|tap| tap.1).sum();
        if weight < 1.0 / 512.0 {
            return f32::NAN;
        }
        let sum: f64 = valid().map(|&(place, weight)| weight * f64::from(plane[place])).sum();
        match self.step {
            Some(step) if level.planes.len() == 1 => on_step(sum / weight, step),
            _ if level.planes.len() == 1 => (sum / weight) as f32,
            _ => (sum / weight).round_ties_even() as f32,
        }
    }

    /// The coverage at any row and column of the extended level.
    pub(crate) fn coverage(&self, halvings: usize, row: i64, col: i64) -> u8 {
        let coverage = &self.levels[halvings].coverage;
        let Extended { place, next } = self.extended(halvings, row, col);
        let Some((next, below)) = next else { return coverage[place] };
        let sum = f64::from(coverage[place]) * (1.0 - below) + f64::from(coverage[next]) * below;
        if sum == 0.0 { 0 } else { sum.round_ties_even().clamp(1.0, 255.0) as u8 }
    }

    /// Where a texel of the extended level comes from.
    fn extended(&self, halvings: usize, row: i64, col: i64) -> Extended {
        let level = &self.levels[halvings];
        let (width, height) = (level.width as i64, level.height as i64);
        let (turned, row, below) = self.extended_row(halvings, row, height);
        let col = match (self.shape.wraps, turned) {
            (true, true) => (col + width / 2).rem_euclid(width),
            (true, false) => col.rem_euclid(width),
            (false, _) => col.clamp(0, width - 1),
        };
        let place = (row * width + col) as usize;
        Extended { place, next: (below != 0.0).then_some((place + level.width, below)) }
    }

    /// Whether a row of the extended level lies past a pole, the row of the level that it is, and
    /// how much of the next one it has.
    fn extended_row(&self, halvings: usize, row: i64, height: i64) -> (bool, i64, f64) {
        if (0..height).contains(&row) {
            return (false, row, 0.0);
        }
        // The texel's center in finest texels from the top, turned over poles until it is back.
        let scale = (1_i64 << halvings) as f64;
        let mut y = (row as f64 + 0.5) * scale;
        let bottom = self.shape.height as f64;
        let mut turned = false;
        while !(0.0..=bottom).contains(&y) {
            let (edge, repeated, posts) = match y < 0.0 {
                true => (self.shape.north, 0, 0.5),
                false => (self.shape.south, height - 1, bottom - 0.5),
            };
            y = match edge {
                Edge::Repeat => return (turned, repeated, 0.0),
                Edge::PoleOnOutline if y < 0.0 => -y,
                Edge::PoleOnOutline => 2.0 * bottom - y,
                Edge::PoleOnPosts => 2.0 * posts - y,
            };
            turned = !turned;
        }
        let t = (y / scale - 0.5).clamp(0.0, (height - 1) as f64);
        (turned, t.floor() as i64, t - t.floor())
    }
}

/// A texel of a level, or the mean of it and the one below with that one's weight.
struct Extended {
    place: usize,
    next: Option<(usize, f64)>,
}

/// The nearest value on the step, ties to even.
pub(crate) fn on_step(value: f64, (step, offset): (f64, f64)) -> f32 {
    (((value - offset) / step).round_ties_even() * step + offset) as f32
}

/// Twelve values, weighted, from the outermost pair inward.
fn weighted(values: &[f64]) -> f64 {
    let weights = [56.0, 189.0, -461.0, -985.0, 2133.0, 7260.0];
    let pair = |at: usize| weights[at] / 16384.0 * (values[at] + values[11 - at]);
    (1..6).fold(pair(0), |sum, at| sum + pair(at))
}

const WHITE: f64 = ((1 << 22) - 1) as f64;

/// The light of a code, or between two, where white has so much.
fn units(code: f64, white: f64) -> i64 {
    (white * light_of_code(code)).round() as i64
}

/// The mean of codes in the whole numbers of FORMAT.md.
fn mean_of_colors(codes: &[f64]) -> f32 {
    let lights: i64 = codes.iter().map(|&code| units(code, WHITE)).sum();
    code_of(4 * lights / codes.len() as i64)
}

/// The code of four times so much light.
fn code_of(four_lights: i64) -> f32 {
    let passed = |&code: &u16| units(f64::from(code) + 0.5, 4.0 * WHITE) <= four_lights;
    (0..255_u16).filter(passed).count() as f32
}

fn light_of_code(code: f64) -> f64 {
    let encoded = code / 255.0;
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Coverage of the finest level: the distance in texels from a texel's center to the edge of the
/// nearest invalid texel, or place without any, over 32.
pub(crate) fn feather(shape: Shape, plane: &[f32]) -> Vec<u8> {
    const REACH: i64 = 33;
    let (width, height) = (shape.width as i64, shape.height as i64);
    let fold = |row: i64| -> Option<(i64, bool)> {
        let (mut row, mut turned) = (row, false);
        while !(0..height).contains(&row) {
            row = match (row < 0, if row < 0 { shape.north } else { shape.south }) {
                (_, Edge::Repeat) => return None,
                (true, Edge::PoleOnOutline) => -1 - row,
                (true, Edge::PoleOnPosts) => -row,
                (false, Edge::PoleOnOutline) => 2 * height - 1 - row,
                (false, Edge::PoleOnPosts) => 2 * height - 2 - row,
            };
            turned = !turned;
        }
        Some((row, turned))
    };
    let invalid = |row: i64, col: i64| -> bool {
        let Some((row, turned)) = fold(row) else { return true };
        let col = if turned { col + width / 2 } else { col };
        if !shape.wraps && !(0..width).contains(&col) {
            return true;
        }
        plane[(row * width + col.rem_euclid(width)) as usize].is_nan()
    };

    // Everything within reach, padded out, and how many invalid texels lie above and left of each.
    let (across, down) = (width + 2 * REACH, height + 2 * REACH);
    let padded: Vec<bool> =
        (0..across * down).map(|at| invalid(at / across - REACH, at % across - REACH)).collect();
    let mut sums = vec![0_u32; ((across + 1) * (down + 1)) as usize];
    for row in 0..down {
        let mut line = 0;
        for col in 0..across {
            line += u32::from(padded[(row * across + col) as usize]);
            let above = sums[(row * (across + 1) + col + 1) as usize];
            sums[((row + 1) * (across + 1) + col + 1) as usize] = above + line;
        }
    }
    let any_near = |row: i64, col: i64| {
        let side = 2 * REACH + 1;
        let at = |row: i64, col: i64| sums[(row * (across + 1) + col) as usize];
        at(row + side, col + side) + at(row, col) != at(row, col + side) + at(row + side, col)
    };
    let mut around: Vec<(i64, i64)> =
        (-REACH..=REACH).flat_map(|y| (-REACH..=REACH).map(move |x| (y, x))).collect();
    around.sort_by_key(|(y, x)| y * y + x * x);

    let code = |row: i64, col: i64| {
        if plane[(row * width + col) as usize].is_nan() {
            return 0;
        }
        if !any_near(row, col) {
            return 255;
        }
        let nearest = around
            .iter()
            .find(|(y, x)| padded[((row + REACH + y) * across + col + REACH + x) as usize]);
        let &(y, x) = nearest.unwrap();
        let distance = ((y * y + x * x) as f64).sqrt() - 0.5;
        ((distance / 32.0).min(1.0) * 255.0).round().max(1.0) as u8
    };
    (0..width * height).map(|at| code(at / width, at % width)).collect()
}
