//! The reproducible studies of foretorque, and its fault campaign.
//!
//! A study takes a configuration and gives an [`Outcome`]: figures for `report.json`, a page for `report.html`, and the same
//! figures as text that a snapshot keeps.

pub mod demo;
pub mod efficiency;
pub mod excitation;
pub mod faults;
pub mod learning;
pub mod paper;
pub mod real_ur5;
pub mod records;
pub mod replay;

use foretorque::arm::Arm;
use foretorque::dynamics::FrictionColumn;
use foretorque::learning::{ConfigError, ParameterSet};
use foretorque_link::bank::{BankError, NETWORK_SEED, ParameterBank};
use foretorque_workbench::Refusal;
use foretorque_workbench::board::BoardError;
use foretorque_workbench::identification::IdentifyError;
use foretorque_workbench::report::page::Page;
use foretorque_workbench::report::plot::PlotError;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::TableError;
use std::io;

/// Progress: stage, steps done, steps in all.
pub type Progress<'p> = &'p (dyn Fn(&'static str, usize, usize) + Sync);

/// Result of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome<R> {
    /// Figures, units in the keys.
    pub report: R,
    /// The page.
    pub page: Page,
    /// The main figures as lines of text; no line depends on the machine.
    pub text: String,
}

/// Failure of a study.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A request that the study cannot fulfil.
    #[error("{0}")]
    Unusable(String),
    /// A robot with another number of joints.
    #[error("robots of {0} joints are not supported")]
    Joints(usize),
    /// A board that broke off or refused.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// A configuration that the firmware refuses.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// A file that cannot be read or written.
    #[error(transparent)]
    File(#[from] io::Error),
    /// An identification that fails.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A file that is no JSON of this program.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// A robot that cannot be loaded, or an excitation that cannot be found or played.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// A log that cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
}

impl From<BankError> for StudyError {
    fn from(error: BankError) -> Self {
        Self::Board(BoardError::Bank(error))
    }
}

impl From<PlotError> for StudyError {
    fn from(error: PlotError) -> Self {
        Self::File(error.into())
    }
}

/// The parameter bank of a robot as described: rigid body, viscous and Coulomb friction, networks with zero output.
///
/// Assumes: `robot` has the geometry of `A`; only its masses and friction may differ from the description.
pub fn bank_of<A: Arm<N, P>, const N: usize, const P: usize>(robot: &Robot) -> ParameterBank {
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    for (place, value) in set.rigid.iter_mut().zip(robot.base_parameters()) {
        *place = value as f32;
    }
    for (place, joint) in set.friction.iter_mut().zip(&robot.joints) {
        place[FrictionColumn::Viscous] = joint.friction.viscous as f32;
        place[FrictionColumn::Coulomb] = joint.friction.coulomb as f32;
    }
    ParameterBank::from_set::<A, N, P>(&set)
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::Ur5;

    #[test]
    fn the_bank_of_the_description_holds_the_nominal_parameters_of_the_firmware() {
        let robot = Robot::load("ur5").expect("built in");
        let set = bank_of::<Ur5, 6, 40>(&robot)
            .set::<Ur5, 6, 40>()
            .expect("a bank for this arm");
        for (found, nominal) in set.rigid.iter().zip(<Ur5 as Arm<6, 40>>::NOMINAL) {
            assert!((found - nominal).abs() <= 1e-6 * nominal.abs().max(1.0));
        }
        assert_eq!(set.friction[0][FrictionColumn::Coulomb], 7.0);
    }
}
