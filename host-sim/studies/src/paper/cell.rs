//! One draw of the robustness study: an arm, its noisy torques on the excitation, every method, an unseen path.

use crate::{StudyError, unsupported};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::identification::{
    ColumnSet, Layout, MethodName, MethodResult, SampleRow, despiked, fit_rows,
};
use foretorque_workbench::metrics::{MOVING_RAD_S, TorqueError};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{LINK_PARAMETERS, Robot};
use foretorque_workbench::trajectory::Trajectory;
use nalgebra::DMatrix;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Rows of one period of the excitation, of which 80 % are drawn for training.
pub(super) const ROWS: usize = 2500;
/// Size of an outlier, share of the torque limit: 20 standard deviations of 1 % noise.
const OUTLIER: f64 = 0.2;
/// Step of the unseen path, s.
const PATH_STEP_S: f64 = 0.02;
/// Rows on either side that an outlier is compared with.
const SPIKE_REACH: usize = 2;
/// The columns that a practitioner would add for a Stribeck peak.
const RICHER: &str = "coulomb-viscous+stribeck";

/// Methods on the plain columns.
const PLAIN: [MethodName; 7] = [
    MethodName::Ols,
    MethodName::Wls,
    MethodName::Irls,
    MethodName::Consistent,
    MethodName::BpPhysical,
    MethodName::BpResidual,
    MethodName::BpBlackBox,
];

/// Friction of the true arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrictionKind {
    /// None at all.
    None,
    /// Friction that every linear model here can represent.
    CoulombViscous,
    /// A Stribeck peak on top, which the plain columns cannot form.
    Stribeck,
}

/// All of them.
pub const FRICTIONS: [FrictionKind; 3] = [
    FrictionKind::None,
    FrictionKind::CoulombViscous,
    FrictionKind::Stribeck,
];

impl FrictionKind {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "no friction",
            Self::CoulombViscous => "Coulomb + viscous",
            Self::Stribeck => "Coulomb + viscous + Stribeck",
        }
    }
}

/// Conditions of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Standard deviation of the torque noise, % of the torque limit.
    pub noise_percent: f64,
    /// Friction of the arm.
    pub friction: FrictionKind,
    /// Share of the samples of each joint that are outliers, %.
    pub outlier_percent: f64,
    /// Training rows.
    pub rows: usize,
    /// Seed of everything random.
    pub seed: u64,
}

/// Result of one method on a draw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodDraw {
    /// Torque error on the unseen path against the noise-free torque, moving rows, a ratio.
    pub path_nrmse_ratio: f64,
    /// NRMSE on the 20 % of the excitation's rows that were held out.
    pub split_nrmse_ratio: f64,
    /// Epochs or iterations.
    pub epochs: usize,
    /// Time of the training, s.
    pub seconds: f64,
}

/// One draw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellRecord {
    /// Conditions of the draw.
    pub cell: Cell,
    /// Methods by name.
    pub methods: BTreeMap<String, MethodDraw>,
    /// Methods that found no model, and why.
    pub failed: BTreeMap<String, String>,
}

/// A choice of columns, and the columns of the excitation's rows.
#[derive(Clone, Debug)]
struct Model {
    layout: Layout,
    panels: Vec<Box<[f64]>>,
    methods: &'static [MethodName],
    suffix: &'static str,
}

/// Inputs that all draws share.
#[derive(Clone, Debug)]
pub(super) struct Bench {
    /// The description of the arm that the methods get.
    pub(super) robot: Robot,
    states: Vec<State<JOINTS>>,
    models: [Model; 2],
}

