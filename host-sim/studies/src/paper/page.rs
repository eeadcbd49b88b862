//! The study as a page.

use super::PaperReport;
use super::curves::Curves;
use super::figures::{
    METHODS, efficiency_panel, loss_legend, loss_panels, method_legend, path_legend, path_panels,
    robustness_panels,
};
use super::findings::{of_times, percent};
use super::summary::Times;
use foretorque_workbench::excitation::page::{figure, legend};
use foretorque_workbench::report::page::{Section, Tile, html, table};
use foretorque_workbench::report::plot::grid;
use std::error::Error;

const NEEDED: &str =
    "The data sheet's UR5 as the known arm, links alone: no friction, no rotors, no noise.";

pub(super) fn page(
    report: &PaperReport<'_>,
    curves: &Curves,
    times: &Times,
) -> Result<String, Box<dyn Error>> {
    let steps = report.steps;
    let text = |text: &str| text.to_owned();
    let physical = &steps.trained[2];
    let tile = |value: String, label: &str| Tile {
        value,
        label: label.to_owned(),
    };
    let tiles = [
        tile(
            percent(physical.path_nrmse_ratio),
            "torque error on the arbitrary path, BP network with physical weights, no noise",
        ),
        tile(
            percent(physical.base_parameter_error_ratio.unwrap_or(0.0)),
            "error of the base parameters, over their norm",
        ),
        tile(
            percent(steps.trained[3].path_nrmse_ratio),
            "the same path by a BP network with a hidden layer",
        ),
        tile(
            format!("{:.0e} rad", steps.inverse_kinematics_error_rad),
            "joint sequence through inverse kinematics, largest error",
        ),
    ];
    let section = |heading: &str, caption: String, legend, body| Section {
        heading: heading.to_owned(),
        caption,
        legend,
        body,
    };
    let mut told: Vec<String> = report.findings.to_vec();
    told.extend(of_times(times));
    let told: Vec<Vec<String>> = told.into_iter().map(|finding| vec![finding]).collect();
    let findings = table(&["what the figures say"], &told);
    let sections = [
        section(
            "Findings",
            text("Sentences made from the figures below, whichever way they go."),
            Vec::new(),
            findings,
        ),
        section(
            "Fig. 3: excitation trajectories",
            format!(
                "Step (1). {} poses of the flange along it, turned into joint positions by the closed-form inverse kinematics, branch by \
                 continuation.",
                steps.inverse_kinematics_poses
            ),
            legend::<6>(),
            figure::<6>(&report.config.excitation)?,
        ),
        section(
            "Training",
            format!(
                "Steps (2) and (3). {NEEDED} {} instants trained on, {} held out; {} base parameters. Loss: RMSE (eq. 20), every \
                 joint over its RMS torque.",
                steps.training_rows, steps.validation_rows, steps.base_parameters
            ),
            loss_legend(),
            grid(&loss_panels(curves), 1, 900, 280)? + &trained_table(report),
        ),
        section(
            "Fig. 6: predicted moments on the arbitrary path",
            text("Step (4). Quintics through via points that none of the models has seen."),
            path_legend(),
            grid(&path_panels(curves), 2, 560, 250)? + &joints_table(report),
        ),
        section(
            "Robustness",
            format!(
                "{} draws of each condition: arm (masses up to 20 % off), noise, outliers of 20 % of the torque limit, 80/20 split and \
                 unseen path. Error against the noise-free torque, moving rows, root mean square over the draws; logarithmic: 1 is \
                 10 %, 0 is 1 %, −1 is 0.1 %.",
                report.config.seeds
            ),
            method_legend(),
            grid(&robustness_panels(report.conditions), 3, 370, 270)? + &robustness_table(report),
        ),
        section(
            "Efficiency",
            text("Error by number of training rows, and seconds of training (least of the draws)."),
            method_legend(),
            grid(&efficiency_panel(report.conditions), 1, 900, 280)? + &times_table(times),
        ),
        section(
            "Base parameters",
            text(
                "BP network with physical weights, accelerated, against the truth. First independent columns from left to right, \
                  Craig link frames, about the link origin.",
            ),
            Vec::new(),
            parameters_table(report),
        ),
    ];
    Ok(html(
        "The paper's experiment on the UR5",
        "Y. Zhong, Identification of Robot Dynamic Parameters Based on BP Neural Network, section 4.1, step by step; then the \
         robustness and efficiency it asserts, measured.",
        &tiles,
        &sections,
    ))
}

