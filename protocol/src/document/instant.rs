//! Instants in a configuration: RFC 3339 with an offset, or nanoseconds since the Unix epoch.

use toml::value::{Datetime, Offset};

use crate::time::Timestamp;

/// What [`parse_instant`] takes, for error messages.
pub const INSTANT_WANTED: &str =
    "an instant is RFC 3339 with an offset, as 2026-11-21T08:00:00Z, or nanoseconds since 1970, as 1795248000000000000";

/// The instant a TOML value names: a date-time (quoted or not) with an offset, or an integer of nanoseconds since the Unix
/// epoch. Local times are refused: hosts in other zones would start at other instants.
pub fn parse_instant(value: &toml::Value) -> Option<Timestamp> {
    match value {
        toml::Value::Integer(ns) => u64::try_from(*ns).ok().map(Timestamp),
        toml::Value::Datetime(datetime) => from_datetime(datetime),
        toml::Value::String(text) => from_datetime(&text.parse().ok()?),
        _ => None,
    }
}

fn from_datetime(datetime: &Datetime) -> Option<Timestamp> {
    let (date, time) = (datetime.date?, datetime.time?);
    let offset_min = match datetime.offset? {
        Offset::Z => 0,
        Offset::Custom { minutes } => i64::from(minutes),
    };
    let days = days_since_epoch(i64::from(date.year), i64::from(date.month), i64::from(date.day));
    let minutes = i64::from(time.hour) * 60 + i64::from(time.minute) - offset_min;
    let seconds = (days * 1440 + minutes) * 60 + i64::from(time.second.unwrap_or(0));
    let ns = i128::from(seconds) * 1_000_000_000 + i128::from(time.nanosecond.unwrap_or(0));
    u64::try_from(ns).ok().map(Timestamp)
}

/// Days from 1970-01-01 in the proleptic Gregorian calendar, by counting years from March so that the leap day comes last
/// (H. Hinnant, "chrono-compatible low-level date algorithms").
fn days_since_epoch(year: i64, month: i64, day: i64) -> i64 {
    let y = if month <= 2 { year - 1 } else { year };
    let era = y.div_euclid(400);
    let year_of_era = y.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_time_is_the_instant_that_date_dash_u_prints() {
        // `date -u -d … +%s`
        for (text, seconds) in [
            ("1970-01-01T00:00:00Z", 0),
            ("2000-02-29T12:00:00Z", 951_825_600),
            ("2026-11-21T08:00:00Z", 1_795_248_000),
            ("2026-11-21T09:30:00+01:30", 1_795_248_000),
            ("2026-11-20T23:00:00-09:00", 1_795_248_000),
            ("2100-03-01T00:00:00Z", 4_107_542_400),
        ] {
            assert_eq!(parse(&format!("\"{text}\"")), Some(Timestamp(seconds * 1_000_000_000)), "{text}");
            assert_eq!(parse(text), Some(Timestamp(seconds * 1_000_000_000)), "unquoted {text}");
        }
        assert_eq!(parse("2026-11-21T08:00:00.25Z"), Some(Timestamp(1_795_248_000_250_000_000)));
    }

    #[test]
    fn nanoseconds_are_taken_as_they_are() {
        assert_eq!(parse("1795248000000000000"), Some(Timestamp(1_795_248_000_000_000_000)));
    }

    #[test]
    fn what_names_no_instant_for_all_hosts_is_refused() {
        for text in ["2026-11-21T08:00:00", "2026-11-21", "08:00:00", "-1", "1.5", "\"noon\"", "1969-12-31T23:59:59Z"] {
            assert_eq!(parse(text), None, "{text}");
        }
    }

    fn parse(value: &str) -> Option<Timestamp> {
        let table: toml::Table = format!("at = {value}").parse().unwrap();
        parse_instant(&table["at"])
    }
}
