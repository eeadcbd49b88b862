//! The protocol page against the types.

use super::*;
use crate::bank::{ColumnId, ColumnKind};
use crate::excitation::ExcitationError;
use crate::store::StoreHealth;
use crate::telemetry::Statistics;

const PAGE: &str = include_str!("../../../../../docs/protocol.md");

/// Rows of the tables of a section, without the head of the first.
fn rows(section: &str) -> impl Iterator<Item = &'static str> {
    let section = PAGE.split(&format!("\n## {section}\n")).nth(1).unwrap();
    let lines = section.lines().take_while(|line| !line.starts_with("## "));
    lines.filter(|line| line.starts_with("| ")).skip(1)
}

/// The line of the protocol page that begins with these cells.
fn row<'a>(page: &'a str, cells: &str) -> &'a str {
    let row = page.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
}

#[test]
fn the_protocol_page_states_the_sizes_of_the_types() {
    let page = PAGE;
    let directions = ["→", "←"].into_iter().zip(frames::<6>()).zip(frames::<7>());
    for ((direction, six), seven) in directions {
        for (tag, ((name, six), (_, seven))) in six.iter().zip(&seven).enumerate() {
            let line = row(page, &format!("| {direction} | {tag} | `{name}` |"));
            let ends = format!("| {} | {} |", six.len(), seven.len());
            let same = line.ends_with(&ends);
            assert!(same, "{line}\nends with {ends} in the types");
        }
    }
    let heading = page.find("| bit | field |").unwrap();
    for field in Field::ALL {
        let line = row(&page[heading..], &format!("| {} | ", field as u8));
        let ends = format!("| {} |", field.bytes(6));
        assert!(line.ends_with(&ends), "{line}: {ends}");
    }
    for (name, resolution, range) in [
        ("position", Position::RESOLUTION, Position::MAX),
        ("velocity", Velocity::RESOLUTION, Velocity::MAX),
        ("acceleration", Acceleration::RESOLUTION, Acceleration::MAX),
        ("effort", Effort::RESOLUTION, Effort::MAX),
    ] {
        let exponent = (1.0 / resolution).log2() as u32;
        let wanted = format!("| {name} | 2^-{exponent} | ±{} |", range.round());
        let line = row(page, &format!("| {name} |"));
        assert!(line.starts_with(&wanted), "{wanted}");
    }
    let longest = Configuration::MAX_BRAKE_CLOSE_MS;
    for text in [
        format!("protocol version {PROTOCOL_VERSION}"),
        format!("by default and {longest} ms at most"),
        format!("| the brakes take longer to close than {longest} ms |"),
        format!(
            "by default and {} ms at most",
            Configuration::PERIODS_US.end() / 1000
        ),
    ] {
        assert!(page.contains(&text), "{text}");
    }
}

/// Bytes of a type that the page names.
fn width(text: &str) -> Option<usize> {
    let widths = [("u8", 1), ("i8", 1), ("u16", 2), ("u32", 4)];
    widths
        .iter()
        .find_map(|&(name, bytes)| text.contains(name).then_some(bytes))
}

/// Name and bytes of the payload of every error, in the order of their codes.
fn coded<E: DeserializeOwned + Debug>() -> Vec<(String, usize)> {
    let read = |code| {
        let bytes = [code, 0, 0, 0, 0];
        let (error, rest) = postcard::take_from_bytes::<E>(&bytes).ok()?;
        Some((named(&error), 4 - rest.len()))
    };
    (0..).map_while(read).collect()
}

#[test]
fn every_code_and_width_of_the_nack_reasons_is_that_of_the_type() {
    let mut lines = rows("Nack reasons");
    for (code, (name, bytes)) in coded::<NackReason>().iter().enumerate() {
        let line = lines.next().unwrap();
        let begins = format!("| {code} | `{name}` |");
        assert!(line.starts_with(&begins), "{line}");
        let payload = line.split('|').nth(3).unwrap();
        let error = payload.contains("error");
        assert_eq!(width(payload).unwrap_or(error.into()), *bytes, "{line}");
    }
    assert_eq!(lines.next(), Some("| error | codes |"));
    for (name, codes) in [
        ("bank", coded::<BankError>()),
        ("store", coded::<StoreError>()),
        ("excitation", coded::<ExcitationError>()),
    ] {
        let line = lines.next().unwrap();
        assert!(line.starts_with(&format!("| {name} |")), "{line}");
        let items: Vec<_> = line.split('|').nth(2).unwrap().split(';').collect();
        assert_eq!(items.len(), codes.len(), "{line}");
        for (code, (item, (_, bytes))) in items.iter().zip(codes).enumerate() {
            let nested = usize::from(item.contains("bank error"));
            let begins = item.trim().starts_with(&format!("{code} "));
            assert!(begins && width(item).unwrap_or(nested) == bytes, "{item}");
        }
    }
    assert_eq!(lines.next(), None);
}

