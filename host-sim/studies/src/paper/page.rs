//! The study as a page and as pictures: the paper's Fig. 3 and Fig. 6, the losses, robustness and efficiency.

use super::cell::{FRICTIONS, FrictionKind};
use super::findings::{of_times, percent};
use super::{Condition, Curves, PaperReport, Times, by_rows, on_all_rows};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::excitation::page::{legend, panels, picture as excitation_picture};
use foretorque_workbench::report::page::{Legend, Page, Section, or_dash};
use foretorque_workbench::report::plot::{Curve, Panel, PlotColor, picture};
use foretorque_workbench::snapshot::{aligned, significant};

/// Methods and their colours, in the order of legends and tables.
const METHODS: [(&str, PlotColor); 8] = [
    ("ols", PlotColor::Joint(7)),
    ("wls", PlotColor::Joint(0)),
    ("irls", PlotColor::Joint(2)),
    ("irls_stribeck", PlotColor::Joint(6)),
    ("consistent", PlotColor::Joint(5)),
    ("bp_physical", PlotColor::Joint(1)),
    ("bp_residual", PlotColor::Joint(3)),
    ("bp_black_box", PlotColor::Joint(4)),
];
const PATH_LEGEND: [(PlotColor, &str); 3] = [
    (PlotColor::Truth, "true torque"),
    (PlotColor::Before, "BP network, hidden layer 18-32-6"),
    (PlotColor::After, "BP network, physical weights"),
];
const LOSS_LEGEND: [(PlotColor, &str); 5] = [
    (PlotColor::Truth, "eq. 21, training 80 %"),
    (PlotColor::Other, "eq. 21, held-out 20 %"),
    (PlotColor::After, "accelerated, training 80 %"),
    (PlotColor::Before, "accelerated, held-out 20 %"),
    (PlotColor::Joint(4), "hidden layer 18-32-6, training 80 %"),
];

