//! The page of the main job.

use super::long_run::WATCH_POINTS;
use super::machine_page::{cost, link, this_run};
use super::record::{DemoCurves, DemoReport, LearningPoint, ValidationPoint};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::metrics::MOVING_RAD_S;
use foretorque_workbench::report::joints::{THIRD, curve, joint_panels, percent};
use foretorque_workbench::report::page::{self, Section, Tile};
use foretorque_workbench::report::plot::{self, Ink, Panel};
use std::error::Error;

pub(super) fn html<const N: usize>(
    report: &DemoReport,
    curves: &DemoCurves<N>,
) -> Result<String, Box<dyn Error>> {
    let sections = [
        predicted::<N>(report, curves)?,
        learning(report)?,
        tracking::<N>(report, curves)?,
        shares::<N>(&curves.validation)?,
        excitation::<N>(&curves.excitation)?,
        cost(report),
        link(report),
        this_run(report),
    ];
    let lead = format!(
        "A {} whose model is wrong about its masses, inertias and friction moves for {:.0} s; the firmware learns the \
         difference tick by tick, is frozen, and then meets a path it has never seen. Arm and noise are simulated, the \
         torque comes from the firmware's own code.",
        report.robot.to_uppercase(),
        report.ticks as f64 * report.period_s
    );
    Ok(page::html(
        &format!(
            "foretorque: {} learns its torque",
            report.robot.to_uppercase()
        ),
        &lead,
        &tiles(report),
        &sections,
    ))
}

fn tiles(report: &DemoReport) -> Vec<Tile> {
    let tile = |value: String, label: &str| Tile {
        value,
        label: label.to_owned(),
    };
    let mut tiles = vec![
        tile(
            format!(
                "{} → {}",
                percent(report.torque_nrmse_before),
                percent(report.torque_nrmse_after)
            ),
            "torque error on the unseen path, before → after learning (NRMSE, all samples)",
        ),
        tile(
            format!(
                "{:.2} → {:.2} mrad",
                report.tracking_rms_mrad.pd_only, report.tracking_rms_mrad.after
            ),
            "tracking error, mean of the joints' RMS, PD alone → with learnt feed-forward",
        ),
        tile(
            format!("{:.0} s", report.ticks as f64 * report.period_s),
            "of arm time with learning on",
        ),
    ];
    if report.tick_instructions.max > 0 {
        tiles.push(tile(
            format!("{}", report.tick_instructions.max),
            "instructions in the longest tick (emulator, not cycles of silicon)",
        ));
    }
    if let Some(usart) = &report.usart {
        tiles.push(tile(
            format!("{} of {}", usart.ticks_with_equal_bits, usart.ticks),
            "replies of the flashable firmware with the very same bits",
        ));
    }
    tiles
}

/// The paper's Fig. 6, with the wrong model beside it.
fn predicted<const N: usize>(
    report: &DemoReport,
    curves: &DemoCurves<N>,
) -> Result<Section, Box<dyn Error>> {
    let points = &curves.validation;
    let panels = joint_panels::<N>("tau / N·m", |j| {
        vec![
            curve(Ink::Truth, points, |p| (p.t_s, p.truth[j])),
            curve(Ink::Before, points, |p| (p.t_s, p.before[j])),
            curve(Ink::After, points, |p| (p.t_s, p.after[j])),
        ]
    });
    let errors = joint_panels::<N>("error / N·m", |j| {
        vec![
            curve(Ink::Before, points, |p| (p.t_s, p.before[j] - p.truth[j])),
            curve(Ink::After, points, |p| (p.t_s, p.after[j] - p.truth[j])),
        ]
    });
    let rows: Vec<Vec<String>> = (0..N)
        .map(|j| {
            let (before, after) = (
                report.torque_rmse_nm.before[j],
                report.torque_rmse_nm.after[j],
            );
            vec![
                format!("joint {}", j + 1),
                format!("{before:.3}"),
                format!("{after:.3}"),
                format!("{:.2}", after / before),
            ]
        })
        .collect();
    Ok(Section {
        heading: "Predicted and true torque on the unseen path".to_owned(),
        caption: format!(
            "What the path takes at the arm's present age, free of noise, and what the board answers for it before and after learning (the paper's Fig. 6, with its error below). Over all {samples} samples the error falls from {} to {} of the joints' RMS torque; over those in which the joint moves faster than {MOVING_RAD_S} rad/s, so without stiction, from {} to {}.",
            percent(report.torque_nrmse_before),
            percent(report.torque_nrmse_after),
            percent(report.torque_nrmse_moving_before),
            percent(report.torque_nrmse_moving_after),
            samples = curves.validation_samples,
        ),
        legend: vec![
            (Ink::Truth, "truth (noise-free plant)".to_owned()),
            (Ink::Before, "wrong model".to_owned()),
            (Ink::After, "learnt model".to_owned()),
        ],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?
            + &plot::grid(&errors, 3, THIRD.0, THIRD.1)?
            + &page::table(
                &[
                    "RMS torque error, all samples",
                    "before / N·m",
                    "after / N·m",
                    "ratio",
                ],
                &rows,
            ),
    })
}

