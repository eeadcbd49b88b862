//! The paper's experiment (Zhong, section 4.1) on the UR5, and the robustness it asserts, measured.
//!
//! `steps` (1) excitation and joint sequence through inverse kinematics, (2) torques of known parameters, (3) the BP network
//! on 80 % of them, (4) an arbitrary path. `cell` one draw of the robustness study: every method on the same rows.
//! `summary` adds the draws up; `page` shows them, `findings` states them.

mod cell;
mod config;
mod findings;
mod page;
mod rigid;
mod steps;
mod summary;

pub use cell::{Cell, CellRecord, FRICTIONS, FrictionKind, MethodDraw};
pub use config::{PaperConfig, PaperReport};
pub use steps::{JointTorque, ParameterRow, Steps, Trained};
pub use summary::{Condition, MethodSummary, Times};

use crate::records::Records;
use crate::{Outcome, Progress, StudyError};
use cell::{Bench, ROWS};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::parallel::cores;
use foretorque_workbench::report::write_json;
use foretorque_workbench::robot::Robot;
use std::path::Path;

/// Runs the study; its tables, pictures and times go to `out`. `None` if the records are only written.
///
/// Errors: an excitation for another robot, or one that shows too little; the records'; files that cannot be written.
pub fn run(
    config: PaperConfig,
    records: &Records,
    out: &Path,
    progress: Progress<'_>,
) -> Result<Option<Outcome<PaperReport>>, StudyError> {
    let robot = Robot::load("ur5")?;
    config.excitation.check(&robot)?;
    let bench = Bench::new(robot, &config.excitation, ROWS).ok_or(StudyError::Joints(JOINTS))?;
    let made_of = PaperConfig {
        seed: 0,
        seeds: 0,
        ..config.clone()
    };
    let records = records.of(
        &made_of,
        (&config.cells(), |record: &CellRecord| record.cell),
        cores(),
        |cell| bench.draw(cell),
        progress,
    )?;
    let Some(records) = records else {
        return Ok(None);
    };
    let (steps, curves) = steps::run(&bench.robot, &config.excitation, config.seed)?;
    let conditions = summary::summarise(&records);
    let report = PaperReport {
        version: env!("CARGO_PKG_VERSION"),
        findings: findings::findings(&steps, &conditions),
        steps,
        conditions,
        config,
    };
    let times = summary::times(&records);
    curves.write(out)?;
    for (name, picture) in page::pictures(&report, &curves)? {
        write_whole(&out.join(name), picture.as_bytes())?;
    }
    write_json(&out.join("timing.json"), &times)?;
    Ok(Some(Outcome {
        page: page::page(&report, &curves, &times),
        text: page::text(&report),
        report,
    }))
}
