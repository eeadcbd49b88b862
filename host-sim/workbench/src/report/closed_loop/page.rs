//! The page of a closed-loop run.

use super::{BoardCost, ClosedLoopLog, ClosedLoopReport, FLAGS};
use crate::report::joints::{THIRD, curve, joint_panels};
use crate::report::page::{self, Section, Tile};
use crate::report::plot::{self, Ink};
use std::error::Error;

/// The page. * `command` how to repeat the run
///
/// Errors: what the plot library says.
pub fn html<const N: usize>(
    report: &ClosedLoopReport,
    log: &ClosedLoopLog<N>,
    command: &str,
) -> Result<String, Box<dyn Error>> {
    let sections = [
        tracking(report, log)?,
        torque(report, log)?,
        shares(log)?,
        flags(report),
        link(report),
        cost(report),
        this_run(report, command),
    ];
    let lead = format!(
        "A simulated {} under PD control plays its trajectory for {:.1} s with the feed-forward of board {} added, learning {}. \
         All figures count every tick; the plots draw every {}.",
        report.robot.to_uppercase(),
        report.ticks as f64 * report.period_s,
        report.board,
        if report.learning { "on" } else { "off" },
        match log.every {
            1 => "tick".to_owned(),
            every => format!("{every}th tick"),
        }
    );
    let tile = |value: String, label: &str| Tile {
        value,
        label: label.to_owned(),
    };
    let tiles = [
        tile(
            format!("{:.3} mrad", report.tracking_rms_mrad),
            "tracking error, mean of the joints' RMS",
        ),
        tile(report.ticks.to_string(), "ticks"),
        tile(report.link.errors().to_string(), "link errors"),
        tile(
            report.flag_ticks.values().sum::<usize>().to_string(),
            "flags raised, summed over all ticks",
        ),
    ];
    let title = format!(
        "foretorque: {} in a closed loop",
        report.robot.to_uppercase()
    );
    Ok(page::html(&title, &lead, &tiles, &sections))
}

fn tracking<const N: usize>(
    report: &ClosedLoopReport,
    log: &ClosedLoopLog<N>,
) -> Result<Section, Box<dyn Error>> {
    let panels = joint_panels::<N>("error / mrad", |j| {
        vec![curve(Ink::After, &log.points, |p| (p.t_s, p.error_mrad[j]))]
    });
    let rows: Vec<Vec<String>> = (0..N)
        .map(|j| {
            vec![
                format!("joint {}", j + 1),
                format!("{:.3}", report.tracking_rms_joint_mrad[j]),
                format!("{:.3}", report.tracking_peak_joint_mrad[j]),
            ]
        })
        .collect();
    Ok(Section {
        heading: "Tracking error".to_owned(),
        caption: "Desired minus true joint position; the truth is the simulated arm's, free of encoder steps.".to_owned(),
        legend: vec![(Ink::After, "desired − true position".to_owned())],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?
            + &page::table(&["position error", "RMS / mrad", "peak / mrad"], &rows),
    })
}

fn torque<const N: usize>(
    report: &ClosedLoopReport,
    log: &ClosedLoopLog<N>,
) -> Result<Section, Box<dyn Error>> {
    let panels = joint_panels::<N>("tau / N·m", |j| {
        vec![
            curve(Ink::Truth, &log.points, |p| (p.t_s, p.tau[j])),
            curve(Ink::After, &log.points, |p| (p.t_s, p.feed_forward[j])),
        ]
    });
    let rows: Vec<Vec<String>> = (0..N)
        .map(|j| {
            vec![
                format!("joint {}", j + 1),
                format!("{:.3}", report.torque_rms_nm[j]),
                format!("{:.3}", report.torque_peak_nm[j]),
                format!("{:.3}", report.feed_forward_rms_nm[j]),
            ]
        })
        .collect();
    Ok(Section {
        heading: "Torque".to_owned(),
        caption: "What the drives are asked for, link side, positive when it accelerates +q: PD torque plus the feed-forward answered one tick earlier. The closer the two curves, the less is left to the PD controller.".to_owned(),
        legend: vec![
            (Ink::Truth, "asked of the drive".to_owned()),
            (Ink::After, "feed-forward of the board".to_owned()),
        ],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?
            + &page::table(
                &["torque", "drive, RMS / N·m", "drive, peak / N·m", "feed-forward, RMS / N·m"],
                &rows,
            ),
    })
}

