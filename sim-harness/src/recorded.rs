//! Recordings made by others, through the real messages and the leader (or, of a single robot among landmarks, the solver),
//! scored against their truth. One file a set; the formats are those in which the sets are published.

pub mod cmc;
pub mod feed;
pub mod files;
pub mod mrclam;
pub mod roh;
pub mod tracks;

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum RecordedError {
    /// Not readable.
    #[error("{file}: {source}")]
    Read {
        /// Which file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// Not what the set's description says.
    #[error("{file}{}: {value:?}; {want} would be right", .line.map_or_else(String::new, |l| format!(", line {l}")))]
    Format {
        /// Which file.
        file: String,
        /// Counted from 1.
        line: Option<usize>,
        /// What stands there.
        value: String,
        /// What would be right.
        want: &'static str,
    },
    /// A message that cannot be made of it.
    #[error("{0}")]
    Message(String),
}

/// The middle of some numbers; NaN of none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests;
