//! What can be told of two pictures of a window without knowing what they should be.

use image::RgbImage;
use image::imageops::crop_imm;

/// Percent of the pixels in a part of a picture, whose corners are shares of its sides, that are not
/// as dark as space.
pub(crate) fn lit(picture: &RgbImage, from: [f64; 2], to: [f64; 2]) -> u32 {
    const DARK: u8 = 12;

    let within = |at: u32, side: u32, from: f64, to: f64| {
        let share = (f64::from(at) + 0.5) / f64::from(side);
        (from..to).contains(&share)
    };
    let [width, height] = [picture.width(), picture.height()];
    let (mut all, mut bright) = (0, 0);
    for (x, y, pixel) in picture.enumerate_pixels() {
        if within(x, width, from[0], to[0]) && within(y, height, from[1], to[1]) {
            all += 1;
            bright += u32::from(pixel.0.iter().any(|&code| code > DARK));
        }
    }
    100 * bright / all
}

/// Percent of the pixels that differ visibly, rounded down; all of them if the sizes do.
pub(crate) fn changed(one: &RgbImage, other: &RgbImage) -> u32 {
    const VISIBLE: u8 = 6;

    if one.dimensions() != other.dimensions() {
        return 100;
    }
    let pairs = one.pixels().zip(other.pixels());
    let differ = pairs.filter(|(one, other)| {
        one.0.iter().zip(other.0).any(|(&one, other)| one.abs_diff(other) > VISIBLE)
    });
    100 * u32::try_from(differ.count()).unwrap() / (one.width() * one.height())
}

/// How far red is above blue, in the mean.
pub(crate) fn redness(picture: &RgbImage) -> i64 {
    let above = picture.pixels().map(|pixel| i64::from(pixel.0[0]) - i64::from(pixel.0[2]));
    above.sum::<i64>() / i64::from(picture.width() * picture.height())
}

/// The left and the right half.
pub(crate) fn halves(picture: &RgbImage) -> [RgbImage; 2] {
    let [width, height] = [picture.width() / 2, picture.height()];
    [0, width].map(|left| crop_imm(picture, left, 0, width, height).to_image())
}