#[test]
fn the_types_of_the_hello_on_the_page_read_a_hello_to_its_end() {
    let (_, from_board) = longest::<6>();
    let BoardMessage::Hello(mut hello) = from_board[0].clone() else {
        panic!("no hello");
    };
    for (counts, hz, time_us) in [
        (504_000_000, 168_000_000, Some(3_000_000)),
        (u32::MAX, 1, None),
        (5, 0, None),
    ] {
        (hello.boot_counts, hello.counter_hz) = (counts, hz);
        assert_eq!(hello.boot_us(), time_us, "{counts} at {hz} Hz");
    }
    let mut buffer = [0; MAX_FRAME];
    let mut rest = &*postcard::to_slice(&hello, &mut buffer).unwrap();
    for line in rows("Hello") {
        for kind in line.split('|').nth(2).unwrap().split(',') {
            let bytes = match width(kind) {
                Some(bytes) => bytes,
                None if kind.trim() == "text" => 1 + usize::from(rest[0]),
                None => panic!("{line}: {kind}"),
            };
            rest = &rest[bytes..];
        }
    }
    assert!(rest.is_empty(), "{} bytes are not on the page", rest.len());
}

/// Names and values of all numbers in the debug output of a type, in its order.
fn numbers(debug: &str) -> Vec<(String, i64)> {
    let (mut outer, mut found) = (Vec::new(), Vec::new());
    for token in debug.split_inclusive(['{', '}', ',']) {
        let (name, value) = token.split_once(": ").unwrap_or(("", token));
        let value = value.trim_end_matches([',', ' ', '}']);
        if token.ends_with('{') {
            outer.push(name.trim());
        } else if let Ok(value) = value.parse() {
            let path = outer.iter().filter(|outer| !outer.is_empty());
            let path: Vec<_> = path.copied().chain([name.trim()]).collect();
            found.push((path.join("."), value));
        }
        if token.ends_with('}') {
            outer.pop();
        }
    }
    found
}

#[test]
fn the_order_of_the_statistics_on_the_page_is_that_of_the_type() {
    let (mut bytes, mut wanted) = (Vec::new(), Vec::new());
    for line in rows("Statistics") {
        let mut cells = line.split('|').skip(1);
        let width = width(cells.next().unwrap()).unwrap();
        for name in cells.next().unwrap().split('`').skip(1).step_by(2) {
            let value = wanted.len() as u8 + 1;
            if name == "store" {
                bytes.push(StoreHealth::Failing as u8);
            } else {
                bytes.push(value);
                bytes.extend(core::iter::repeat_n(0, width - 1));
                wanted.push((name.into(), i64::from(value)));
            }
        }
    }
    let (statistics, rest) = postcard::take_from_bytes::<Statistics>(&bytes).unwrap();
    assert!(rest.is_empty());
    assert_eq!(statistics.store, StoreHealth::Failing);
    assert_eq!(numbers(&format!("{statistics:?}")), wanted);
}

#[test]
fn every_kind_of_column_is_on_the_page_or_retired() {
    for number in 0..=u8::MAX {
        let Ok(kind) = ColumnKind::try_from(number) else {
            continue;
        };
        let name = ColumnId { kind, joint: 0 }.to_string();
        let cells = format!("| {number} | `{}`", name.trim_end_matches('1'));
        let retired = ["| 13 | `Fsn`", "| 14 | `Fsw`"].contains(&&*cells);
        assert!(PAGE.contains(&cells) || retired, "{cells}");
    }
}

#[test]
fn the_byte_examples_of_the_page_are_the_frames_of_the_types() {
    let mut wanted = Vec::new();
    for (direction, frames) in ["→", "←"].into_iter().zip(frames::<6>()) {
        for (tag, (name, frame)) in frames.into_iter().enumerate() {
            let hex = frame.iter().map(|byte| format!("{byte:02x}"));
            let hex = hex.collect::<Vec<_>>().join(" ");
            wanted.push(format!("| {direction} | {tag} | `{name}` | `{hex}` |"));
        }
    }
    let stated: Vec<_> = rows("Byte examples").collect();
    assert_eq!(stated, wanted, "the examples are\n{}", wanted.join("\n"));
}
