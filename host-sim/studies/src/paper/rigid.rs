//! The known arm: its links alone, and the regressor of their base parameters (eq. 16); and the curves of the steps.

use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::{LINK_PARAMETERS, Robot};
use foretorque_workbench::table::write_motion;
use nalgebra::{DMatrix, DVector};
use std::io;
use std::path::Path;

/// Time, s, motion and torque, N·m.
pub(super) type Sample = (f64, State<JOINTS>, Joints<JOINTS>);

/// The linear rows of some states: every joint's rows over its RMS torque.
pub(super) struct Rows {
    pub(super) y: DMatrix<f64>,
    pub(super) tau: DVector<f64>,
}

impl Rows {
    pub(super) fn loss(&self, theta: &DVector<f64>) -> f64 {
        ((&self.y * theta - &self.tau).norm_squared() / self.tau.len() as f64).sqrt()
    }
}

/// The rigid body of the links alone, and the columns of its base parameters.
pub(super) struct RigidBody {
    pub(super) dynamics: ReferenceModel<JOINTS>,
    pub(super) columns: Vec<usize>,
    pub(super) truth: DVector<f64>,
}

impl RigidBody {
    pub(super) fn new(robot: &Robot) -> Option<Self> {
        let mut links = robot.clone();
        for joint in &mut links.joints {
            joint.drive.rotor_inertia = 0.0;
        }
        let map = links.base_map();
        let mut columns = map.columns.clone();
        columns.retain(|column| *column < LINK_PARAMETERS * JOINTS);
        // Rotors come last, and without them nothing of a rotor hides in a link's parameter.
        let truth = map.base_parameters(&links);
        Some(Self {
            dynamics: ReferenceModel::new(&links)?,
            truth: DVector::from_column_slice(&truth[..columns.len()]),
            columns,
        })
    }

    /// Columns of the base parameters at `state`, 6 × 36.
    pub(super) fn regressor(&self, state: &State<JOINTS>) -> DMatrix<f64> {
        self.dynamics.regressor(state).select_columns(&self.columns)
    }

    pub(super) fn rows(&self, data: &[Sample], scale: &Joints<JOINTS>) -> Rows {
        let mut y = DMatrix::zeros(data.len() * JOINTS, self.columns.len());
        let mut tau = DVector::zeros(data.len() * JOINTS);
        for (k, (_, state, torque)) in data.iter().enumerate() {
            let block = self.regressor(state);
            for j in 0..JOINTS {
                y.row_mut(k * JOINTS + j)
                    .copy_from(&(block.row(j) / scale[j]));
                tau[k * JOINTS + j] = torque[j] / scale[j];
            }
        }
        Rows { y, tau }
    }

    pub(super) fn torque(&self, state: &State<JOINTS>, theta: &DVector<f64>) -> Joints<JOINTS> {
        Joints::from_column_slice((self.regressor(state) * theta).as_slice())
    }

    pub(super) fn error_ratio(&self, theta: &DVector<f64>) -> f64 {
        (theta - &self.truth).norm() / self.truth.norm()
    }
}

/// Curves that are drawn and written as tables.
#[derive(Clone, Debug)]
pub(super) struct Curves {
    /// Epoch, loss on training and on held-out rows, for plain and accelerated descent.
    pub(super) losses: [Vec<(usize, f64, f64)>; 2],
    /// Epoch and loss of the black box.
    pub(super) black_box: Vec<(usize, f64)>,
    /// The training data.
    pub(super) data: Vec<Sample>,
    /// Time, motion, true torque, that of the network with physical weights, that of the black box.
    pub(super) path: Vec<(f64, State<JOINTS>, [Joints<JOINTS>; 3])>,
}

impl Curves {
    /// Writes the training data (steps 1 and 2) and the arbitrary path (step 4) as tables.
    pub(super) fn write(&self, out: &Path) -> io::Result<()> {
        let data = self.data.iter();
        let data = data.map(|(t_s, state, tau)| (*t_s, *state, [*tau]));
        write_motion(&out.join("training.csv"), ["tau"], data)?;
        let torques = ["tau", "bp_physical", "bp_black_box"];
        write_motion(
            &out.join("validation.csv"),
            torques,
            self.path.iter().copied(),
        )
    }
}
