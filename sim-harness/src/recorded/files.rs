//! Files of numbers in columns.

use std::path::Path;

use super::RecordedError;

/// Longest file, bytes.
const MAX_BYTES: u64 = 256 << 20;

/// Text of a file.
pub fn text(path: &Path) -> Result<String, RecordedError> {
    let file = path.display().to_string();
    let length = std::fs::metadata(path).map_err(|source| RecordedError::Read { file: file.clone(), source })?.len();
    if length > MAX_BYTES {
        let value = format!("{length} bytes");
        return Err(RecordedError::Format { file, line: None, value, want: "at most 256 MiB" });
    }
    std::fs::read_to_string(path).map_err(|source| RecordedError::Read { file, source })
}

/// Rows of at least `least` finite numbers, separated by blanks or commas; lines that begin with `#` are left out.
pub fn table(path: &Path, least: usize, want: &'static str) -> Result<Vec<Vec<f64>>, RecordedError> {
    checked_table(path, least, want, |_| Ok(()))
}

/// The same; `check` says what is wrong with a row: the value, and what would be right.
pub fn checked_table(
    path: &Path,
    least: usize,
    want: &'static str,
    mut check: impl FnMut(&[f64]) -> Result<(), (f64, &'static str)>,
) -> Result<Vec<Vec<f64>>, RecordedError> {
    let mut rows = Vec::new();
    for (k, line) in text(path)?.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers = line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).map(str::parse);
        match numbers.collect::<Result<Vec<f64>, _>>() {
            Ok(row) if row.len() >= least && row.iter().all(|v| v.is_finite()) => {
                if let Err((value, want)) = check(&row) {
                    let (file, value) = (path.display().to_string(), value.to_string());
                    return Err(RecordedError::Format { file, line: Some(k + 1), value, want });
                }
                rows.push(row);
            }
            _ => {
                let (file, value) = (path.display().to_string(), line.chars().take(80).collect());
                return Err(RecordedError::Format { file, line: Some(k + 1), value, want });
            }
        }
    }
    Ok(rows)
}

/// Files of a folder whose names `accept`s, sorted.
pub fn named(folder: &Path, accept: impl Fn(&str) -> bool) -> Result<Vec<std::path::PathBuf>, RecordedError> {
    let file = folder.display().to_string();
    let entries = std::fs::read_dir(folder).map_err(|source| RecordedError::Read { file, source })?;
    let mut found: Vec<_> = entries
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.file_name().and_then(|n| n.to_str()).is_some_and(&accept))
        .collect();
    found.sort();
    Ok(found)
}
