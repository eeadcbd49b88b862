//! The page of the main job.

use super::long_run::WATCH_POINTS;
use super::{DemoCurves, DemoReport, LearningPoint, N};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::excitation::page::{legend, panels};
use foretorque_workbench::metrics::MOVING_RAD_S;
use foretorque_workbench::report::page::{Page, Section, percent};
use foretorque_workbench::report::plot::{Curve, Panel, PlotColor};

const TRUTH: PlotColor = PlotColor::Truth;
const BEFORE: PlotColor = PlotColor::Before;
const AFTER: PlotColor = PlotColor::After;

pub(super) fn page(report: &DemoReport, curves: &DemoCurves, excitation: &Excitation) -> Page {
    let (robot, learning_s) = (report.robot.to_uppercase(), report.learning_s());
    let error = &report.tracking_rms_mrad;
    let lead = format!(
        "A {robot} whose model is wrong about its masses, inertias and friction moves for {learning_s:.0} s; the firmware learns the \
         difference tick by tick, is frozen, and is then judged on a path that it did not learn from. Arm and noise are simulated, the \
         torque comes from the firmware's own code."
    );
    let mut page = Page::new(format!("foretorque: {robot} learns its torque"), lead)
        .card(
            from_to(report.torque_nrmse_before, report.torque_nrmse_after),
            "torque error on the unseen path, before → after learning (NRMSE, all samples)",
        )
        .card(
            format!("{:.2} → {:.2} mrad", error.pd_only, error.after),
            "tracking error, mean of the joints' RMS, PD alone → with learnt feed-forward",
        )
        .card(format!("{learning_s:.0} s"), "of arm time with learning on");
    let longest = report.tick_instructions.max;
    if longest > 0 {
        let label = "instructions in the longest tick (emulator, not cycles of silicon)";
        page = page.card(longest, label);
    }
    if let Some(usart) = &report.usart {
        let equal = format!("{} of {}", usart.ticks_with_equal_bits, usart.ticks);
        page = page.card(equal, "replies of the flashable firmware with equal bits");
    }
    page.sections([
        predicted(report, curves),
        learning(report),
        tracking(report, curves),
        shares(curves),
        Section::new(
            "Excitation",
            "One period of the Fourier series that the arm plays while it learns (the paper's Fig. 3): every joint moves at its own \
             mix of five harmonics, inside its limits, at rest at both ends.",
        )
        .legend(legend(N))
        .plots(panels(excitation), 3),
        cost(report),
        link(report),
        this_run(report),
    ])
}

fn from_to(before: f64, after: f64) -> String {
    format!("{} → {}", percent(before), percent(after))
}

/// The paper's Fig. 6, with the wrong model beside it.
fn predicted(report: &DemoReport, curves: &DemoCurves) -> Section {
    let points = &curves.validation;
    let torques = Panel::of_joints(N, "tau / N·m", |j| {
        vec![
            Curve::new(TRUTH, points, |p| (p.t_s, p.truth[j])),
            Curve::new(BEFORE, points, |p| (p.t_s, p.before[j])),
            Curve::new(AFTER, points, |p| (p.t_s, p.after[j])),
        ]
    });
    let errors = Panel::of_joints(N, "error / N·m", |j| {
        vec![
            Curve::new(BEFORE, points, |p| (p.t_s, p.before[j] - p.truth[j])),
            Curve::new(AFTER, points, |p| (p.t_s, p.after[j] - p.truth[j])),
        ]
    });
    let rmse = &report.torque_rmse_nm;
    let pairs = rmse.after.iter().zip(&rmse.before);
    let ratios: Vec<f64> = pairs.map(|(a, b)| a / b).collect();
    Section::new(
        "Predicted and true torque on the unseen path",
        format!(
            "Noise-free plant torque (drives warmed up) and feed-forward torque, before and after learning (the paper's Fig. 6, with \
             its error below). Over all {} samples the error falls from {} to {} of the joints' RMS torque; over those in which the \
             joint moves faster than {MOVING_RAD_S} rad/s, so without stiction, from {} to {}.",
            curves.validation_samples,
            percent(report.torque_nrmse_before),
            percent(report.torque_nrmse_after),
            percent(report.torque_nrmse_moving_before),
            percent(report.torque_nrmse_moving_after),
        ),
    )
    .legend([
        (TRUTH, "truth (noise-free plant)"),
        (BEFORE, "wrong model"),
        (AFTER, "learnt model"),
    ])
    .plots(torques, 3)
    .plots(errors, 3)
    .joint_table(
        "RMS torque error, all samples | before / N·m | after / N·m | ratio",
        &[&rmse.before, &rmse.after, &ratios],
    )
}

