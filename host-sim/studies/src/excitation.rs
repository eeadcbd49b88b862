//! The excitation campaign: one search for every seed, every limit counted again on many points by independent code.

use crate::{Outcome, Progress, Records, StudyError};
use foretorque_workbench::dynamics::RigidBodies;
use foretorque_workbench::excitation::{Excitation, SearchConfig, optimise};
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::robot::{Placement, Robot, segment_distance};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Settings of the campaign.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExcitationConfig {
    /// Robot: a built-in name or a description file.
    pub robot: String,
    /// First seed.
    pub seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Points of a period on which limits are counted again.
    pub points: u32,
    /// Starts of each search.
    pub starts: usize,
    /// Most iterations of a round for the best quarter of the starts.
    pub iterations: usize,
    /// Limit of the condition number.
    pub condition_limit: f64,
}

impl ExcitationConfig {
    /// The campaign for a robot; if `quick`, short searches on few points, which do not reach the lowest condition numbers.
    pub fn new(quick: bool, robot: &str, seed: u64, seeds: u64) -> Self {
        let search = SearchConfig::default();
        let (starts, iterations) = (search.starts, search.iterations);
        let (points, starts, iterations, condition_limit) = match quick {
            true => (2000, 4, 40, 200.0),
            false => (100_000, starts, iterations, search.condition_limit),
        };
        Self {
            robot: robot.to_owned(),
            seed,
            seeds,
            points,
            starts,
            iterations,
            condition_limit,
        }
    }
}

/// Result of the search of one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedRecord {
    /// Seed.
    pub seed: u64,
    /// Predicted torque error on task motion, %.
    pub predicted_nrmse_percent: f64,
    /// Condition number of the links' base regressor, standard DH frames, raw SI.
    pub condition_number_dh: f64,
    /// Condition number in the board's frames.
    pub condition_number_board: f64,
    /// Limits counted again.
    pub recount: Recount,
    /// The coefficients.
    pub excitation: Excitation,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExcitationReport {
    /// Version of this program.
    pub version: &'static str,
    /// Settings.
    pub config: ExcitationConfig,
    /// Largest predicted torque error of all seeds, %.
    pub worst_predicted_nrmse_percent: f64,
    /// Largest condition number, standard DH frames.
    pub worst_condition_number_dh: f64,
    /// Limits missed, over all seeds and points.
    pub violations: u64,
    /// Values beyond the worst of the certificates.
    pub beyond_certificate: u64,
    /// Seed by seed.
    pub seeds: Vec<SeedRecord>,
}

/// Runs the campaign; `None` if the records are only written.
///
/// Errors: no such robot; a search that finds nothing; the records'.
pub fn run(
    config: ExcitationConfig,
    records: &Records,
    progress: Progress<'_>,
) -> Result<Option<Outcome<ExcitationReport>>, StudyError> {
    let robot = Robot::load(&config.robot)?;
    if robot.coupling.is_some() {
        let problem = format!("{}: the study has no coupled joints", config.robot);
        return Err(problem.into());
    }
    let (robot, _) = robot.with_assumed_rotors();
    let made_of = ExcitationConfig {
        seed: 0,
        seeds: 0,
        ..config.clone()
    };
    let seeds: Vec<u64> = (config.seed..config.seed + config.seeds).collect();
    let found = records.of(
        &made_of,
        (&seeds, |record: &SeedRecord| record.seed),
        // One search at a time: it takes all cores itself.
        1,
        |seed| search(&robot, &config, *seed),
        progress,
    )?;
    Ok(found.map(|seeds| outcome(config, seeds)))
}

fn search(robot: &Robot, config: &ExcitationConfig, seed: u64) -> Result<SeedRecord, StudyError> {
    let search = SearchConfig {
        seed,
        starts: config.starts,
        iterations: config.iterations,
        condition_limit: config.condition_limit,
        ..SearchConfig::default()
    };
    let mut excitation = optimise(robot, &search, None, |_, _| ())?;
    let uncertified = || StudyError::from("the excitation has no certificate".to_owned());
    let recount = recount(robot, &excitation, search.range_rad, config.points);
    let recount = recount.ok_or_else(uncertified)?;
    let certificate = excitation.certificate.take().ok_or_else(uncertified)?;
    Ok(SeedRecord {
        seed,
        predicted_nrmse_percent: certificate.predicted_nrmse_percent,
        condition_number_dh: certificate.condition_number_dh,
        condition_number_board: certificate.condition_number_board,
        recount,
        excitation,
    })
}

fn outcome(config: ExcitationConfig, seeds: Vec<SeedRecord>) -> Outcome<ExcitationReport> {
    let worst = |pick: fn(&SeedRecord) -> f64| seeds.iter().map(pick).fold(0.0, f64::max);
    let report = ExcitationReport {
        version: env!("CARGO_PKG_VERSION"),
        worst_predicted_nrmse_percent: worst(|r| r.predicted_nrmse_percent),
        worst_condition_number_dh: worst(|r| r.condition_number_dh),
        violations: seeds.iter().map(|r| r.recount.violations).sum(),
        beyond_certificate: seeds.iter().map(|r| r.recount.beyond_certificate).sum(),
        config,
        seeds,
    };
    let line = |name: &str, percent: f64, condition: f64, violations: u64| {
        format!(
            "{name:<8} {percent:.4} %  condition number {condition:.2}  {violations} violations"
        )
    };
    let mut text = String::new();
    for own in &report.seeds {
        let (percent, condition) = (own.predicted_nrmse_percent, own.condition_number_dh);
        let name = format!("seed {}", own.seed);
        text += &(line(&name, percent, condition, own.recount.violations) + "\n");
    }
    let percent = report.worst_predicted_nrmse_percent;
    let condition = report.worst_condition_number_dh;
    text += &line("worst", percent, condition, report.violations);
    text += &format!(" on {} points each\n", report.config.points);
    let violations = report.violations;
    Outcome {
        page: page(&report),
        report,
        text,
        broken: (violations > 0).then(|| format!("{violations} limits are broken")),
    }
}

