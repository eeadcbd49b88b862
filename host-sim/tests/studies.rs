//! Studies that are sharded: the parts, merged, are the whole; and what the paper's experiment shows.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn room(name: &str) -> PathBuf {
    let room = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("studies-{name}"));
    let _ = fs::remove_dir_all(&room);
    fs::create_dir_all(&room).expect("the directory of the tests can be written");
    room
}

fn host_sim(room: &Path, arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command.current_dir(room).args(arguments.split_whitespace());
    command.output().expect("the program starts")
}

fn succeeds(room: &Path, arguments: &str) {
    let output = host_sim(room, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "`{arguments}` said {said}");
}

fn fails(room: &Path, arguments: &str) -> String {
    let output = host_sim(room, arguments);
    let said = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    assert_eq!(output.status.code(), Some(1), "`{arguments}` said {said}");
    assert_eq!(said.lines().count(), 1, "one line: {said}");
    said
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn the_papers_experiment_is_whole_in_one_run_and_in_shards() {
    let room = room("paper");
    let study = "experiment paper --quick --seeds 2 --seed 3";
    succeeds(&room, &format!("{study} --out whole"));
    for shard in 1..=3 {
        succeeds(&room, &format!("{study} --shard {shard}/3 --out parts"));
    }
    let parts = [3, 1, 2]
        .map(|shard| format!("parts/shard-{shard}-of-3.json"))
        .join(" ");
    succeeds(&room, &format!("merge {parts} --out merged"));
    let whole = text(&room.join("whole/report.json"));
    assert_eq!(whole, text(&room.join("merged/report.json")));
    let figures = [
        "fig3-excitation.svg",
        "fig6-predicted-torques.svg",
        "training-loss.svg",
        "robustness.svg",
        "efficiency.svg",
    ];
    for figure in figures {
        let svg = text(&room.join("whole").join(figure));
        assert_eq!(svg, text(&room.join("merged").join(figure)), "{figure}");
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
fn the_excitation_campaign_is_whole_in_one_run_and_in_shards() {
    let room = room("excitation");
    let study = "experiment excitation --quick --seeds 2";
    succeeds(&room, &format!("{study} --out whole"));
    for shard in 1..=2 {
        succeeds(&room, &format!("{study} --shard {shard}/2 --out parts"));
    }
    succeeds(
        &room,
        "merge parts/shard-1-of-2.json parts/shard-2-of-2.json --out merged",
    );
    let whole = text(&room.join("whole/report.json"));
    assert_eq!(whole, text(&room.join("merged/report.json")));
    assert_eq!(
        text(&room.join("whole/report.html")),
        text(&room.join("merged/report.html"))
    );
    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    assert_eq!(report["violations"], 0);
    assert_eq!(report["seeds"].as_array().map(Vec::len), Some(2));

    // What does not make a study is refused.
    let said = fails(&room, "merge parts/shard-1-of-2.json --out x");
    assert!(
        said.contains("1 of 2 jobs are missing, the first is 1"),
        "{said}"
    );
    let said = fails(&room, "merge whole/report.json --out x");
    assert!(said.contains("whole/report.json: not a shard"), "{said}");
    let said = fails(&room, "merge nowhere.json --out x");
    assert!(said.contains("nowhere.json"), "{said}");
    for (arguments, message) in [
        (
            "experiment excitation --shard 3/2 --out x",
            "'3/2' is no shard",
        ),
        (
            "experiment demo --shard 1/2 --out x",
            "unexpected argument '--shard'",
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
    ] {
        let said = fails(&room, arguments);
        assert!(said.contains(message), "{said}");
    }
    assert!(!room.join("x").exists());
}
