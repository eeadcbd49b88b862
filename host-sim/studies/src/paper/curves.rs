//! Curves of the steps, for figures and tables.

use foretorque::arm::ur5::JOINTS;
use super::rigid::Sample;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::table::{TableWriter, joint_columns, state_columns};
use std::io;
use std::path::Path;

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
        let mut header = vec!["t_s".to_owned()];
        header.extend(state_columns(JOINTS));
        header.extend(joint_columns("tau", "nm", JOINTS));
        let mut table = TableWriter::create(&out.join("training.csv"), &header)?;
        for (t_s, state, tau) in &self.data {
            table.row(values(t_s, state).chain(tau.iter()))?;
        }
        table.finish()?;
        header.extend(joint_columns("bp_physical", "nm", JOINTS));
        header.extend(joint_columns("bp_black_box", "nm", JOINTS));
        let mut table = TableWriter::create(&out.join("validation.csv"), &header)?;
        for (t_s, state, torques) in &self.path {
            table.row(values(t_s, state).chain(torques.iter().flat_map(|tau| tau.iter())))?;
        }
        table.finish()
    }
}

fn values<'a>(t_s: &'a f64, state: &'a State<JOINTS>) -> impl Iterator<Item = &'a f64> {
    let motion = state.q.iter().chain(&state.qd).chain(&state.qdd);
    std::iter::once(t_s).chain(motion)
}
