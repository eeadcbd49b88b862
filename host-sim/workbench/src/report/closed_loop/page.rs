//! The page of a closed-loop run.

use super::{ClosedLoopLog, ClosedLoopReport, FLAGS};
use crate::report::page::{Page, Section};
use crate::report::plot::{Curve, Panel, PlotColor};

/// The page; `command` repeats the run.
pub fn page<const N: usize>(
    report: &ClosedLoopReport,
    log: &ClosedLoopLog<N>,
    command: &str,
) -> Page {
    let robot = report.run.robot.to_uppercase();
    let lead = format!(
        "A simulated {robot} under PD control plays its trajectory for {:.1} s with the feed-forward of board {} added, \
         learning {}. All figures count every tick; the plots draw {}.",
        report.ticks as f64 * report.run.period_s,
        report.run.board,
        if report.run.learning { "on" } else { "off" },
        match log.every {
            1 => "each of them".to_owned(),
            every => format!("one of {every}"),
        }
    );
    let trouble = match report.troubles.as_slice() {
        [] => "none".to_owned(),
        troubles => troubles.join("; "),
    };
    let change = report.learnt.change_percent;
    let learnt = match (report.run.learning, report.learnt.adopted_s) {
        (false, _) => "off".to_owned(),
        (true, None) => "nothing".to_owned(),
        (true, Some(t_s)) => format!("{change:.1} %, from {t_s:.1} s"),
    };
    Page::new(format!("foretorque: {robot} in a closed loop"), lead)
        .card(trouble, "kept the arm from its torque or motion")
        .card(
            learnt,
            "learnt change of the torque, RMS share of its limit, and its begin",
        )
        .card(
            format!("{:.3} mrad", report.tracking_rms_mrad),
            "tracking error, mean of the joints' RMS",
        )
        .card(report.ticks, "ticks")
        .card(report.link.errors(), "link errors and missed deadlines")
        .card(
            report.flag_ticks.values().sum::<usize>(),
            "flags raised, summed over all ticks",
        )
        .sections(plots(report, log))
        .sections(tables(report, command))
}

fn plots<const N: usize>(report: &ClosedLoopReport, log: &ClosedLoopLog<N>) -> [Section; 3] {
    let (after, truth) = (PlotColor::After, PlotColor::Truth);
    let errors = |j: usize| Curve::new(after, &log.points, |p| (p.t_s, p.error_mrad[j]));
    let torques = |j: usize| {
        vec![
            Curve::new(truth, &log.points, |p| (p.t_s, p.tau[j])),
            Curve::new(after, &log.points, |p| (p.t_s, p.feed_forward[j])),
        ]
    };
    let shares = [
        (after, "rigid body"),
        (PlotColor::Before, "friction"),
        (PlotColor::Other, "network"),
    ];
    let share_curves = |j: usize| {
        let curve = |(k, (color, _))| Curve::new(color, &log.shares[j], |(t, tau)| (*t, tau[k]));
        shares.into_iter().enumerate().map(curve).collect()
    };
    [
        Section::new(
            "Tracking error",
            "Desired minus true joint position; the truth is the simulated arm's, free of encoder steps.",
        )
        .legend([(after, "desired − true position")])
        .plots(Panel::of_joints(N, "error / mrad", |j| vec![errors(j)]), 3)
        .joint_table(
            "position error | RMS / mrad | peak / mrad",
            &[
                &report.tracking_rms_joint_mrad,
                &report.tracking_peak_joint_mrad,
            ],
        ),
        Section::new(
            "Torque",
            "Drive torque, link side, positive when it accelerates +q: PD torque plus the feed-forward answered one tick \
             earlier. The closer the two curves, the less is left to the PD controller.",
        )
        .legend([(truth, "drive"), (after, "feed-forward of the board")])
        .plots(Panel::of_joints(N, "tau / N·m", torques), 3)
        .joint_table(
            "torque | drive, RMS / N·m | drive, peak / N·m | feed-forward, RMS / N·m",
            &[
                &report.torque_rms_nm,
                &report.torque_peak_nm,
                &report.feed_forward_rms_nm,
            ],
        ),
        Section::new(
            "Shares of the feed-forward",
            format!(
                "Rigid body, friction and network. A reply carries one joint, so every joint is seen each {N} ticks."
            ),
        )
        .legend(shares)
        .plots(Panel::of_joints(N, "tau / N·m", share_curves), 3),
    ]
}

fn tables(report: &ClosedLoopReport, command: &str) -> [Section; 5] {
    let decisions = report.learnt.decisions.iter().map(|decision| {
        [
            decision.decision.clone(),
            decision.times.to_string(),
            format!("{:.2}", decision.first_s),
            format!("{:.2}", decision.newest_s),
        ]
    });
    let flags = FLAGS.iter().map(|(flag, meaning)| {
        let ticks = report.flag_ticks.get(flag.name()).copied().unwrap_or(0);
        let percent = 100.0 * ticks as f64 / report.ticks.max(1) as f64;
        [
            (*meaning).to_owned(),
            ticks.to_string(),
            format!("{percent:.2} %"),
        ]
    });
    let learning = [
        ("late learnt sets", report.late_sets),
        (
            "learning samples without buffer",
            report.learning_samples_lost,
        ),
    ];
    let link = report.link.0.map(|(_, name, count)| (name, count));
    let counts = link.into_iter().chain(learning);
    let costs = [
        ("tick", report.tick_cost),
        ("learning from a tick", report.learning_cost),
    ];
    let of_this_run = [
        ("robot", report.run.robot.clone()),
        ("board", report.run.board.clone()),
        (
            "board's store",
            format!("{:?}", report.store).to_lowercase(),
        ),
        ("seed", report.run.seed.to_string()),
        ("period", format!("{} ms", report.run.period_s * 1e3)),
        ("compiler of the board's code", report.run.toolchain.clone()),
    ];
    [
        Section::new(
            "Learning",
            "Decisions of the supervisor, and the time for which each was the newest: a set is adopted, or held back.",
        )
        .table("newest decision | times | first at / s | time / s", decisions),
        Section::new("Flags", "Ticks in which something was limited or went wrong.")
            .table("flag | ticks | share of all ticks", flags),
        Section::new("Link", "Counted by the board since its start or its last reset.").table(
            "link | count",
            counts.map(|(name, count)| [name.to_owned(), count.to_string()]),
        ),
        Section::new(
            "Cost of a tick",
            if report.tick_cost.max > 0 {
                "In counts of the board's own counter. In the emulator they are executed instructions, not the cycles of silicon."
            } else {
                "This board has no counter; run on an emulated or real one to see the cost of a tick."
            },
        )
        .table(
            "counts | mean | largest",
            costs.map(|(name, cost)| [name.to_owned(), cost.mean.to_string(), cost.max.to_string()]),
        ),
        Section::new(
            "This run",
            "To repeat it: with a native or emulated board, the same seed and firmware give the same figures to the last \
             digit.",
        )
        .command(command)
        .table(" | value", of_this_run.map(|(name, value)| [name.to_owned(), value])),
    ]
}