fn trained_table(report: &PaperReport<'_>) -> String {
    let rows: Vec<Vec<String>> = report
        .steps
        .trained
        .iter()
        .map(|trained| {
            vec![
                trained.name.to_owned(),
                trained.epochs.to_string(),
                percent(trained.training_loss_ratio),
                percent(trained.validation_loss_ratio),
                trained
                    .base_parameter_error_ratio
                    .map_or("–".to_owned(), percent),
                percent(trained.path_nrmse_ratio),
            ]
        })
        .collect();
    table(
        &[
            "method",
            "epochs",
            "loss, 80 %",
            "loss, 20 %",
            "parameter error",
            "error on the path",
        ],
        &rows,
    )
}

fn joints_table(report: &PaperReport<'_>) -> String {
    let rows: Vec<Vec<String>> = (1..)
        .zip(&report.steps.joints)
        .map(|(joint, torque)| {
            vec![
                format!("joint {joint}"),
                format!("{:.3}", torque.torque_rms_nm),
                format!("{:.2e}", torque.bp_physical_rmse_nm),
                format!("{:.2e}", torque.bp_physical_peak_nm),
                format!("{:.3}", torque.bp_black_box_rmse_nm),
                format!("{:.3}", torque.bp_black_box_peak_nm),
            ]
        })
        .collect();
    table(
        &[
            "N·m",
            "torque RMS",
            "physical weights, RMSE",
            "peak error",
            "hidden layer, RMSE",
            "peak error",
        ],
        &rows,
    )
}

fn robustness_table(report: &PaperReport<'_>) -> String {
    let full = report.conditions.iter().map(|c| c.rows).max().unwrap_or(0);
    let rows: Vec<Vec<String>> = report
        .conditions
        .iter()
        .filter(|c| c.rows == full)
        .map(|c| {
            let mut row = vec![format!(
                "{}, {} % noise, {} % outliers",
                c.friction.name(),
                c.noise_percent,
                c.outlier_percent
            )];
            row.extend(METHODS.iter().map(|(name, _)| {
                let method = c.methods.get(*name);
                method.map_or("–".to_owned(), |method| percent(method.path_nrmse_ratio))
            }));
            row
        })
        .collect();
    let mut header = vec!["NRMSE on unseen paths"];
    header.extend(METHODS.iter().map(|(name, _)| *name));
    table(&header, &rows)
}

fn times_table(times: &Times) -> String {
    let counts: Vec<usize> = times
        .least_seconds
        .values()
        .next()
        .map(|own| own.iter().map(|(rows, _)| *rows).collect())
        .unwrap_or_default();
    let rows: Vec<Vec<String>> = METHODS
        .iter()
        .filter_map(|(name, _)| {
            let own = times.least_seconds.get(*name)?;
            let mut row = vec![(*name).to_owned()];
            row.extend(own.iter().map(|(_, seconds)| format!("{seconds:.4}")));
            Some(row)
        })
        .collect();
    let labels: Vec<String> = counts.iter().map(|rows| format!("{rows} rows")).collect();
    let mut header = vec!["seconds of training"];
    header.extend(labels.iter().map(String::as_str));
    table(&header, &rows)
}

fn parameters_table(report: &PaperReport<'_>) -> String {
    let rows: Vec<Vec<String>> = report
        .steps
        .parameters
        .iter()
        .map(|parameter| {
            vec![
                format!("{} / {}", parameter.name, parameter.unit),
                format!("{:.6}", parameter.truth),
                format!("{:.6}", parameter.value),
                format!("{:.1e}", parameter.value - parameter.truth),
            ]
        })
        .collect();
    table(&["parameter", "truth", "identified", "error"], &rows)
}
