//! Logs of real arms as ROS 2 bags: identified from and replayed as they are.

#[expect(dead_code, reason = "other tests use the rest of it")]
mod program;

use program::{directory, succeeds};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn data(name: &str) -> String {
    format!(
        "{}/../tests/data/ros2-bags/{name}",
        env!("CARGO_MANIFEST_DIR")
    )
}

fn report(directory: &Path) -> Value {
    let text = fs::read_to_string(directory.join("out/report.json")).expect("it was written");
    serde_json::from_str(&text).expect("it is JSON")
}

#[test]
fn a_bag_gives_the_parameters_of_the_table_that_another_reader_made_of_it() {
    for (robot, bag, filters) in [
        (
            data("ur10.toml"),
            "ur10",
            "--motion-hz 20 --torque-hz 10 --columns coulomb-viscous+offset+load",
        ),
        ("panda".to_owned(), "panda", "--motion-hz 12 --torque-hz 5"),
    ] {
        let directory = directory(&format!("bag-{bag}"));
        let tables = [data(&format!("{bag}.db3")), data(&format!("{bag}.csv.gz"))].map(|log| {
            let arguments = format!(
                "identify --robot {robot} --log {log} --methods wls {filters} --force --out out"
            );
            succeeds(&directory, &arguments);
            let report = report(&directory);
            report["methods"]["wls"]["parameters"].to_string()
        });
        assert!(tables[0].len() > 1000);
        assert_eq!(tables[0], tables[1], "{bag}");
    }
}

#[test]
fn a_bag_is_replayed_to_the_board() {
    let directory = directory("bag-replay");
    let log = data("panda.db3");
    let stdout = succeeds(
        &directory,
        &format!("replay --robot panda --log {log} --out out"),
    );
    assert!(
        stdout.contains("worst 3 s of the newest parameters"),
        "{stdout}"
    );
    let report = report(&directory);
    assert_eq!(
        (&report["robot"], &report["start"]),
        (&"panda".into(), &"description".into())
    );
    // 24 s at 30 Hz in 17 ticks a row; the ends belong to the filters.
    let ticks = report["ticks_count"].as_u64().expect("a number");
    assert!((10_000..12_400).contains(&ticks), "{ticks}");
    let newest = report["newest_vs_rich_wls_ratio"]
        .as_f64()
        .expect("a number");
    let frozen = report["frozen_vs_rich_wls_ratio"]
        .as_f64()
        .expect("a number");
    assert!(newest > 0.0 && frozen > 1.0, "{newest} {frozen}");
}
