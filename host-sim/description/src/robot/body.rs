//! Mass distributions of links: checks, conversions, lumping, seeded perturbation. Drives that turn several joints.

use super::{LINK_PARAMETERS, Link, MAX_JOINTS, Placement, Robot};
use nalgebra::{DMatrix, Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

impl Link {
    /// Standard parameters: m, m·x, m·y, m·z, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin of the link frame (eq. 14).
    ///
    /// Parallel axes: `I_o = I_c + m (c·c 1 − c cᵀ)`.
    pub fn standard_parameters(&self) -> [f64; LINK_PARAMETERS] {
        let (m, c) = (self.mass, self.com);
        let i = self.inertia_com + m * (c.dot(&c) * Matrix3::identity() - c * c.transpose());
        let first = m * c;
        let [xx, yy, zz, xy, xz, yz] = [i.m11, i.m22, i.m33, i.m12, i.m13, i.m23];
        [m, first.x, first.y, first.z, xx, yy, zz, xy, xz, yz]
    }

    /// Second moments of mass about the centre of mass, `½ tr(I) 1 − I`, kg·m².
    ///
    /// A mass distribution exists exactly when this matrix has no negative eigenvalue, which is the triangle inequality
    /// of the principal moments of inertia.
    pub fn second_moments(&self) -> Matrix3<f64> {
        0.5 * self.inertia_com.trace() * Matrix3::identity() - self.inertia_com
    }

    /// Defect of an inertia tensor (kg·m², about the centre of mass) that no body has; `None` for a possible one.
    ///
    /// The principal moments of a body are positive, and none exceeds the sum of the others.
    pub fn inertia_problem(inertia: &Matrix3<f64>) -> Option<&'static str> {
        let moments = inertia.symmetric_eigenvalues();
        // Rounded data-sheet figures may miss the inequality in their last digit.
        let triangle = 2.0 * moments.max() <= moments.sum() * (1.0 + 1e-6);
        if moments.min() <= 0.0 {
            Some("is not positive definite")
        } else if !triangle {
            Some("breaks the triangle inequality: no body has these principal moments")
        } else {
            None
        }
    }

    /// The link with the nearest inertia that a body has, and the largest change of an entry, kg·m².
    ///
    /// Second moments of mass below a thousandth of the largest become that: the nearest in the Frobenius norm that keeps
    /// a margin.
    pub fn repaired(&self) -> (Self, f64) {
        let repaired = self.with_least_moments(|moments| (1e-3 * moments.max()).max(1e-9));
        (repaired, (repaired.inertia_com - self.inertia_com).amax())
    }

    /// The link with its principal second moments of mass raised to `least` of them, kg·m².
    pub fn with_least_moments(&self, least: impl Fn(&Vector3<f64>) -> f64) -> Self {
        let mut moments = self.second_moments().symmetric_eigen();
        let least = least(&moments.eigenvalues);
        let raise = |moment: &mut f64| *moment = moment.max(least);
        moments.eigenvalues.apply(raise);
        let moments = moments.recompose();
        Self {
            inertia_com: moments.trace() * Matrix3::identity() - moments,
            ..*self
        }
    }

    /// A rod of `mass`, kg, and 5 cm radius from the origin to `end`, m.
    pub fn rod(mass: f64, end: &Vector3<f64>) -> Self {
        const RADIUS_SQUARED: f64 = 0.0025;
        let along = end * end.transpose() / 12.0 + Matrix3::identity() * (RADIUS_SQUARED / 4.0);
        Self {
            mass,
            com: 0.5 * end,
            inertia_com: mass * (along.trace() * Matrix3::identity() - along),
        }
    }

    /// The link with these standard parameters (eq. 14), the inverse of [`Link::standard_parameters`].
    ///
    /// Assumes: a positive mass.
    pub fn from_standard_parameters(x: &[f64; LINK_PARAMETERS]) -> Self {
        let [mass, mx, my, mz, xx, yy, zz, xy, xz, yz] = *x;
        let com = Vector3::new(mx, my, mz) / mass;
        let about_origin = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let apart = com.dot(&com) * Matrix3::identity() - com * com.transpose();
        Self {
            mass,
            com,
            inertia_com: about_origin - mass * apart,
        }
    }

    /// This link, given in a frame that lies at `frame`, in the parent of that frame.
    pub fn placed(&self, frame: &Placement) -> Self {
        let rot = frame.rot_parent_child;
        Self {
            mass: self.mass,
            com: frame.point(&self.com),
            inertia_com: rot * self.inertia_com * rot.transpose(),
        }
    }

    /// One link for several that move as one body, all in the same frame; `None` when there are none.
    ///
    /// Parallel axes: `I = Σ I_k + m_k (d·d 1 − d dᵀ)`, d from the common centre of mass to that of part k.
    pub fn lumped(parts: &[Self]) -> Option<Self> {
        if let [single] = parts {
            return Some(*single);
        }
        let mass: f64 = parts.iter().map(|part| part.mass).sum();
        let first: Vector3<f64> = parts.iter().map(|part| part.com * part.mass).sum();
        let com = first / mass;
        let about_com = |part: &Self| {
            let d = part.com - com;
            part.inertia_com + part.mass * (d.dot(&d) * Matrix3::identity() - d * d.transpose())
        };
        (!parts.is_empty()).then(|| Self {
            mass,
            com,
            inertia_com: parts.iter().map(about_com).sum(),
        })
    }
}

