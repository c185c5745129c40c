//! Seeds on the command line: `0..9` with both ends, or `1,3,7`.

/// Most seeds at once.
const MAX_SEEDS: usize = 10_000;

/// At least one seed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seeds(pub Vec<u64>);

/// Reads a range or a list.
pub fn parse(text: &str) -> Result<Seeds, String> {
    let wanted = "a range with both ends like 0..9, or a list like 1,3,7";
    let number = |part: &str| part.trim().parse::<u64>().map_err(|_| format!("{part:?} is no seed; give {wanted}"));
    let seeds: Vec<u64> = match text.split_once("..") {
        Some((first, last)) => {
            let (first, last) = (number(first)?, number(last.trim_start_matches('='))?);
            if last < first || last - first >= MAX_SEEDS as u64 {
                return Err(format!("{text:?} is no range of 1 to {MAX_SEEDS} seeds; give {wanted}"));
            }
            (first..=last).collect()
        }
        None => text.split(',').map(number).collect::<Result<_, _>>()?,
    };
    Ok(Seeds(seeds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_has_both_ends_and_a_list_keeps_its_order() {
        assert_eq!(parse("0..9").unwrap().0, (0..=9).collect::<Vec<_>>());
        assert_eq!(parse("2..=3").unwrap().0, [2, 3]);
        assert_eq!(parse("7, 1").unwrap().0, [7, 1]);
        assert_eq!(parse("7").unwrap().0, [7]);
    }

    #[test]
    fn what_is_no_seed_is_named() {
        assert!(parse("9..0").unwrap_err().contains("9..0"));
        assert!(parse("a").unwrap_err().contains("\"a\""));
        assert!(parse("0..99999999").is_err());
    }
}