fn learning(report: &DemoReport) -> Section {
    let curve = Curve::new(AFTER, &report.learning_curve, |p| {
        (p.t_s, 100.0 * p.torque_nrmse)
    });
    let mut panel = Panel::new(
        "torque error, all joints",
        "time of learning / s",
        "NRMSE / %",
        vec![curve],
    );
    panel.from_zero = true;
    Section::new(
        "Error while it learns",
        format!(
            "Torque error on {WATCH_POINTS} points of the unseen path (moving and still), evaluated on the board every second while the \
             arm plays the excitation: it halves within {} of learning.",
            halved_after(&report.learning_curve)
        ),
    )
    .legend([(AFTER, "active model on the board")])
    .plots([panel], 1)
}

/// Time until the error is half of its first value, as words.
fn halved_after(points: &[LearningPoint]) -> String {
    let Some(first) = points.first() else {
        return "no time".to_owned();
    };
    let halved = |point: &&LearningPoint| point.torque_nrmse <= 0.5 * first.torque_nrmse;
    match points.iter().find(halved) {
        Some(point) => format!("{:.0} s", point.t_s),
        None => "more than the whole time".to_owned(),
    }
}

fn tracking(report: &DemoReport, curves: &DemoCurves) -> Section {
    let kinds = &curves.tracking;
    let panels = Panel::of_joints(N, "error / mrad", |j| {
        let curve =
            |color, points: &[(f64, Joints<N>)]| Curve::new(color, points, |(t_s, e)| (*t_s, e[j]));
        vec![
            curve(TRUTH, &kinds.pd_only),
            curve(BEFORE, &kinds.before),
            curve(AFTER, &kinds.after),
        ]
    });
    let (mean, joints) = (&report.tracking_rms_mrad, &report.tracking_rms_joint_mrad);
    Section::new(
        "Tracking error on the unseen path",
        format!(
            "Desired minus true position while a PD loop of {:.0} Hz plays the path: {:.1} times as close with the wrong model's \
             feed-forward and {:.1} times as close with the learnt one, learning off. Mean of the joints: {:.3}, {:.3} and {:.3} mrad. \
             A real arm will gain less than a simulated one.",
            report.pd_bandwidth_hz,
            mean.pd_only / mean.before,
            mean.pd_only / mean.after,
            mean.pd_only,
            mean.before,
            mean.after
        ),
    )
    .legend([
        (TRUTH, "PD alone"),
        (BEFORE, "with the wrong model"),
        (AFTER, "with the learnt model"),
    ])
    .plots(panels, 3)
    .joint_table(
        "RMS error | PD alone / mrad | wrong model / mrad | learnt / mrad",
        &[&joints.pd_only, &joints.before, &joints.after],
    )
}

fn shares(curves: &DemoCurves) -> Section {
    let points = &curves.validation;
    let panels = Panel::of_joints(N, "tau / N·m", |j| {
        vec![
            Curve::new(AFTER, points, |p| (p.t_s, p.rigid[j])),
            Curve::new(BEFORE, points, |p| (p.t_s, p.friction[j])),
            Curve::new(PlotColor::Other, points, |p| (p.t_s, p.network[j])),
        ]
    });
    Section::new(
        "Shares of the learnt torque",
        "Rigid body, friction and network add up to the torque, each separately bounded and visible; the network adds the remainder \
         of the other two.",
    )
    .legend([
        (AFTER, "rigid body"),
        (BEFORE, "friction"),
        (PlotColor::Other, "network"),
    ])
    .plots(panels, 3)
}

