//! The program in a directory of its own, as its users call it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// An empty directory for one test.
pub(crate) fn directory(name: &str) -> PathBuf {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
    let _ = fs::remove_dir_all(&directory);
    fs::create_dir_all(&directory).expect("the directory of the tests can be written");
    directory
}

pub(crate) fn host_sim(directory: &Path, arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command
        .current_dir(directory)
        .args(arguments.split_whitespace());
    command.output().expect("the program starts")
}

pub(crate) fn succeeds(directory: &Path, arguments: &str) -> String {
    let output = host_sim(directory, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "`{arguments}` wrote {stderr}");
    String::from_utf8(output.stdout).expect("it speaks UTF-8")
}

/// The one line that the program fails with.
pub(crate) fn fails(directory: &Path, arguments: &str) -> String {
    let output = host_sim(directory, arguments);
    let stderr = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    // 2 for a wrong command line, of which an option is named first.
    let usage = stderr.starts_with("error: --") || stderr.trim_end().ends_with("(see --help)");
    let code = 1 + i32::from(usage);
    assert_eq!(
        output.status.code(),
        Some(code),
        "`{arguments}` wrote {stderr}"
    );
    assert!(stderr.starts_with("error: "), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "one line: {stderr}");
    stderr
}

/// Names of the files in a directory.
pub(crate) fn files(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).expect("it is there");
    let name = |entry: std::io::Result<fs::DirEntry>| entry.expect("it is there").file_name();
    entries
        .map(|entry| name(entry).to_string_lossy().into_owned())
        .collect()
}

/// Two states of an arm of `joints` joints.
pub(crate) fn states(joints: usize) -> String {
    let columns = |name: &str, unit: &str| -> Vec<String> {
        (1..=joints)
            .map(|joint| format!("{name}{joint}_{unit}"))
            .collect()
    };
    let header = [
        columns("q", "rad"),
        columns("qd", "rad_s"),
        columns("qdd", "rad_s2"),
    ];
    let row = |value: f64| vec![value.to_string(); 3 * joints].join(",");
    format!(
        "{}\n{}\n{}\n",
        header.concat().join(","),
        row(0.25),
        row(-0.5)
    )
}
