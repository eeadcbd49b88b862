//! The protocol page against the types.

use super::*;
use crate::bank::{ColumnId, ColumnKind};
use crate::excitation::ExcitationError;
use crate::store::StoreHealth;

const PAGE: &str = include_str!("../../../../../docs/protocol.md");

/// The line of the protocol page that begins with these cells.
fn row<'a>(page: &'a str, cells: &str) -> &'a str {
    let row = page.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
}

#[test]
fn the_protocol_page_states_the_sizes_of_the_types() {
    let page = PAGE;
    let directions = ["→", "←"].into_iter().zip(sizes::<6>()).zip(sizes::<7>());
    for ((direction, six), seven) in directions {
        for (tag, ((name, six), (_, seven))) in six.iter().zip(&seven).enumerate() {
            let line = row(page, &std::format!("| {direction} | {tag} | `{name}` |"));
            let ends = std::format!("| {six} | {seven} |");
            let same = line.ends_with(&ends);
            assert!(same, "{line}\nends with {ends} in the types");
        }
    }
    let heading = page.find("| bit | field |").unwrap();
    for field in Field::ALL {
        let line = row(&page[heading..], &std::format!("| {} | ", field as u8));
        let ends = std::format!("| {} |", field.bytes(6));
        assert!(line.ends_with(&ends), "{line}: {ends}");
    }
    for (name, resolution, range) in [
        ("position", Position::RESOLUTION, Position::MAX),
        ("velocity", Velocity::RESOLUTION, Velocity::MAX),
        ("acceleration", Acceleration::RESOLUTION, Acceleration::MAX),
        ("effort", Effort::RESOLUTION, Effort::MAX),
    ] {
        let exponent = (1.0 / resolution).log2() as u32;
        let wanted = std::format!("| {name} | 2^-{exponent} | ±{} |", range.round());
        let line = row(page, &std::format!("| {name} |"));
        assert!(line.starts_with(&wanted), "{wanted}");
    }
    let longest = Configuration::MAX_BRAKE_CLOSE_MS;
    for text in [
        std::format!("protocol version {PROTOCOL_VERSION}"),
        std::format!("by default and {longest} ms at most"),
        std::format!("| the brakes take longer to close than {longest} ms |"),
        std::format!(
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

/// Code and bytes of the payload.
fn coded(value: &impl Serialize) -> (u8, usize) {
    let mut buffer = [0; 16];
    let bytes = postcard::to_slice(value, &mut buffer).unwrap();
    (bytes[0], bytes.len() - 1)
}

#[test]
fn every_nack_code_and_width_of_the_page_is_that_of_the_type() {
    use NackReason::*;
    let reasons = [
        LearningOn,
        NotCapable,
        Period,
        Gap { expected: 1 },
        TooLong,
        Checksum,
        Bank(BankError::Checksum),
        Armed,
        Unsafe(SafetyReason::Stopped),
        Busy,
        Key,
        Store(StoreError::Empty),
        Bandwidth { every: 1 },
        Excitation(ExcitationError::NotLoaded),
        Wait { seconds: 1 },
        Brake,
    ];
    for (number, reason) in reasons.iter().enumerate() {
        let (code, bytes) = coded(reason);
        assert_eq!(usize::from(code), number);
        let line = row(PAGE, &std::format!("| {code} | `{}` |", named(reason)));
        let payload = line.split('|').nth(3).unwrap();
        let error = payload.contains("error");
        let stated = width(payload).unwrap_or(error.into());
        assert_eq!(stated, bytes, "{line}");
    }
}

#[test]
fn every_error_code_and_width_of_the_page_is_that_of_the_type() {
    use BankError as B;
    use ExcitationError as X;
    use StoreError as S;
    let bank = [
        B::NotABank,
        B::Version(1),
        B::Checksum,
        B::Malformed,
        B::TooLong,
        B::WrongArm { found: 1 },
        B::MissingColumn(1),
        B::UnknownColumn(1),
        B::Column(1),
        B::NetworkShape,
        B::Weight(1),
        B::DriveGain(1),
        B::Limit(1),
        B::Implausible(1),
    ];
    let store = [
        S::Empty,
        S::WrongArm { found: 1 },
        S::Version(1),
        S::Damaged,
        S::Bank(B::Checksum),
        S::TooLong,
        S::NotKept,
        S::Flash,
    ];
    let excitation = [
        X::WrongArm,
        X::Number(1),
        X::CertificateBeyondLimits(1),
        X::CertificateBroken(1),
        X::NotAtRest(1),
        X::NotLoaded,
        X::Running,
    ];
    let codes = |errors: &mut dyn Iterator<Item = (u8, usize)>| errors.collect::<Vec<_>>();
    for (name, codes) in [
        ("bank", codes(&mut bank.iter().map(coded))),
        ("store", codes(&mut store.iter().map(coded))),
        ("excitation", codes(&mut excitation.iter().map(coded))),
    ] {
        let errors = PAGE.find("| error | codes |").unwrap();
        let line = row(&PAGE[errors..], &std::format!("| {name} |"));
        let items: Vec<_> = line.split('|').nth(2).unwrap().split(';').collect();
        assert_eq!(items.len(), codes.len(), "{line}");
        for (item, (code, bytes)) in items.iter().zip(codes) {
            let nested = usize::from(item.contains("bank error"));
            let begins = item.trim().starts_with(&std::format!("{code} "));
            assert!(begins && width(item).unwrap_or(nested) == bytes, "{item}");
        }
    }
}

#[test]
fn the_types_of_the_hello_on_the_page_read_a_hello_to_its_end() {
    let [_, from_board] = frames::<6>();
    let mut decoder = Decoder::new();
    let mut hello: Option<BoardMessage<6>> = None;
    for &byte in &from_board[0].1 {
        if let Some(frame) = decoder.push(byte) {
            hello = frame.unwrap().message().ok();
        }
    }
    let Some(BoardMessage::Hello(mut timed)) = hello.clone() else {
        panic!("no hello");
    };
    for (counts, hz, time_us) in [
        (504_000_000, 168_000_000, Some(3_000_000)),
        (u32::MAX, 1, None),
        (5, 0, None),
    ] {
        (timed.boot_counts, timed.counter_hz) = (counts, hz);
        assert_eq!(timed.boot_us(), time_us, "{counts} at {hz} Hz");
    }
    let mut buffer = [0; MAX_FRAME];
    let mut rest = &*postcard::to_slice(&hello.unwrap(), &mut buffer).unwrap();
    rest = &rest[1..];
    let section = PAGE.split("## Hello").nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let rows = section.lines().filter(|line| line.starts_with("| "));
    for line in rows.skip(1) {
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
    let section = PAGE.split("## Statistics").nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let rows = section.lines().filter(|line| line.starts_with("| "));
    let (mut bytes, mut wanted) = (Vec::new(), Vec::new());
    for line in rows.skip(1) {
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
    assert_eq!(numbers(&std::format!("{statistics:?}")), wanted);
}

#[test]
fn every_kind_of_column_is_on_the_page() {
    for number in 0..=u8::MAX {
        let Ok(kind) = ColumnKind::try_from(number) else {
            continue;
        };
        let name = std::string::ToString::to_string(&ColumnId { kind, joint: 0 });
        let cells = std::format!("| {number} | `{}`", name.trim_end_matches('1'));
        let retired = [13, 14].contains(&number);
        assert!(PAGE.contains(&cells) || retired, "{cells}");
    }
}

#[test]
fn the_byte_examples_of_the_page_are_the_frames_of_the_types() {
    let mut wanted = String::new();
    for (direction, frames) in ["→", "←"].into_iter().zip(frames::<6>()) {
        for (tag, (name, frame)) in frames.into_iter().enumerate() {
            let hex: Vec<_> = frame
                .iter()
                .map(|byte| std::format!("{byte:02x}"))
                .collect();
            let hex = hex.join(" ");
            wanted += &std::format!("| {direction} | {tag} | `{name}` | `{hex}` |\n");
        }
    }
    assert!(PAGE.contains(&wanted), "the examples are\n{wanted}");
}