impl Bench {
    /// `rows` even instants of one period of the excitation; `None` when the robot has not six joints.
    pub(super) fn new(robot: Robot, excitation: &Excitation, rows: usize) -> Option<Self> {
        let states: Vec<State<JOINTS>> = (0..rows)
            .map(|k| excitation.at(excitation.period_s * k as f64 / rows as f64))
            .collect();
        // The arms of this study have no cogging.
        let mut smooth = robot.clone();
        for joint in &mut smooth.joints {
            joint.friction.cogging_cycles_rev = 0.0;
        }
        let model = |columns: &ColumnSet, methods, suffix| {
            let layout = Layout::new(&smooth, columns);
            Model {
                panels: panels(&layout, &states),
                layout,
                methods,
                suffix,
            }
        };
        let plain = model(&ColumnSet::plain(), &PLAIN[..], "");
        let richer = model(&RICHER.parse().ok()?, &[MethodName::Irls][..], "_stribeck");
        Some(Self {
            models: [plain, richer],
            robot,
            states,
        })
    }

    /// Draws, trains, judges.
    ///
    /// Errors: none but a description that is not the UR5. A method that finds no model is in the record.
    pub(super) fn draw(&self, cell: &Cell) -> Result<CellRecord, StudyError> {
        let quiet = PlantConfig {
            torque_noise: 0.0,
            viscous_drift: 0.0,
            ..PlantConfig::default()
        };
        let plant = Plant::<JOINTS>::new(&arm(&self.robot, cell), quiet, cell.seed);
        let plant = plant.ok_or_else(|| unsupported(JOINTS))?;
        let torques = |states: &[State<JOINTS>]| -> Vec<Joints<JOINTS>> {
            let torques = states.iter().map(|state| plant.true_torque(state));
            torques.collect()
        };
        let mut random = ChaCha8Rng::seed_from_u64(cell.seed);
        let exact = torques(&self.states);
        let measured = self.measured(&exact, cell, &mut random);
        let (clean, _) = despiked(&measured, JOINTS, SPIKE_REACH);
        let mut order: Vec<usize> = (0..self.states.len()).collect();
        order.shuffle(&mut random);
        let (training, held_out) = order.split_at(order.len() * 4 / 5);
        let mut training = training[..cell.rows.min(training.len())].to_vec();
        // In the order of time, as a log is: networks hold blocks of it out for themselves.
        training.sort_unstable();
        let held: Vec<State<JOINTS>> = held_out.iter().map(|&k| self.states[k]).collect();
        let held_exact: Vec<Joints<JOINTS>> = held_out.iter().map(|&k| exact[k]).collect();
        let path = Trajectory::<JOINTS>::validation(&self.robot, cell.seed);
        let ticks = 0..path.ticks(PATH_STEP_S);
        let path = ticks.map(|tick| path.at(tick as f64 * PATH_STEP_S));
        let path: Vec<State<JOINTS>> = path.collect();
        let path_exact = torques(&path);
        let (mut methods, mut failed) = (BTreeMap::new(), BTreeMap::new());
        for model in &self.models {
            let row = |&k: &usize| {
                let torques = [&measured, &clean].map(|table| &table[k * JOINTS..][..JOINTS]);
                row(&self.states[k], &model.panels[k], torques)
            };
            let rows: Vec<SampleRow> = training.iter().map(row).collect();
            let rows: Vec<&SampleRow> = rows.iter().collect();
            for method in model.methods {
                let name = format!("{method}{}", model.suffix);
                // Both sets of columns are on the board.
                let layout = &model.layout;
                let trials = fit_rows(&self.robot, (layout, layout), &[*method], &rows, cell.seed);
                let trial = match trials.map(|mut trials| trials.pop()) {
                    Ok(Some(trial)) => trial,
                    Ok(None) => continue,
                    Err(error) => {
                        failed.insert(name, error.to_string());
                        continue;
                    }
                };
                let draw = MethodDraw {
                    path_nrmse_ratio: score(&trial, layout, &path, &path_exact),
                    split_nrmse_ratio: score(&trial, layout, &held, &held_exact),
                    epochs: trial.record.epochs,
                    seconds: trial.record.seconds,
                };
                if draw.path_nrmse_ratio.is_finite() && draw.split_nrmse_ratio.is_finite() {
                    methods.insert(name, draw);
                } else {
                    failed.insert(name, "its torques are not finite".to_owned());
                }
            }
        }
        Ok(CellRecord {
            cell: *cell,
            methods,
            failed,
        })
    }