/// Name and content of every picture.
///
/// Errors: those of the plot library.
pub(super) fn pictures(
    report: &PaperReport,
    curves: &Curves,
) -> std::io::Result<[(&'static str, String); 5]> {
    let draw = |title, legend: &[(PlotColor, &str)], panels: &[Panel], columns, size| {
        let legend = legend.iter().map(|(c, name)| (*c, (*name).to_owned()));
        picture(title, &legend.collect::<Legend>(), panels, columns, size)
    };
    let methods = METHODS.map(|(name, color)| (color, name));
    let excitation = excitation_picture(&report.config.excitation)?;
    let title = "Predicted moments for each joint at the validation trajectory (Fig. 6)";
    let torques = draw(title, &PATH_LEGEND, &path_panels(curves), 2, (640, 290))?;
    let title = "Loss (RMSE, eq. 20) while the networks train";
    let loss = draw(title, &LOSS_LEGEND, &[loss_panel(curves)], 1, (900, 300))?;
    let title = "Torque error on unseen paths over noise, friction and outliers";
    let panels = robustness_panels(&report.conditions);
    let robustness = draw(title, &methods, &panels, 3, (420, 290))?;
    let title = "Torque error on unseen paths over training rows (1 % noise, Coulomb + viscous)";
    let panels = [efficiency_panel(&report.conditions)];
    let efficiency = draw(title, &methods, &panels, 1, (900, 300))?;
    Ok([
        ("fig3-excitation.svg", excitation),
        ("fig6-predicted-torques.svg", torques),
        ("training-loss.svg", loss),
        ("robustness.svg", robustness),
        ("efficiency.svg", efficiency),
    ])
}

pub(super) fn page(report: &PaperReport, curves: &Curves, times: &Times) -> Page {
    let steps = &report.steps;
    let physical = &steps.trained[2];
    Page::new(
        "The paper's experiment on the UR5",
        "Y. Zhong, Identification of Robot Dynamic Parameters Based on BP Neural Network, section 4.1, step by step; then the \
         robustness and efficiency it asserts, measured.",
    )
    .card(
        percent(physical.path_nrmse_ratio),
        "torque error on the arbitrary path, BP network with physical weights, no noise",
    )
    .card(
        percent(physical.base_parameter_error_ratio.unwrap_or(0.0)),
        "error of the base parameters, over their norm",
    )
    .card(
        percent(steps.trained[3].path_nrmse_ratio),
        "the same path by a BP network with a hidden layer",
    )
    .card(
        format!("{:.0e} rad", steps.inverse_kinematics_error_rad),
        "joint sequence through inverse kinematics, largest error",
    )
    .sections(of_steps(report, curves, times))
    .sections(of_conditions(report, times))
}

/// Findings and the paper's four steps.
fn of_steps(report: &PaperReport, curves: &Curves, times: &Times) -> [Section; 4] {
    let steps = &report.steps;
    let findings = report.findings.iter().cloned().chain(of_times(times));
    let trained = steps.trained.iter().map(|trained| {
        [
            trained.name.to_owned(),
            trained.epochs.to_string(),
            percent(trained.training_loss_ratio),
            percent(trained.validation_loss_ratio),
            or_dash(trained.base_parameter_error_ratio, percent),
            percent(trained.path_nrmse_ratio),
        ]
    });
    let joints = (1..).zip(&steps.joints).map(|(joint, torque)| {
        [
            format!("joint {joint}"),
            format!("{:.3}", torque.torque_rms_nm),
            format!("{:.2e}", torque.bp_physical_rmse_nm),
            format!("{:.2e}", torque.bp_physical_peak_nm),
            format!("{:.3}", torque.bp_black_box_rmse_nm),
            format!("{:.3}", torque.bp_black_box_peak_nm),
        ]
    });
    [
        Section::new(
            "Findings",
            "Sentences made from the figures below, whichever way they go.",
        )
        .table("finding", findings.map(|finding| [finding])),
        Section::new(
            "Fig. 3: excitation trajectories",
            format!(
                "Step (1). {} poses of the flange along it, turned into joint positions by the closed-form inverse kinematics, \
                 branch by continuation.",
                steps.inverse_kinematics_poses
            ),
        )
        .legend(legend(JOINTS))
        .plots(panels(&report.config.excitation), 1),
        Section::new(
            "Training",
            format!(
                "Steps (2) and (3). The data sheet's UR5 as the known arm, links alone: no friction, no rotors, no noise. {} \
                 instants trained on, {} held out; {} base parameters. Loss: RMSE (eq. 20), every joint over its RMS torque.",
                steps.training_rows, steps.validation_rows, steps.base_parameters
            ),
        )
        .legend(LOSS_LEGEND)
        .plots([loss_panel(curves)], 1)
        .table(
            "method | epochs | loss, 80 % | loss, 20 % | parameter error | error on the path",
            trained,
        ),
        Section::new(
            "Fig. 6: predicted moments on the arbitrary path",
            "Step (4). Quintics through via points that none of the models has seen.",
        )
        .legend(PATH_LEGEND)
        .plots(path_panels(curves), 2)
        .table(
            "N·m | torque RMS | physical weights, RMSE | peak error | hidden layer, RMSE | peak error",
            joints,
        ),
    ]
}

/// Robustness, efficiency, parameters.
fn of_conditions(report: &PaperReport, times: &Times) -> [Section; 3] {
    let robustness = on_all_rows(&report.conditions).into_iter().map(|c| {
        let mut row = vec![format!(
            "{}, {} % noise, {} % outliers",
            c.friction.name(),
            c.noise_percent,
            c.outlier_percent
        )];
        row.extend(errors(c).map(|error| or_dash(error, percent)));
        row
    });
    let names = method_names();
    let counts = times.least_seconds.values().next().into_iter().flatten();
    let counts: String = counts.map(|(rows, _)| format!(" | {rows} rows")).collect();
    let seconds = METHODS.iter().filter_map(|(name, _)| {
        let own = times.least_seconds.get(*name)?.iter();
        let seconds = own.map(|(_, seconds)| format!("{seconds:.4}"));
        Some(std::iter::once((*name).to_owned()).chain(seconds))
    });
    let parameters = report.steps.parameters.iter().map(|parameter| {
        [
            format!("{} / {}", parameter.name, parameter.unit),
            format!("{:.6}", parameter.truth),
            format!("{:.6}", parameter.value),
            format!("{:.1e}", parameter.value - parameter.truth),
        ]
    });
    [
        Section::new(
            "Robustness",
            format!(
                "{} draws of each condition: arm (masses up to 20 % off), noise, outliers of 20 % of the torque limit, 80/20 split \
                 and unseen path. Error against the noise-free torque, moving rows, root mean square over the draws; \
                 logarithmic: 1 is 10 %, 0 is 1 %, −1 is 0.1 %.",
                report.config.seeds
            ),
        )
        .legend(METHODS.map(|(name, color)| (color, name)))
        .plots(robustness_panels(&report.conditions), 3)
        .table(format!("NRMSE on unseen paths{names}"), robustness),
        Section::new(
            "Efficiency",
            "Error by number of training rows, and seconds of training (least of the draws).",
        )
        .legend(METHODS.map(|(name, color)| (color, name)))
        .plots([efficiency_panel(&report.conditions)], 1)
        .table(format!("seconds of training{counts}"), seconds),
        Section::new(
            "Base parameters",
            "BP network with physical weights, accelerated, against the truth. First independent columns from left to right, \
             Craig link frames, about the link origin.",
        )
        .table("parameter | truth | identified | error", parameters),
    ]
}

/// The torque error of every method on unseen paths.
fn errors(condition: &Condition) -> [Option<f64>; METHODS.len()] {
    METHODS.map(|(name, _)| Some(condition.methods.get(name)?.path_nrmse_ratio))
}

/// Columns of a table, one a method.
fn method_names() -> String {
    METHODS.map(|(name, _)| format!(" | {name}")).concat()
}

/// Findings, and the errors of every condition, %.
pub(super) fn text(report: &PaperReport) -> String {
    let errors = |c: &Condition| {
        errors(c).map(|error| or_dash(error, |error| significant(100.0 * error, 3)))
    };
    let grid = on_all_rows(&report.conditions).into_iter().map(|c| {
        let condition = [
            c.friction.name().to_owned(),
            c.outlier_percent.to_string(),
            c.noise_percent.to_string(),
        ];
        condition.into_iter().chain(errors(c))
    });
    let plain = by_rows(&report.conditions).into_iter();
    let plain = plain.map(|c| std::iter::once(c.rows.to_string()).chain(errors(c)));
    let names = method_names();
    let findings: String = report.findings.iter().map(|f| format!("- {f}\n")).collect();
    format!(
        "host-sim experiment paper, {} draws of each condition\n\nFindings\n{findings}\n\
         Torque error on unseen paths, %\n{}\n\
         Torque error by training rows (1 % noise, Coulomb + viscous), %\n{}",
        report.config.seeds,
        aligned(&format!("friction | outliers % | noise %{names}"), grid),
        aligned(&format!("rows{names}"), plain)
    )
}

fn path_panels(curves: &Curves) -> Vec<Panel> {
    Panel::of_joints(JOINTS, "tau / N·m", |j| {
        let of = |color, model: usize| {
            Curve::new(color, &curves.path, |(t_s, _, tau)| (*t_s, tau[model][j]))
        };
        vec![
            of(PlotColor::Truth, 0),
            of(PlotColor::Before, 2),
            of(PlotColor::After, 1),
        ]
    })
}

fn loss_panel(curves: &Curves) -> Panel {
    let log = |epoch: usize, loss: f64| ((epoch.max(1) as f64).log10(), loss.log10());
    let training = |color, of: &[_]| Curve::new(color, of, |p: &(_, _, _)| log(p.0, p.1));
    let held_out = |color, of: &[_]| Curve::new(color, of, |p: &(_, _, _)| log(p.0, p.2));
    let [plain, fast] = &curves.losses;
    Panel::new(
        "loss by epoch, no noise",
        "log10 epoch",
        "log10 RMSE / RMS torque",
        vec![
            training(PlotColor::Truth, plain),
            held_out(PlotColor::Other, plain),
            training(PlotColor::After, fast),
            held_out(PlotColor::Before, fast),
            Curve::new(PlotColor::Joint(4), &curves.black_box, |p| log(p.0, p.1)),
        ],
    )
}

/// A panel for each friction and share of outliers, noise along x.
fn robustness_panels(conditions: &[Condition]) -> Vec<Panel> {
    let grid = on_all_rows(conditions);
    let mut outliers: Vec<f64> = conditions.iter().map(|c| c.outlier_percent).collect();
    outliers.sort_by(f64::total_cmp);
    outliers.dedup();
    let kinds = outliers
        .iter()
        .flat_map(|outlier| FRICTIONS.map(|friction| (*outlier, friction)));
    let panel = |(outlier_percent, friction): (f64, FrictionKind)| {
        let mut own = grid.clone();
        own.retain(|c| c.friction == friction && c.outlier_percent == outlier_percent);
        let panel = Panel::new(
            format!("{}, {outlier_percent} % outliers", friction.name()),
            "noise / % of torque limit",
            "log10 NRMSE / %",
            method_curves(&own, |c| c.noise_percent),
        );
        (!own.is_empty()).then_some(panel)
    };
    kinds.filter_map(panel).collect()
}

/// Error over the number of training rows.
fn efficiency_panel(conditions: &[Condition]) -> Panel {
    Panel::new(
        "1 % noise, Coulomb + viscous",
        "log10 training rows (six torques each)",
        "log10 NRMSE / %",
        method_curves(&by_rows(conditions), |c| (c.rows as f64).log10()),
    )
}

fn method_curves(conditions: &[&Condition], x: impl Fn(&Condition) -> f64) -> Vec<Curve> {
    let points = |name: &str| {
        let errors = conditions.iter().filter_map(|c| {
            let error = c.methods.get(name)?.path_nrmse_ratio;
            // Exact to rounding: below the resolution of the plot.
            Some((x(c), (100.0 * error).max(1e-4).log10()))
        });
        errors.collect()
    };
    let curves = METHODS.iter().map(|(name, color)| Curve {
        color: *color,
        points: points(name),
    });
    curves.collect()
}
