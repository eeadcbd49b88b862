//! Drives that turn several joints, such as the two motors of a differential wrist.

use super::MAX_JOINTS;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Coupling in a description file.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CouplingFile {
    /// Names of the coupled joints, which are also those of their drives.
    pub(super) joints: Vec<String>,
    /// Turns of the drives (rows) a turn of the joints (columns).
    pub(super) matrix: Vec<Vec<f64>>,
}

/// Coupling between the joints of an arm and its drives: the drives turn by `θ = C q` where the joints turn by q.
///
/// Drive and joint torques m and τ have the same power, `mᵀ θ̇ = τᵀ q̇`, so `τ = Cᵀ m`.
#[derive(Clone, Debug, PartialEq)]
pub struct Coupling {
    drives: DMatrix<f64>,
    joints: DMatrix<f64>,
}

/// Smallest product of a direction of the drives and that of the joints that tells them apart, of 1.
const LEAST_DETERMINANT: f64 = 1e-6;

impl Coupling {
    /// The coupling of joints called `names`.
    ///
    /// Errors: a sentence on the defect.
    pub(super) fn new(file: &CouplingFile, names: &[&str]) -> Result<Self, String> {
        let size = file.joints.len();
        if file.matrix.len() != size || file.matrix.iter().any(|row| row.len() != size) {
            return Err(format!(
                "matrix must have {size} rows of {size} numbers, one for each of joints"
            ));
        }
        let mut drives = DMatrix::identity(names.len(), names.len());
        let mut places: Vec<usize> = Vec::new();
        for name in &file.joints {
            match names.iter().position(|known| known == name) {
                Some(place) if !places.contains(&place) => places.push(place),
                Some(_) => return Err(format!("joint '{name}' is named twice")),
                None => {
                    let names = names.join(", ");
                    return Err(format!("no joint '{name}', there are {names}"));
                }
            }
        }
        let mut lengths = 1.0;
        for (row, &drive) in file.matrix.iter().zip(&places) {
            for (value, &joint) in row.iter().zip(&places) {
                drives[(drive, joint)] = *value;
            }
            lengths *= row.iter().map(|value| value * value).sum::<f64>().sqrt();
        }
        let independent = drives.determinant().abs() > LEAST_DETERMINANT * lengths;
        match drives.clone().try_inverse() {
            Some(joints) if independent => Ok(Self { drives, joints }),
            _ => Err("the rows of matrix must be finite and independent".to_owned()),
        }
    }

    /// The file of this coupling.
    pub(super) fn file(&self, names: &[&str]) -> CouplingFile {
        let coupled: Vec<usize> = (0..names.len()).filter(|&j| self.couples(j)).collect();
        let row = |&drive: &usize| coupled.iter().map(|&j| self.drives[(drive, j)]).collect();
        CouplingFile {
            joints: coupled.iter().map(|&j| names[j].to_owned()).collect(),
            matrix: coupled.iter().map(row).collect(),
        }
    }

    /// The drive of `joint` turns otherwise than the joint.
    pub(super) fn couples(&self, joint: usize) -> bool {
        let unit = |other| f64::from(u8::from(other == joint));
        let mut others = 0..self.drives.nrows();
        others.any(|other| {
            [(joint, other), (other, joint)]
                .iter()
                .any(|&place| self.drives[place] != unit(other))
        })
    }

    /// Turns positions, velocities or accelerations of the joints into those of the drives.
    pub fn to_drives(&self, joints: &mut [f64]) {
        multiply(joints, |row, column| self.drives[(row, column)]);
    }

    /// Turns positions, velocities or accelerations of the drives into those of the joints.
    pub fn to_joints(&self, drives: &mut [f64]) {
        multiply(drives, |row, column| self.joints[(row, column)]);
    }

    /// Turns torques of the joints into those of the drives, N·m.
    pub fn to_drive_torques(&self, joints: &mut [f64]) {
        multiply(joints, |row, column| self.joints[(column, row)]);
    }

    /// Turns bounds of velocities, or of their rates, of the drives into those of the joints.
    pub fn to_joint_bounds(&self, drives: &mut [f64]) {
        multiply(drives, |row, column| self.joints[(row, column)].abs());
    }

    /// Turns bounds of joint torques into those of drive torques.
    pub fn to_drive_torque_bounds(&self, joints: &mut [f64]) {
        multiply(joints, |row, column| self.joints[(column, row)].abs());
    }

    /// A torque of `joint` takes one of `drive`.
    pub fn loads(&self, joint: usize, drive: usize) -> bool {
        self.joints[(joint, drive)] != 0.0
    }
}

/// Multiplies `values` by a square matrix, given by its entries.
fn multiply(values: &mut [f64], entry: impl Fn(usize, usize) -> f64) {
    let mut before = [0.0; MAX_JOINTS];
    before[..values.len()].copy_from_slice(values);
    let before = &before[..values.len()];
    for (row, value) in values.iter_mut().enumerate() {
        let terms = before.iter().enumerate();
        *value = terms.map(|(column, x)| entry(row, column) * x).sum();
    }
}