/// Largest relative change of masses, centres of mass and inertias in a varied robot.
const VARIED: f64 = 0.2;

impl Robot {
    /// The plant for acceptance: this robot with its mass distribution varied by up to 20 %, everything else as described.
    ///
    /// The same seed gives the same robot, and every link stays a possible body.
    pub fn perturbed(&self, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut robot = self.clone();
        for joint in &mut robot.joints {
            joint.link = perturbed_link(&joint.link, &mut random);
        }
        robot
    }

    /// The wrong prior of a plant: varied once more, with another seed; rotor inertias −20 %, viscous and Coulomb friction
    /// −40 %, no Stribeck peak, no cogging.
    pub fn wrong_prior(&self, seed: u64) -> Self {
        let mut robot = self.perturbed(seed);
        for joint in &mut robot.joints {
            joint.drive.rotor_inertia *= 0.8;
            joint.friction.viscous *= 0.6;
            joint.friction.coulomb *= 0.6;
            joint.friction.stribeck_ratio = 0.0;
            joint.friction.cogging = 0.0;
        }
        robot
    }
}

/// Acceleration of an unloaded rotor at the torque limit, rad/s²: geared drives of arms lie between 70 and 300.
const ROTOR_ACCELERATION_RAD_S2: f64 = 200.0;

impl Robot {
    /// This robot with a rotor at every joint, and the joints (from 1) at which the description gives none: there it is the
    /// torque limit over 200 rad/s². A drive without a rotor cannot be controlled at 1 kHz.
    pub fn with_assumed_rotors(&self) -> (Self, Vec<usize>) {
        let (mut robot, mut assumed) = (self.clone(), Vec::new());
        for (j, joint) in robot.joints.iter_mut().enumerate() {
            if joint.drive.rotor_inertia <= 0.0 {
                joint.drive.rotor_inertia = joint.limits.torque / ROTOR_ACCELERATION_RAD_S2;
                assumed.push(j + 1);
            }
        }
        (robot, assumed)
    }
}

/// Mass and centre of mass move by up to 20 % of themselves (the centre by up to 20 % of its distance, in any direction).
/// The second moments S of the mass become `A S Aᵀ` with `A = 1 + 0.1 · noise`: S stays positive semi-definite, so the
/// link stays a body, its moments move by about 20 %, and off-diagonal entries appear.
fn perturbed_link(link: &Link, random: &mut ChaCha8Rng) -> Link {
    let mass = link.mass * (1.0 + VARIED * symmetric(random));
    let direction = Vector3::from_fn(|_, _| symmetric(random));
    let com = link.com + direction * (VARIED * link.com.norm() / 3.0_f64.sqrt());
    let shape = Matrix3::from_fn(|row, col| {
        f64::from(u8::from(row == col)) + 0.5 * VARIED * symmetric(random)
    });
    let moments = shape * link.second_moments() * shape.transpose();
    Link {
        mass,
        com,
        inertia_com: moments.trace() * Matrix3::identity() - moments,
    }
}

fn symmetric(random: &mut ChaCha8Rng) -> f64 {
    random.random_range(-1.0..=1.0)
}

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
