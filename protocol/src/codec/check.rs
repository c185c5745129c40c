//! Checks of single values, named after what must hold.

use super::Invalid;
use crate::fence::MAX_TERM;

/// The value is a number.
pub(crate) fn finite(field: &'static str, value: impl Into<f64>) -> Result<(), Invalid> {
    if value.into().is_finite() { Ok(()) } else { Err(Invalid::NotFinite { field }) }
}

/// All values are numbers.
pub(crate) fn all_finite<T: Into<f64> + Copy>(field: &'static str, values: &[T]) -> Result<(), Invalid> {
    values.iter().try_for_each(|value| finite(field, *value))
}

/// The value lies in the closed interval.
pub(crate) fn in_range(field: &'static str, value: impl Into<f64>, min: f64, max: f64) -> Result<(), Invalid> {
    let value = value.into();
    finite(field, value)?;
    if (min..=max).contains(&value) { Ok(()) } else { Err(Invalid::OutOfRange { field, value, min, max }) }
}

/// The value is above zero and at most `max`.
pub(crate) fn positive(field: &'static str, value: impl Into<f64>, max: f64) -> Result<(), Invalid> {
    let value = value.into();
    finite(field, value)?;
    if value > 0.0 && value <= max { Ok(()) } else { Err(Invalid::NotPositive { field, value, max }) }
}

/// A leader's term can be followed by others.
pub(crate) fn term(field: &'static str, term: u64) -> Result<(), Invalid> {
    let (value, max) = (term as f64, MAX_TERM as f64);
    if term <= MAX_TERM { Ok(()) } else { Err(Invalid::OutOfRange { field, value, min: 0.0, max }) }
}

/// At most `limit` entries.
pub(crate) fn count(field: &'static str, count: usize, limit: usize) -> Result<(), Invalid> {
    if count <= limit { Ok(()) } else { Err(Invalid::TooMany { field, count, limit }) }
}

/// At most `limit` bytes of text.
pub(crate) fn text(field: &'static str, text: &str, limit: usize) -> Result<(), Invalid> {
    if text.len() <= limit { Ok(()) } else { Err(Invalid::TooLongText { field, len: text.len(), limit }) }
}

/// The fields fit each other.
pub(crate) fn consistent(fits: bool, field: &'static str, problem: &'static str) -> Result<(), Invalid> {
    if fits { Ok(()) } else { Err(Invalid::Inconsistent { field, problem }) }
}

/// An upper triangle of `n` rows: finite, with no negative variance.
pub(crate) fn covariance<T: Into<f64> + Copy>(field: &'static str, upper: &[T], n: usize) -> Result<(), Invalid> {
    consistent(upper.len() == n * (n + 1) / 2, field, "has not n(n+1)/2 entries")?;
    all_finite(field, upper)?;
    let mut diagonal = 0;
    for row in 0..n {
        consistent(upper[diagonal].into() >= 0.0, field, "has a negative variance")?;
        diagonal += n - row;
    }
    Ok(())
}