fn shares<const N: usize>(log: &ClosedLoopLog<N>) -> Result<Section, Box<dyn Error>> {
    let panels = joint_panels::<N>("tau / N·m", |j| {
        [Ink::After, Ink::Before, Ink::Other]
            .into_iter()
            .enumerate()
            .map(|(k, ink)| curve(ink, &log.shares[j], |(t_s, shares)| (*t_s, shares[k])))
            .collect()
    });
    Ok(Section {
        heading: "What the feed-forward is made of".to_owned(),
        caption: format!(
            "Rigid body, friction and network, as the replies tell them: one joint a tick, so every joint each {N} ticks."
        ),
        legend: vec![
            (Ink::After, "rigid body".to_owned()),
            (Ink::Before, "friction".to_owned()),
            (Ink::Other, "network".to_owned()),
        ],
        body: plot::grid(&panels, 3, THIRD.0, THIRD.1)?,
    })
}

fn flags(report: &ClosedLoopReport) -> Section {
    let rows: Vec<Vec<String>> = FLAGS
        .iter()
        .map(|(flag, meaning)| {
            let ticks = report.flag_ticks.get(flag.name()).copied().unwrap_or(0);
            vec![
                (*meaning).to_owned(),
                ticks.to_string(),
                format!("{:.2} %", 100.0 * ticks as f64 / report.ticks.max(1) as f64),
            ]
        })
        .collect();
    Section {
        heading: "Flags".to_owned(),
        caption: "Ticks whose reply said that something was limited or went wrong.".to_owned(),
        legend: Vec::new(),
        body: page::table(&["flag", "ticks", "share of all ticks"], &rows),
    }
}

fn link(report: &ClosedLoopReport) -> Section {
    let link = &report.link;
    let rows: Vec<Vec<String>> = [
        ("good frames", link.frames),
        ("wrong checksum", link.crc_errors),
        ("cut short or too long", link.framing_errors),
        ("other protocol version", link.foreign_version),
        ("unknown message", link.unknown),
        ("never came", link.missed),
        ("came twice or late", link.repeated),
        ("missed deadlines and overruns", link.overruns),
        ("learnt sets that came late", report.late_sets),
        ("lessons that found no room", report.lessons_lost),
    ]
    .iter()
    .map(|(name, count)| vec![(*name).to_owned(), count.to_string()])
    .collect();
    Section {
        heading: "Link".to_owned(),
        caption: "Counted by the board since its start or its last reset.".to_owned(),
        legend: Vec::new(),
        body: page::table(&["link", "count"], &rows),
    }
}

fn cost(report: &ClosedLoopReport) -> Section {
    let row = |name: &str, cost: BoardCost| {
        vec![name.to_owned(), cost.mean.to_string(), cost.max.to_string()]
    };
    Section {
        heading: "Cost of a tick".to_owned(),
        caption: if report.tick_cost.max > 0 {
            "In counts of the board's own counter. In the emulator they are executed instructions, not the cycles of silicon."
        } else {
            "This board has no counter; run on an emulated or real one to see what a tick costs."
        }
        .to_owned(),
        legend: Vec::new(),
        body: page::table(
            &["counts", "mean", "largest"],
            &[
                row("tick", report.tick_cost),
                row("learning from a tick", report.learning_cost),
            ],
        ),
    }
}

fn this_run(report: &ClosedLoopReport, command: &str) -> Section {
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    Section {
        heading: "This run".to_owned(),
        caption: "What it takes to repeat it: with a native or emulated board, the same seed and firmware give the same figures to the last digit.".to_owned(),
        legend: Vec::new(),
        body: page::command(command)
            + &page::table(
                &["", "value"],
                &[
                    row("robot", report.robot.clone()),
                    row("board", report.board.clone()),
                    row("board's store", format!("{:?}", report.store).to_lowercase()),
                    row("seed", report.seed.to_string()),
                    row("period", format!("{} ms", report.period_s * 1e3)),
                    row("compiler of the board's code", report.toolchain.clone()),
                ],
            ),
    }
}