fn page(report: &ExcitationReport) -> Page {
    let config = &report.config;
    let seeds = report.seeds.iter().map(|seed| {
        [
            seed.seed.to_string(),
            format!("{:.4}", seed.predicted_nrmse_percent),
            format!("{:.2}", seed.condition_number_dh),
            format!("{:.2}", seed.condition_number_board),
            seed.recount.violations.to_string(),
            seed.recount.beyond_certificate.to_string(),
        ]
    });
    let lead = format!(
        "Robot {}, seeds {} to {}: one search each ({} starts, {} iterations), condition number at most {}.",
        config.robot,
        config.seed,
        config.seed + config.seeds - 1,
        config.starts,
        config.iterations,
        config.condition_limit
    );
    let caption = format!(
        "Violations: position, velocity, acceleration, torque, table and distance of links, counted again at {} instants of the \
         period by independent code. Beyond certificate: values above the certificate's worst.",
        config.points
    );
    Page::new("Excitation campaign", lead)
        .card(
            format!("{:.3} %", report.worst_predicted_nrmse_percent),
            "largest predicted torque error (10 s, 1 % noise)",
        )
        .card(
            format!("{:.1}", report.worst_condition_number_dh),
            "largest condition number (links, standard DH frames, raw SI)",
        )
        .card(
            report.violations,
            format!("limits missed on {} points of each seed", config.points),
        )
        .sections([Section::new("Seed by seed", caption).table(
            "seed | predicted error / % | condition number, DH | condition number, board | violations | beyond certificate",
            seeds,
        )])
}

/// Result of a recount.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recount {
    /// Instants that were looked at.
    pub points: u32,
    /// Limits missed: position, velocity, acceleration, torque, table, distance of links.
    pub violations: u64,
    /// Velocities, accelerations and torques beyond the certificate's worst.
    pub beyond_certificate: u64,
}

/// Counts violated limits at `points` instants of a period; `None` when the excitation carries no certificate of this
/// robot.
///
/// * `range_rad` range of every joint around zero that the excitation was made for
pub fn recount(
    robot: &Robot,
    excitation: &Excitation,
    range_rad: f64,
    points: u32,
) -> Option<Recount> {
    let model = RigidBodies::new(robot);
    let certificate = excitation.certificate.as_deref()?;
    let worst = |limit: &str, of: &str| {
        let mut checks = certificate.limits.iter();
        let check = checks.find(|check| check.limit == limit && check.of == of);
        check.map(|check| check.worst)
    };
    let peaks = robot.joints.iter().map(|joint| {
        let of = |limit| worst(limit, &joint.name);
        Some([of("velocity")?, of("acceleration")?, of("torque")?])
    });
    let peaks: Vec<[f64; 3]> = peaks.collect::<Option<_>>()?;
    let clear = robot.workspace.clearance;
    let (mut violations, mut beyond) = (0, 0);
    for k in 0..points {
        let state = excitation.motion(excitation.period_s * f64::from(k) / f64::from(points));
        let rigid = model.inverse_dynamics(&state);
        let mut expect = |kept: bool| violations += u64::from(!kept);
        for (j, joint) in robot.joints.iter().enumerate() {
            let limits = &joint.limits;
            let friction = joint.friction.viscous * state.qd[j]
                + joint.friction.coulomb * state.qd[j].signum();
            let tau = (rigid[j] + friction).abs();
            let (low, high) = limits.position;
            // About zero, or about the end of the range next to it.
            expect((state.q[j] - 0.0_f64.clamp(low, high)).abs() <= range_rad);
            expect((limits.position.0..=limits.position.1).contains(&state.q[j]));
            expect(state.qd[j].abs() <= limits.velocity);
            expect(state.qdd[j].abs() <= limits.acceleration);
            expect(tau <= limits.torque);
            let seen = [state.qd[j].abs(), state.qdd[j].abs(), tau];
            let pairs = seen.iter().zip(&peaks[j]);
            beyond += pairs.filter(|(seen, peak)| seen > peak).count() as u64;
        }
        let links = placed(robot, &state.q);
        for (outer, capsules) in links.iter().enumerate() {
            for (ends, radius) in capsules {
                let lowest = ends[0].z.min(ends[1].z) - radius;
                let table = robot.workspace.table_height;
                expect(outer == 0 || table.is_none_or(|table| lowest >= table + clear));
                for (other, width) in links.iter().take(outer.saturating_sub(1)).flatten() {
                    expect(segment_distance(ends, other) - radius - width >= clear);
                }
            }
        }
    }
    Some(Recount {
        points,
        violations,
        beyond_certificate: beyond,
    })
}

/// Ends of all capsules in the base frame, and their radii, link by link.
fn placed(robot: &Robot, q: &[f64]) -> Vec<Vec<([Vector3<f64>; 2], f64)>> {
    let mut frame = Placement::identity();
    let links = robot.joints.iter().zip(q).map(|(joint, q)| {
        frame = frame.then(&joint.placement).turned(*q);
        let at = |end| frame.point(&end);
        let capsules = joint.capsules.iter();
        capsules.map(|own| (own.ends.map(at), own.radius)).collect()
    });
    links.collect()
}
