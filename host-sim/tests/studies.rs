//! Studies over ranges of seeds: concatenated records make the whole report; figures of the paper's experiment.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn directory(name: &str) -> PathBuf {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("studies-{name}"));
    let _ = fs::remove_dir_all(&directory);
    fs::create_dir_all(&directory).expect("the directory of the tests can be written");
    directory
}

fn host_sim(directory: &Path, arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command
        .current_dir(directory)
        .args(arguments.split_whitespace());
    command.output().expect("the program starts")
}

fn succeeds(directory: &Path, arguments: &str) {
    let output = host_sim(directory, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "`{arguments}` wrote {stderr}");
}

fn fails(directory: &Path, arguments: &str) -> String {
    let output = host_sim(directory, arguments);
    let stderr = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    // 2 for a wrong command line.
    let usage = stderr.starts_with("error: --") || stderr.trim_end().ends_with("(see --help)");
    let code = Some(1 + i32::from(usage));
    assert_eq!(output.status.code(), code, "`{arguments}` wrote {stderr}");
    assert_eq!(stderr.lines().count(), 1, "one line: {stderr}");
    stderr
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Runs `study` over seeds 3 and 4 at once, and in two jobs whose records are concatenated in the wrong order.
fn whole_and_in_jobs(directory: &Path, study: &str) -> String {
    succeeds(
        directory,
        &format!("{study} --seed 3 --seeds 2 --out whole"),
    );
    for seed in [3, 4] {
        let job = format!("{study} --seed {seed} --seeds 1 --records {seed}.jsonl");
        succeeds(directory, &job);
    }
    let records = text(&directory.join("4.jsonl")) + &text(&directory.join("3.jsonl"));
    fs::write(directory.join("all.jsonl"), records).expect("it can be written");
    let study = format!("{study} --seeds 2 --from all.jsonl");
    succeeds(directory, &format!("{study} --seed 3 --out jobs"));
    let whole = text(&directory.join("whole/report.json"));
    assert_eq!(whole, text(&directory.join("jobs/report.json")));
    let error = fails(directory, &format!("{study} --seed 4 --out x"));
    assert!(error.contains("all.jsonl: "), "{error}");
    assert!(error.contains("records are missing"), "{error}");
    whole
}

#[test]
fn the_papers_experiment_is_whole_in_one_run_and_in_jobs() {
    let directory = directory("paper");
    let whole = whole_and_in_jobs(&directory, "experiment paper --quick");
    let figures = [
        "fig3-excitation.svg",
        "fig6-predicted-torques.svg",
        "training-loss.svg",
        "robustness.svg",
        "efficiency.svg",
    ];
    for figure in figures {
        let svg = text(&directory.join("whole").join(figure));
        assert_eq!(svg, text(&directory.join("jobs").join(figure)), "{figure}");
        assert!(
            svg.starts_with("<svg xmlns=") && !svg.contains("var("),
            "{figure}"
        );
    }

    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    let steps = &report["steps"];
    let number = |value: &serde_json::Value| value.as_f64().expect("is a number");
    assert_eq!(steps["base_parameters"], 36);
    assert_eq!(steps["inverse_kinematics_poses"], 10_000);
    assert!(number(&steps["inverse_kinematics_error_rad"]) < 1e-6);
    // Least squares on noise-free torques is exact; the accelerated network is on its way there.
    let trained = |place: usize, key: &str| number(&steps["trained"][place][key]);
    assert!(trained(0, "base_parameter_error_ratio") < 1e-9);
    assert!(trained(2, "path_nrmse_ratio") < 0.01);
    assert!(trained(2, "validation_loss_ratio") < 0.01);
    assert!(trained(3, "path_nrmse_ratio") > 5.0 * trained(3, "validation_loss_ratio"));
    let condition = &report["conditions"][0]["methods"];
    let error = |method: &str| number(&condition[method]["path_nrmse_ratio"]);
    assert!((error("bp_physical") / error("wls") - 1.0).abs() < 0.05);
    let with_outliers = &report["conditions"][1]["methods"];
    let ratio = number(&with_outliers["irls"]["path_nrmse_ratio"])
        / number(&with_outliers["ols"]["path_nrmse_ratio"]);
    assert!(ratio < 0.7, "{ratio}");
}

#[test]
fn the_excitation_campaign_is_whole_in_one_run_and_in_jobs() {
    let directory = directory("excitation");
    let study = "experiment excitation --quick";
    let whole = whole_and_in_jobs(&directory, study);
    assert_eq!(
        text(&directory.join("whole/report.html")),
        text(&directory.join("jobs/report.html"))
    );
    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    assert_eq!(report["violations"], 0);
    assert_eq!(report["seeds"].as_array().map(Vec::len), Some(2));

    for (arguments, message) in [
        (
            "experiment excitation --from all.jsonl --out x",
            "all.jsonl: line 1 is of another configuration or version",
        ),
        (
            "experiment excitation --from whole/report.json --out x",
            "whole/report.json: line 1 is no record",
        ),
        (
            "experiment excitation --from nowhere.json --out x",
            "nowhere.json",
        ),
        (
            "experiment demo --records a --out x",
            "unexpected argument '--records'",
        ),
        (
            "experiment paper --seeds 0 --out x",
            "invalid value '0' for '--seeds <N>'",
        ),
        (
            "experiment excitation --robot nobody --out x",
            "unknown robot 'nobody'",
        ),
        (
            "experiment paper --excitation nowhere.json --out x",
            "nowhere.json",
        ),
        (
            "experiment paper --snapshot nowhere.txt --out x",
            "nowhere.txt",
        ),
    ] {
        let stderr = fails(&directory, arguments);
        assert!(stderr.contains(message), "{stderr}");
    }
    assert!(!directory.join("x").exists());
}
