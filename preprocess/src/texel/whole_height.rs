//! Heights that are whole meters and stored as such: the commonest, at half the width.

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::codec::{self, EncodeError, Quantum, Scratch};

use super::{Mean, Planes, PlanesView, Texel, nearest_within};

impl Texel for i16 {
    const CHANNELS: usize = 1;
    const INVALID: Self = 0;
    const NOTHING: (Self, Self) = (Self::MAX, Self::MIN);

    fn channels(planes: Planes, _: Option<&[u8]>) -> Vec<Vec<Self>> {
        match planes {
            Planes::WholeHeight(plane) => vec![plane],
            _ => panic!("a dataset of whole heights has leaves of whole heights"),
        }
    }

    fn view(channels: &[Vec<Self>]) -> PlanesView<'_> {
        PlanesView::WholeHeight(&channels[0])
    }

    fn to_step(_: &mut [Vec<Self>], _: Quantum) -> Option<Option<Vec<Vec<Self>>>> {
        Some(None)
    }

    fn stored(value: f64, _: Quantum) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "a mean lies between heights")]
        let height = value.round_ties_even() as Self;
        height
    }

    fn mean(texels: &[Self], mean: Mean) -> Self {
        let sum: f64 = texels.iter().map(|&texel| f64::from(texel)).sum();
        Self::stored(sum / texels.len() as f64, mean.quantum())
    }

    #[inline(always)]
    fn halve([upper, lower]: [&[Self]; 2], _: Mean, out: &mut [Self]) {
        let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
        for (out, (&[a, b], &[c, d])) in out.iter_mut().zip(pairs) {
            let sum = i32::from(a) + i32::from(b) + i32::from(c) + i32::from(d);
            // To the nearest quarter, and from between two to the even one.
            #[expect(clippy::cast_possible_truncation, reason = "a mean lies between heights")]
            {
                *out = ((sum + 1 + (sum >> 2 & 1)) >> 2) as Self;
            }
        }
    }

    #[inline(always)]
    fn nearest(sums: &[f64], range: [&[Self]; 2], mean: Mean, out: &mut [Self]) {
        nearest_within(sums, range, mean.quantum(), out);
    }

    fn constant(texels: &[Self]) -> ConstantTexel {
        ConstantTexel(f32::from(texels[0]).to_le_bytes())
    }

    fn encode(
        planes: &[Vec<Self>],
        coverage: Option<&[u8]>,
        description: &Description,
        scratch: &mut Scratch,
        payload: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        let side = description.grid.pyramid().page_side() as usize;
        codec::encode_whole_heights_into(&planes[0], coverage, side, scratch, payload)
    }
}