    /// Torques with noise and outliers, N·m, N a row.
    fn measured(&self, exact: &[Joints<JOINTS>], cell: &Cell, random: &mut ChaCha8Rng) -> Vec<f64> {
        let mut measured = Vec::with_capacity(exact.len() * JOINTS);
        for torque in exact {
            for (tau, joint) in torque.iter().zip(&self.robot.joints) {
                let noise: f64 = random.sample(StandardNormal);
                // Drawn whether used or not: conditions of one seed share what they can.
                let (share, up) = (random.random::<f64>(), random.random::<bool>());
                let outlier = match (share < 0.01 * cell.outlier_percent, up) {
                    (true, true) => OUTLIER,
                    (true, false) => -OUTLIER,
                    (false, _) => 0.0,
                };
                let disturbed = 0.01 * cell.noise_percent * noise + outlier;
                measured.push(tau + disturbed * joint.limits.torque);
            }
        }
        measured
    }
}

/// The true arm of a draw: the description's masses varied by up to 20 %, its friction as the cell asks, no cogging.
fn arm(robot: &Robot, cell: &Cell) -> Robot {
    let mut arm = robot.perturbed(cell.seed);
    for joint in &mut arm.joints {
        let friction = &mut joint.friction;
        friction.cogging = 0.0;
        if cell.friction != FrictionKind::Stribeck {
            friction.stribeck_ratio = 0.0;
        }
        if cell.friction == FrictionKind::None {
            friction.viscous = 0.0;
            friction.coulomb = 0.0;
        }
    }
    arm
}

/// The model's columns at every state.
fn panels(layout: &Layout, states: &[State<JOINTS>]) -> Vec<Box<[f64]>> {
    let mut scratch = DMatrix::zeros(JOINTS, (LINK_PARAMETERS + 1) * JOINTS);
    let row = |state: &State<JOINTS>| {
        let mut panel = Vec::with_capacity(layout.width);
        layout.append_row(&(*state).into(), 0.0, &mut scratch, &mut panel);
        panel.into_boxed_slice()
    };
    states.iter().map(row).collect()
}

/// A row with its torques, as measured and without outliers, N·m.
fn row(state: &State<JOINTS>, panel: &[f64], [measured, clean]: [&[f64]; 2]) -> SampleRow {
    SampleRow {
        // The paper's methods do not look at it.
        t_s: 0.0,
        state: (*state).into(),
        tau: measured.into(),
        clean: clean.into(),
        moving: state.qd.map(|qd| qd.abs() > MOVING_RAD_S).as_slice().into(),
        panel: panel.into(),
    }
}

/// NRMSE over the moving rows, a ratio.
fn score(
    trial: &MethodResult,
    layout: &Layout,
    states: &[State<JOINTS>],
    wanted: &[Joints<JOINTS>],
) -> f64 {
    let mut error = TorqueError::<JOINTS>::default();
    for ((state, panel), wanted) in states.iter().zip(panels(layout, states)).zip(wanted) {
        let row = row(state, &panel, [&[0.0; JOINTS]; 2]);
        let torque = trial.candidate.torque(layout, &row).into();
        error.add(wanted, &torque, &state.qd);
    }
    error.nrmse_moving()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_torques_give_an_exact_model_of_possible_bodies() {
        let robot = Robot::load("ur5").expect("built in");
        let excitation = serde_json::from_str(crate::paper::PRECOMPUTED).expect("precomputed");
        let mut bench = Bench::new(robot, &excitation, 2500).expect("six joints");
        bench.models[0].methods = &[MethodName::Consistent];
        bench.models[1].methods = &[];
        // Of the first ten arms the one that the arithmetic loses first.
        let cell = Cell {
            noise_percent: 0.0,
            friction: FrictionKind::CoulombViscous,
            outlier_percent: 0.0,
            rows: 2000,
            seed: 7,
        };
        let record = bench.draw(&cell).expect("six joints");
        let error = record.methods["consistent"].path_nrmse_ratio;
        assert!(error < 1e-5, "{error:e}");
    }
}
