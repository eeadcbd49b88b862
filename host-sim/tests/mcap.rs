//! MCAP beside CSV: every tick, the same numbers, read back by this program and, where it is installed, by another reader.

use crate::program::{directory, host_sim, succeeds};
use std::process::Command;

/// Compares FILE.mcap with FILE.csv column by column: prints the number of rows and of topics.
const OUTSIDE: &str = "
import csv, json, sys
from mcap.reader import make_reader
rows = list(csv.DictReader(open(sys.argv[1] + '.csv')))
topics = {}
with open(sys.argv[1] + '.mcap', 'rb') as file:
    for _, channel, message in make_reader(file).iter_messages():
        topics.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
seen = set()
for messages in topics.values():
    assert len(messages) == len(rows), len(messages)
    for row, (time, values) in zip(rows, messages):
        assert time == round(float(row['t_s']) * 1e9)
        for name, value in values.items():
            assert value == float(row[name]), (name, value, row[name])
            seen.add(name)
assert seen | {'t_s'} == set(rows[0]), set(rows[0]) - seen
print(len(rows), len(topics))
";

#[test]
fn a_run_is_written_as_mcap_with_every_tick_and_the_numbers_of_the_csv() {
    let directory = directory("mcap");
    succeeds(
        &directory,
        "run --robot ur5 --trajectory validation --duration-s 3 --telemetry all/1 --out out",
    );
    let check = |log: &str| {
        let arguments = format!("identify --robot ur5 --log out/log.{log} --data-check");
        let shown = String::from_utf8(host_sim(&directory, &arguments).stdout).expect("text");
        assert!(shown.contains("joint 6"), "{shown}");
        shown.replace(&format!("log.{log}"), "log")
    };
    assert_eq!(check("csv"), check("mcap"));
    let python = |arguments: &[&str]| {
        let output = Command::new("python3")
            .args(arguments)
            .current_dir(&directory)
            .output();
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
