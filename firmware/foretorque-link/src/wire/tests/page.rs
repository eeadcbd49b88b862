//! The protocol page against the types.

use super::sizes::sizes;
use super::*;

/// The line of the protocol page that begins with these cells.
fn row<'a>(page: &'a str, cells: &str) -> &'a str {
    let row = page.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
}

#[test]
fn the_protocol_page_states_the_sizes_of_the_types() {
    let page = include_str!("../../../../../docs/protocol.md");
    let directions = ["→", "←"].into_iter().zip(sizes::<6>()).zip(sizes::<7>());
    for ((direction, six), seven) in directions {
        for (tag, ((name, six), (_, seven))) in six.iter().zip(&seven).enumerate() {
            let line = row(page, &std::format!("| {direction} | {tag} | `{name}` |"));
            let ends = std::format!("| {six} | {seven} |");
            assert!(
                line.ends_with(&ends),
                "{line}\nends with {ends} in the types"
            );
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
        assert!(
            row(page, &std::format!("| {name} |")).starts_with(&wanted),
            "{wanted}"
        );
    }
    assert!(page.contains(&std::format!("protocol version {PROTOCOL_VERSION}")));
}
