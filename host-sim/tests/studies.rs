//! Studies over ranges of seeds: concatenated records make the whole report; figures of the paper's experiment.

use crate::program::{directory, fails, number, refused, succeeds, text, write};
use std::path::Path;

/// Runs `study` over seeds from 3 on at once, and in jobs of one seed whose records are concatenated in the wrong order.
fn whole_and_in_jobs(directory: &Path, study: &str, seeds: u64) -> String {
    let whole = format!("{study} --seed 3 --seeds {seeds} --out whole");
    succeeds(directory, &whole);
    let mut records = String::new();
    for seed in (3..3 + seeds).rev() {
        let job = format!("{study} --seed {seed} --seeds 1 --records {seed}.jsonl");
        succeeds(directory, &job);
        records += &text(directory.join(format!("{seed}.jsonl")));
    }
    write(directory.join("all.jsonl"), records);
    let study = format!("{study} --seeds {seeds} --from all.jsonl");
    succeeds(directory, &format!("{study} --seed 3 --out jobs"));
    let whole = text(directory.join("whole/report.json"));
    assert_eq!(whole, text(directory.join("jobs/report.json")));
    let error = fails(directory, &format!("{study} --seed 4 --out x"));
    assert!(error.contains("all.jsonl: "), "{error}");
    assert!(error.contains("records are missing"), "{error}");
    whole
}

#[test]
fn the_papers_experiment_is_whole_in_one_run_and_in_jobs() {
    let directory = directory("paper");
    let whole = whole_and_in_jobs(&directory, "experiment paper --quick", 2);
    let figures = [
        "fig3-excitation.svg",
        "fig6-predicted-torques.svg",
        "training-loss.svg",
        "robustness.svg",
        "efficiency.svg",
    ];
    for figure in figures {
        let svg = text(directory.join("whole").join(figure));
        assert_eq!(svg, text(directory.join("jobs").join(figure)), "{figure}");
        assert!(
            svg.starts_with("<svg xmlns=") && !svg.contains("var("),
            "{figure}"
        );
    }

    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    let steps = &report["steps"];
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
fn the_excitation_campaign_is_the_same_from_its_record() {
    let directory = directory("excitation");
    let study = "experiment excitation --quick";
    let whole = whole_and_in_jobs(&directory, study, 1);
    assert_eq!(
        text(directory.join("whole/report.html")),
        text(directory.join("jobs/report.html"))
    );
    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    assert_eq!(report["violations"], 0);
    assert_eq!(report["seeds"].as_array().map(Vec::len), Some(1));

    for (file, message) in [
        (
            "all.jsonl",
            "all.jsonl: line 1 is of another configuration or version",
        ),
        (
            "whole/report.json",
            "whole/report.json: line 1 is no record",
        ),
    ] {
        let arguments = format!("experiment excitation --from {file} --out x");
        refused(&directory, &arguments, message);
    }
    assert!(!directory.join("x").exists());
}
