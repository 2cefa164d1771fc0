//! What of some figures lies below which.

/// A quantile of sorted figures, between two of them where it falls there; NaN of none.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let below = place.floor() as usize;
    let beyond = place - below as f64;
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    // Either may be infinite.
    if low == high || beyond == 0.0 { low } else { low + (high - low) * beyond }
}

#[cfg(test)]
mod tests {
    use super::quantile;

    #[test]
    fn quantiles_lie_between_figures() {
        let infinite = f64::INFINITY;
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.5), 2.0);
        assert_eq!(quantile(&[1.0, 2.0, 4.0, 8.0], 0.5), 3.0);
        assert_eq!(quantile(&[1.0, infinite, infinite], 0.9), infinite);
        assert_eq!(quantile(&[1.0, 2.0, infinite], 0.5), 2.0);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
