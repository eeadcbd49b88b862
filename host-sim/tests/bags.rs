//! Logs of real arms as ROS 2 bags: identified from and replayed as they are.

use crate::program::{directory, json, number, succeeds};

fn data(name: &str) -> String {
    let bags = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ros2-bags");
    format!("{bags}/{name}")
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
            let report = json(directory.join("out/report.json"));
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
    let worst = "worst 3 s of the newest parameters";
    assert!(stdout.contains(worst), "{stdout}");
    let report = json(directory.join("out/report.json"));
    assert_eq!(
        (&report["robot"], &report["start"]),
        (&"panda".into(), &"description".into())
    );
    // 24 s at 30 Hz in 17 ticks a row; the ends belong to the filters.
    let ticks = number(&report["ticks_count"]);
    assert!((10e3..12.4e3).contains(&ticks), "{ticks}");
    assert!(number(&report["newest_vs_rich_wls_ratio"]) > 0.0);
    assert!(number(&report["frozen_vs_rich_wls_ratio"]) > 1.0);
}
