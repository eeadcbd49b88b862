//! Logs of real arms as ROS 2 bags, identified from and replayed as they are; and MCAP beside CSV: every tick, the same
//! numbers, read back by this program and, where it is installed, by another reader.

use crate::{assert_contains, directory, host_sim, json, number, succeeds};
use std::process::Command;

fn data(name: &str) -> String {
    let bags = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ros2-bags");
    format!("{bags}/{name}")
}

#[test]
fn a_bag_gives_the_parameters_of_the_table_that_another_reader_made_of_it() {
    let of_ur10 = "--motion-hz 20 --torque-hz 10 --columns coulomb-viscous+offset+load";
    for (robot, bag, filters) in [
        (data("ur10.toml"), "ur10", of_ur10),
        // At 30 rows a second the cut-offs follow from the rows.
        ("panda".to_owned(), "panda", ""),
    ] {
        let here = directory(&format!("bag-{bag}"));
        let tables = ["db3", "csv.gz"].map(|kind| {
            let log = data(&format!("{bag}.{kind}"));
            let identify = format!("identify --robot {robot} --log {log} --methods wls {filters}");
            succeeds(&here, &format!("{identify} --force --out out"));
            let report = json(here.join("out/report.json"));
            report["methods"]["wls"]["parameters"].to_string()
        });
        assert!(tables[0].len() > 1000);
        assert_eq!(tables[0], tables[1], "{bag}");
    }
}

#[test]
fn bags_are_replayed_to_the_board_which_learns_them_without_harm_or_alarm() {
    // Panda: 24 s at 30 Hz in 17 ticks a row. UR10: 27.5 s at 125 Hz in 4 ticks a row. The ends belong to the filters.
    for (robot, bag, ticks) in [
        ("panda".to_owned(), "panda", 10e3..12.4e3),
        (data("ur10.toml"), "ur10", 13e3..13.8e3),
    ] {
        let here = directory(&format!("bag-replay-{bag}"));
        let log = data(&format!("{bag}.db3"));
        let replay = format!("replay --robot {robot} --log {log} --out out");
        succeeds(&here, &replay);
        let report = json(here.join("out/report.json"));
        assert_eq!(report["robot"], bag);
        assert_eq!(report["start"], "description");
        let seen = number(&report["ticks_count"]);
        assert!(ticks.contains(&seen), "{bag}: {seen}");
        let worst = number(&report["worst_window_over_start_ratio"]);
        assert!(worst < 0.5, "{bag}: {worst}");
        assert!(number(&report["frozen_vs_rich_wls_ratio"]) > 1.0);
        let decisions = report["decisions"].as_array().expect("a list");
        let alarms = decisions.iter().filter(|own| own["reason"] == "alarm");
        assert_eq!(alarms.count(), 0, "{bag}: {decisions:?}");
    }
}

/// Compares FILE.mcap with FILE.csv column by column: prints the number of rows and of topics.
const OUTSIDE: &str = include_str!("compare_mcap.py");

#[test]
fn a_run_is_written_as_mcap_with_every_tick_and_the_numbers_of_the_csv() {
    let here = directory("mcap");
    let run = "run --robot ur5 --trajectory validation --duration-s 3 --telemetry all/1 --out out";
    succeeds(&here, run);
    let check = |log: &str| {
        let arguments = format!("identify --robot ur5 --log out/log.{log} --data-check");
        let shown = String::from_utf8(host_sim(&here, &arguments).stdout).expect("text");
        assert_contains(&shown, "joint 6");
        shown.replace(&format!("log.{log}"), "log")
    };
    assert_eq!(check("csv"), check("mcap"));
    let python = |arguments: &[&str]| {
        let mut python = Command::new("python3");
        let output = python.args(arguments).current_dir(&here).output();
        output.ok().filter(|output| output.status.success())
    };
    if python(&["-c", "import mcap"]).is_none() {
        return;
    }
    for (table, expected) in [("out/log", "3000 "), ("out/telemetry", "2999 ")] {
        let output = python(&["-c", OUTSIDE, table]).expect("the tables agree");
        let shown = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(shown.starts_with(expected), "{table}: {shown}");
    }
}