fn cost(report: &DemoReport) -> Section {
    let phases = &report.tick_instructions_by_phase;
    let mut rows = vec![
        ("tick, learning off", phases.frozen),
        ("tick, learning on", phases.learning),
        ("tick, since learning began", report.tick_instructions),
        (
            "learning from a tick, in the slack behind it",
            report.learning_instructions,
        ),
    ];
    if let Some(usart) = &report.usart {
        let name = "tick, flashable firmware over its USART";
        rows.push((name, usart.tick_instructions));
    }
    let rows = rows.into_iter();
    let rows =
        rows.map(|(name, cost)| [name.to_owned(), cost.mean.to_string(), cost.max.to_string()]);
    let caption = if report.tick_instructions.max > 0 {
        "Instructions between a complete request and its reply, and those of learning behind it, counted by a timer of the emulated \
         board. They are instructions and not cycles: the emulator models neither wait states nor the pipeline, and nothing here \
         was measured on silicon. `cargo xtask bench` estimates cycles."
    } else {
        "The board in this process has no instruction counter; run on the emulated board to see its costs."
    };
    Section::new("Instructions per tick", caption).table("instructions | mean | largest", rows)
}

fn link(report: &DemoReport) -> Section {
    let mut rows = vec![(format!("long run ({})", report.board), report.link)];
    let mut caption =
        "Frames the board received, and those that were damaged, foreign, missed or lost."
            .to_owned();
    if let Some(usart) = &report.usart {
        rows.push(("flashable firmware (USART)".to_owned(), usart.link));
        caption += &format!(
            " On the flashable firmware the error on {} points of the unseen path went from {} to {} within {} ticks; {} of its {} \
             replies have the bits of the long run's.",
            usart.grid_points,
            percent(usart.torque_nrmse_before),
            percent(usart.torque_nrmse_after),
            usart.ticks,
            usart.ticks_with_equal_bits,
            usart.ticks
        );
    }
    let rows = rows.into_iter();
    let rows = rows.map(|(name, link)| [name, link.frames.to_string(), link.errors.to_string()]);
    Section::new("Link", caption).table("link | frames | errors", rows)
}

fn this_run(report: &DemoReport) -> Section {
    let (before, after) = (
        report.torque_nrmse_moving_before,
        report.torque_nrmse_moving_after,
    );
    let moving = from_to(before, after);
    let rows = [
        ("robot", report.robot.clone()),
        ("board", report.board.clone()),
        ("seed", report.seed.to_string()),
        ("period", format!("{} ms", report.period_s * 1e3)),
        ("ticks with learning on", report.ticks.to_string()),
        ("compiler of the board's code", report.toolchain.clone()),
        (
            "torque NRMSE, all samples",
            from_to(report.torque_nrmse_before, report.torque_nrmse_after),
        ),
        ("torque NRMSE, moving samples only", moving),
    ];
    let usart = report.usart.as_ref().map_or(String::new(), |usart| {
        let learning_s = usart.ticks as f64 * report.period_s;
        format!(" --usart-learning-s {learning_s}")
    });
    Section::new(
        "This run",
        "To repeat it, type this in the workspace's root after `cargo xtask demo` has built both sides; the same seed and firmware give \
         the same figures to the last digit.",
    )
    .command(format!(
        "cargo run --release -p host-sim -- experiment demo --board {} --seed {} --learning-s {}{usart} --out \
         target/foretorque/demo",
        report.board,
        report.seed,
        report.learning_s()
    ))
    .table(" | value", rows.map(|(name, value)| [name.to_owned(), value]))
}
