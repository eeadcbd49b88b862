//! The setup of the soak: the true UR5, the wrong prior, the paths.

use crate::StudyError;
use crate::prior::bank_of;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::feedforward::{ParameterSet, evaluate};
use foretorque::joint::JointMotion;
use foretorque_workbench::board::BoardError;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::metrics::TorqueError;
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::via::ViaPath;
use foretorque_workbench::trajectory::{Trajectory, VALIDATION_PEAK_RAD_S};

/// Joints of the arm of this study.
pub(super) const N: usize = JOINTS;
/// Base parameters of it.
pub(super) const P: usize = PARAMETERS;
/// Everything that is learnt.
pub(super) type Set = ParameterSet<N, P>;

/// Points of the unseen path on which sets are judged.
const UNSEEN_POINTS: usize = 250;

/// The setup of a seed.
pub(super) struct Setup {
    pub(super) seed: u64,
    /// The arm as described.
    pub(super) described: Robot,
    /// The arm as it is.
    pub(super) truth: Robot,
    /// The wrong prior: inertias 20 % and friction 40 % off.
    pub(super) wrong: Set,
    /// The unseen path.
    unseen: Vec<(State<N>, JointMotion<N>)>,
}

impl Setup {
    pub(super) fn new(seed: u64) -> Result<Self, StudyError> {
        let described = Robot::load("ur5")?;
        let truth = described.perturbed(seed, &Perturbation::PLANT);
        let wrong = truth.perturbed(seed.wrapping_add(1), &Perturbation::WRONG_PRIOR);
        let validation = Trajectory::<N>::validation(&described, seed.wrapping_add(2));
        let unseen = (0..UNSEEN_POINTS).map(|k| {
            let share = k as f64 / UNSEEN_POINTS as f64;
            let state = validation.at(share * validation.duration_s());
            (state, motion_f32(&state))
        });
        Ok(Self {
            seed,
            wrong: bank_of::<Ur5, N, P>(&wrong)
                .set::<Ur5, N, P>()
                .map_err(BoardError::Bank)?,
            unseen: unseen.collect(),
            described,
            truth,
        })
    }

    /// The true arm.
    pub(super) fn plant(&self, config: PlantConfig) -> Result<Plant<N>, StudyError> {
        let seed = self.seed.wrapping_mul(1000);
        Plant::new(&self.truth, config, seed).ok_or(StudyError::Joints(N))
    }

    /// The task of the arm: a path through via points, another one for each `stream`.
    pub(super) fn task(&self, seconds: f64, stream: u64) -> ViaPath<N> {
        let seed = self.seed.wrapping_add(3 + stream);
        ViaPath::random(&self.described, seed, seconds, VALIDATION_PEAK_RAD_S)
    }

    /// The torques that `plant` needs along the unseen path.
    pub(super) fn needed(&self, plant: &Plant<N>) -> Vec<Joints<N>> {
        let motions = self.unseen.iter();
        motions.map(|(state, _)| plant.true_torque(state)).collect()
    }

    /// The torques of `set` along the unseen path.
    pub(super) fn predicted(&self, set: &Set) -> Vec<Joints<N>> {
        let motions = self.unseen.iter();
        motions
            .map(|(_, motion)| evaluate::<Ur5, N, P>(set, motion).total.cast())
            .collect()
    }

    /// Error of `predicted` against `needed` along the unseen path.
    pub(super) fn error(&self, predicted: &[Joints<N>], needed: &[Joints<N>]) -> TorqueError<N> {
        let mut error = TorqueError::default();
        for (((state, _), predicted), needed) in self.unseen.iter().zip(predicted).zip(needed) {
            error.add(needed, predicted, &state.qd);
        }
        error
    }
}
