//! The bytes of wire version 1 as they stand in `protocol/golden/v1`, one file a message, hexadecimal. They change only with
//! the wire version (until the first release: knowingly). `UPDATE_GOLDEN=1 cargo test -p protocol golden` writes them.

use std::fmt::Write;
use std::path::PathBuf;

use super::*;

#[test]
fn every_message_has_its_golden_bytes_and_reads_them_back() {
    for_every_message!(is_golden);
}

fn is_golden<M: Message + PartialEq>(name: &str, message: &M) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("golden/v{WIRE_VERSION}/{name}.hex"));
    let envelope = encode(message).unwrap();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, to_hex(&envelope)).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap();
    assert_eq!(to_hex(&envelope), golden, "the encoding of {name} has changed");
    assert_eq!(decode::<M>(&from_hex(&golden)).unwrap(), *message, "the golden {name} is read as something else");
}

/// 32 bytes a line.
fn to_hex(bytes: &[u8]) -> String {
    let mut text = String::new();
    for line in bytes.chunks(32) {
        for byte in line {
            write!(text, "{byte:02x}").unwrap();
        }
        text.push('\n');
    }
    text
}

fn from_hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