fn learning(report: &DemoReport) -> Result<Section, Box<dyn Error>> {
    let panel = Panel {
        title: "torque error, all joints".to_owned(),
        x_label: "time of learning / s".to_owned(),
        y_label: "NRMSE / %".to_owned(),
        curves: vec![curve(Ink::After, &report.learning_curve, |p| {
            (p.t_s, 100.0 * p.torque_nrmse)
        })],
        from_zero: true,
    };
    Ok(Section {
        heading: "Error while it learns".to_owned(),
        caption: format!(
            "Torque error on {WATCH_POINTS} points of the unseen path (moving and still), asked of the board every second while the arm plays the excitation: it halves within {} of learning.",
            halved_after(&report.learning_curve)
        ),
        legend: vec![(Ink::After, "model in force on the board".to_owned())],
        body: plot::grid(&[panel], 1, 1110, 300)?,
    })
}

/// Time until the error is half of what it was at the beginning, as words.
fn halved_after(points: &[LearningPoint]) -> String {
    let Some(first) = points.first() else {
        return "no time".to_owned();
    };
    points
        .iter()
        .find(|point| point.torque_nrmse <= 0.5 * first.torque_nrmse)
        .map_or("more than the whole time".to_owned(), |point| {
            format!("{:.0} s", point.t_s)
        })
}

fn tracking<const N: usize>(
    report: &DemoReport,
    curves: &DemoCurves<N>,
) -> Result<Section, Box<dyn Error>> {
    let kinds = &curves.tracking;
    let panels = joint_panels::<N>("error / mrad", |j| {
        vec![
            curve(Ink::Truth, &kinds.pd_only, |(t_s, e)| (*t_s, e[j])),
            curve(Ink::Before, &kinds.before, |(t_s, e)| (*t_s, e[j])),
            curve(Ink::After, &kinds.after, |(t_s, e)| (*t_s, e[j])),
        ]
    });
    let joints = &report.tracking_rms_joint_mrad;
    let mut rows: Vec<Vec<String>> = (0..N)
        .map(|j| {
            let figures = [joints.pd_only[j], joints.before[j], joints.after[j]];
            let mut row = vec![format!("joint {}", j + 1)];
            row.extend(figures.map(|figure| format!("{figure:.3}")));
            row
        })
        .collect();
    let mean = &report.tracking_rms_mrad;
    let mut row = vec!["mean".to_owned()];
    row.extend([mean.pd_only, mean.before, mean.after].map(|figure| format!("{figure:.3}")));
    rows.push(row);
    Ok(Section {
        heading: "Tracking error on the unseen path".to_owned(),
        caption: format!(
            "Desired minus true position while a PD loop of {:.0} Hz plays the path: {:.1} times as close with the wrong model's feed-forward and {:.1} times as close with the learnt one, learning off. A real arm will gain less than a simulated one.",
            report.pd_bandwidth_hz,
            mean.pd_only / mean.before,
            mean.pd_only / mean.after
        ),
        legend: vec![
            (Ink::Truth, "PD alone".to_owned()),
            (Ink::Before, "with the wrong model".to_owned()),
            (Ink::After, "with the learnt model".to_owned()),
        ],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?
            + &page::table(
                &[
                    "RMS error",
                    "PD alone / mrad",
                    "wrong model / mrad",
                    "learnt / mrad",
                ],
                &rows,
            ),
    })
}

fn shares<const N: usize>(points: &[ValidationPoint<N>]) -> Result<Section, Box<dyn Error>> {
    let panels = joint_panels::<N>("tau / N·m", |j| {
        vec![
            curve(Ink::After, points, |p| (p.t_s, p.rigid[j])),
            curve(Ink::Before, points, |p| (p.t_s, p.friction[j])),
            curve(Ink::Other, points, |p| (p.t_s, p.network[j])),
        ]
    });
    Ok(Section {
        heading: "What the learnt torque is made of".to_owned(),
        caption: "Rigid body, friction and network add up to the torque, each bounded by itself and each visible by itself; the network adds what the other two leave over.".to_owned(),
        legend: vec![
            (Ink::After, "rigid body".to_owned()),
            (Ink::Before, "friction".to_owned()),
            (Ink::Other, "network".to_owned()),
        ],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?,
    })
}

/// The paper's Fig. 3.
fn excitation<const N: usize>(points: &[(f64, State<N>)]) -> Result<Section, Box<dyn Error>> {
    type Pick<const N: usize> = fn(&State<N>) -> &Joints<N>;
    let rows: [(&str, &str, Pick<N>); 3] = [
        ("position", "q / rad", |state| &state.q),
        ("velocity", "qd / rad/s", |state| &state.qd),
        ("acceleration", "qdd / rad/s²", |state| &state.qdd),
    ];
    let panels = rows.map(|(title, y_label, pick)| Panel {
        title: title.to_owned(),
        x_label: "t / s".to_owned(),
        y_label: y_label.to_owned(),
        curves: (0..N)
            .map(|j| curve(Ink::Joint(j as u8), points, |(t_s, s)| (*t_s, pick(s)[j])))
            .collect(),
        from_zero: false,
    });
    Ok(Section {
        heading: "Excitation".to_owned(),
        caption: "One period of the Fourier series that the arm plays while it learns (the paper's Fig. 3): every joint moves at its own mix of five harmonics, inside its limits, at rest at both ends.".to_owned(),
        legend: (0..N)
            .map(|j| (Ink::Joint(j as u8), format!("joint {}", j + 1)))
            .collect(),
        body: plot::grid(&panels, 3, THIRD.0, 290)?,
    })
}
