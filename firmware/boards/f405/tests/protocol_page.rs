//! The protocol page against the link of this chip.

use foretorque_f405::chip::{self, receive_permille};
use foretorque_link::wire::size;

/// The line of the protocol page that begins with these cells.
fn row<'a>(page: &'a str, cells: &str) -> &'a str {
    let row = page.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
}

#[test]
fn the_protocol_page_states_headroom_and_interrupt_cost() {
    let page = include_str!("../../../../docs/protocol.md");
    let permille = |bytes| size::headroom_permille(bytes, 1000, chip::LINK_BYTES_S);
    for (name, bytes) in [
        ("request, 6 joints", size::sample(6)),
        ("request, 7 joints", size::sample(7)),
        ("reply, 6 joints", size::torque(6)),
        ("reply, 7 joints", size::torque(7)),
        ("full reply, 6 joints", size::full_torque(6)),
        ("full reply, 7 joints", size::full_torque(7)),
        ("reply with motion, 6 joints", size::excited(6)),
        ("reply with motion, 7 joints", size::excited(7)),
    ] {
        let headroom = permille(bytes);
        let wanted = format!(
            "| {name} | {bytes} | {}.{} % |",
            headroom / 10,
            headroom % 10
        );
        assert_eq!(row(page, &format!("| {name} |")), wanted);
    }
    let heading = page.find("| receive interrupt |").unwrap();
    for (name, joints) in [("request, 6 joints", 6), ("request, 7 joints", 7)] {
        let share = receive_permille(size::sample(joints), 1000);
        let wanted = format!(
            "| {name} | ≤ {} | {} | {}.{} % |",
            chip::RECEIVE_INSTRUCTIONS,
            chip::RECEIVE_INSTRUCTIONS + chip::RECEIVE_OVERHEAD,
            share / 10,
            share % 10
        );
        assert_eq!(row(&page[heading..], &format!("| {name} |")), wanted);
    }
    for (name, joints) in [("six", 6), ("seven", 7)] {
        let bytes = size::sample(joints) + size::full_torque(joints);
        let share = receive_permille(bytes, 1000);
        let sums = format!(
            "({} + {}) × {}",
            size::sample(joints),
            size::full_torque(joints),
            chip::RECEIVE_INSTRUCTIONS + chip::RECEIVE_OVERHEAD
        );
        let told = format!("{}.{} %", share / 10, share % 10);
        assert!(
            page.contains(&sums) && page.contains(&told),
            "{name}: {sums}, {told}"
        );
    }
}
