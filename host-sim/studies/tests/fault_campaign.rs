//! Ten seconds of each kind of fault; `cargo xtask faults` runs the whole campaign.

use foretorque_studies::faults::{Lengths, scenarios};
use std::path::PathBuf;

#[test]
fn every_kind_of_fault_is_survived_on_every_board() {
    let scratch = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    for scenario in scenarios(Lengths::SHORT, 1, &scratch) {
        let name = scenario.name;
        let campaign = scenario
            .run()
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(campaign.is_survived(), "{campaign:?}");
    }
}
