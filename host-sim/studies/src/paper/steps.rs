//! The paper's steps (1) to (4): known parameters, no friction, no rotors, no noise, 36 base parameters.

use super::Curves;
use super::cell::ROWS;
use crate::{StudyError, unsupported};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::dynamics::{Joints, Motion, PerJoint, ReferenceModel, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::identification::{ColumnSet, Layout};
use foretorque_workbench::kinematics::Inverse;
use foretorque_workbench::metrics::{TorqueError, root_mean};
use foretorque_workbench::robot::{LINK_PARAMETERS, Placement, Robot};
use foretorque_workbench::training::{BlackBox, Descent, LinearLayer, PhysicalConfig};
use foretorque_workbench::trajectory::Trajectory;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// Step of the joint sequence, s.
const TICK_S: f64 = 1e-3;
/// Step of the arbitrary path, s.
const PATH_STEP_S: f64 = 0.01;
/// Largest step of a joint from its prediction, rad.
const JUMP_RAD: f64 = 0.05;
/// Epochs of the loss curves.
const EPOCHS: [usize; 14] = [
    1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000,
];

/// Results of the four steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Steps {
    /// (1) Poses of the flange along the excitation that inverse kinematics turned into joint positions.
    pub inverse_kinematics_poses: usize,
    /// Largest difference between these joint positions and the series', rad.
    pub inverse_kinematics_error_rad: f64,
    /// (3) Instants trained on, six torques each.
    pub training_rows: usize,
    /// Instants held out.
    pub validation_rows: usize,
    /// Base parameters: the weights of the network with physical weights.
    pub base_parameters: usize,
    /// The ways to train, least squares first.
    pub trained: [Trained; 4],
    /// Parameters of the accelerated network against the truth.
    pub parameters: Vec<ParameterRow>,
    /// (4) Joint by joint on the arbitrary path.
    pub joints: Vec<JointTorque>,
}

/// One way to find the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trained {
    /// Its name.
    pub name: &'static str,
    /// Epochs.
    pub epochs: usize,
    /// RMSE (eq. 20) on the training rows, every joint over its RMS torque, a ratio.
    pub training_loss_ratio: f64,
    /// Loss ratio on the held-out rows.
    pub validation_loss_ratio: f64,
    /// Norm of the error of the base parameters over their norm; `null` where there are none.
    pub base_parameter_error_ratio: Option<f64>,
    /// Torque error on the arbitrary path, all rows, a ratio.
    pub path_nrmse_ratio: f64,
}

/// One base parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterRow {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// True value.
    pub truth: f64,
    /// Identified value.
    pub value: f64,
}

/// One joint on the arbitrary path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointTorque {
    /// RMS of the true torque, N·m.
    pub torque_rms_nm: f64,
    /// RMS error of the network with physical weights, N·m.
    pub bp_physical_rmse_nm: f64,
    /// Its largest error, N·m.
    pub bp_physical_peak_nm: f64,
    /// RMS error of the black-box network, N·m.
    pub bp_black_box_rmse_nm: f64,
    /// Its largest error, N·m.
    pub bp_black_box_peak_nm: f64,
}

/// Takes the four steps.
///
/// Errors: an excitation that inverse kinematics cannot follow; one that does not show all parameters.
pub(super) fn run(
    robot: &Robot,
    excitation: &Excitation,
    seed: u64,
) -> Result<(Steps, Curves), StudyError> {
    let model = RigidBody::new(robot).ok_or_else(|| unsupported(JOINTS))?;
    let (data, poses, ik_error) = joint_sequence(robot, excitation, &model)?;
    let known = Known::new(&model, &data, arbitrary_path(robot, seed), seed);
    let [plain, fast] = [Descent::Plain, Descent::Accelerated].map(|way| known.physical(way, seed));
    let samples = known.training.iter().map(|(_, state, tau)| {
        let moving: PerJoint<bool> = [true; JOINTS].into();
        ((*state).into(), (*tau).into(), moving)
    });
    let samples: Vec<(Motion, PerJoint<f64>, _)> = samples.collect();
    let network = BlackBox::train(&samples, seed, &mut |_, _| ());
    let trained = [
        known.linear("least squares", 1, &known.least_squares()?),
        known.linear("bp_physical, gradient descent (eq. 21)", plain.1, &plain.0),
        known.linear("bp_physical, accelerated", fast.1, &fast.0),
        known.black_box("bp_black_box, 18-32-6 ReLU", &network),
    ];
    let path = known.path.iter().zip(&known.path_truth);
    let path = path.map(|((t_s, state), truth)| {
        let by_network = Joints::from(network.torque(&(*state).into()));
        let torques = [*truth, model.torque(state, &fast.0), by_network];
        (*t_s, *state, torques)
    });
    let path: Vec<_> = path.collect();
    let layout = Layout::new(robot, &ColumnSet::plain());
    let values = model.truth.iter().zip(&fast.0);
    let parameters = layout.parameters.iter().zip(values);
    let parameters = parameters.map(|(parameter, (truth, value))| ParameterRow {
        name: parameter.name.clone(),
        unit: parameter.unit,
        truth: *truth,
        value: *value,
    });
    let steps = Steps {
        inverse_kinematics_poses: poses,
        inverse_kinematics_error_rad: ik_error,
        training_rows: known.training.len(),
        validation_rows: known.validation.len(),
        base_parameters: model.columns.len(),
        trained,
        parameters: parameters.collect(),
        joints: (0..JOINTS).map(|j| joint_torque(&path, j)).collect(),
    };
    let curves = Curves {
        losses: [plain.2, fast.2],
        black_box: network.losses.iter().copied().enumerate().collect(),
        data,
        path,
    };
    Ok((steps, curves))
}

/// Epoch, loss on training and on held-out rows.
type LossCurve = Vec<(usize, f64, f64)>;

/// The known arm, its training and validation rows, and the arbitrary path.
struct Known<'m> {
    model: &'m RigidBody,
    training: Vec<Sample>,
    validation: Vec<Sample>,
    /// RMS torque of every joint, N·m.
    scale: Joints<JOINTS>,
    rows: Rows,
    held: Rows,
    path: Vec<(f64, State<JOINTS>)>,
    path_truth: Vec<Joints<JOINTS>>,
}

impl<'m> Known<'m> {
    fn new(
        model: &'m RigidBody,
        data: &[Sample],
        path: Vec<(f64, State<JOINTS>)>,
        seed: u64,
    ) -> Self {
        let mut order: Vec<usize> = (0..data.len()).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        let (training, validation) = order.split_at(order.len() * 4 / 5);
        let pick = |rows: &[usize]| -> Vec<_> { rows.iter().map(|&k| data[k]).collect() };
        let (training, validation) = (pick(training), pick(validation));
        let scale =
            Joints::from_fn(|j, _| root_mean(training.iter().map(|(_, _, tau)| tau[j] * tau[j])));
        let torque = |(_, state): &(f64, State<JOINTS>)| model.dynamics.inverse_dynamics(state);
        Self {
            rows: model.rows(&training, &scale),
            held: model.rows(&validation, &scale),
            path_truth: path.iter().map(torque).collect(),
            model,
            training,
            validation,
            scale,
            path,
        }
    }

    fn least_squares(&self) -> Result<DVector<f64>, StudyError> {
        let qr = self.rows.y.clone().qr();
        let moment = qr.q().tr_mul(&self.rows.tau);
        qr.r().solve_upper_triangular(&moment).ok_or_else(|| {
            StudyError::from("the excitation does not show all base parameters".to_owned())
        })
    }

    /// The network with physical weights: weights, epochs, losses while it trains.
    fn physical(&self, descent: Descent, seed: u64) -> (DVector<f64>, usize, LossCurve) {
        let (rows, held) = (&self.rows, &self.held);
        let gram = rows.y.tr_mul(&rows.y);
        let moment = rows.y.tr_mul(&rows.tau);
        let power = rows.tau.norm_squared();
        let layer = LinearLayer::new(&gram, &moment, power, rows.tau.len() as f64);
        let config = PhysicalConfig {
            starts: 1,
            ..PhysicalConfig::new(descent, seed)
        };
        let trained = layer.train(&config, &mut |_, _| ());
        let epochs = trained.losses.len().saturating_sub(1);
        let shown = EPOCHS.iter().copied().filter(|epoch| *epoch < epochs);
        let curve = shown.chain([epochs]).map(|max_epochs| {
            let config = PhysicalConfig {
                max_epochs,
                ..config
            };
            let theta = layer.train(&config, &mut |_, _| ()).theta;
            (max_epochs, rows.loss(&theta), held.loss(&theta))
        });
        (trained.theta, epochs, curve.collect())
    }

    fn linear(&self, name: &'static str, epochs: usize, theta: &DVector<f64>) -> Trained {
        let truth = &self.model.truth;
        Trained {
            name,
            epochs,
            training_loss_ratio: self.rows.loss(theta),
            validation_loss_ratio: self.held.loss(theta),
            base_parameter_error_ratio: Some((theta - truth).norm() / truth.norm()),
            path_nrmse_ratio: self.error_on_path(|state| self.model.torque(state, theta)),
        }
    }

    fn black_box(&self, name: &'static str, network: &BlackBox) -> Trained {
        let torque = |state: &State<JOINTS>| Joints::from(network.torque(&(*state).into()));
        let loss = |data: &[Sample]| {
            let square = |(_, state, tau): &Sample| {
                let error = torque(state) - tau;
                error.component_div(&self.scale).norm_squared()
            };
            (data.iter().map(square).sum::<f64>() / (data.len() * JOINTS) as f64).sqrt()
        };
        Trained {
            name,
            epochs: network.losses.len(),
            training_loss_ratio: loss(&self.training),
            validation_loss_ratio: loss(&self.validation),
            base_parameter_error_ratio: None,
            path_nrmse_ratio: self.error_on_path(torque),
        }
    }

    fn error_on_path(&self, predict: impl Fn(&State<JOINTS>) -> Joints<JOINTS>) -> f64 {
        let mut error = TorqueError::<JOINTS>::default();
        for ((_, state), truth) in self.path.iter().zip(&self.path_truth) {
            error.add(truth, &predict(state), &state.qd);
        }
        error.nrmse()
    }
}

/// Step (1) and (2): the joint sequence that puts the flange where the excitation puts it, found by inverse kinematics, and
/// its torques. Also the number of poses, and how far the positions are from the series', rad.
fn joint_sequence(
    robot: &Robot,
    excitation: &Excitation,
    model: &RigidBody,
) -> Result<(Vec<Sample>, usize, f64), StudyError> {
    let inverse = Inverse::<JOINTS>::new(robot, &Placement::identity());
    let inverse = inverse.ok_or_else(|| unsupported(JOINTS))?;
    let ticks = (excitation.period_s / TICK_S).round() as usize;
    let every = (ticks / ROWS).max(1);
    let mut data = Vec::with_capacity(ROWS);
    let (mut predicted, mut worst) = (excitation.at::<JOINTS>(0.0).q, 0.0_f64);
    for tick in 0..ticks {
        let t_s = tick as f64 * TICK_S;
        let series = excitation.at::<JOINTS>(t_s);
        let pose = inverse.chain.forward(&series.q);
        let q = inverse.onwards(&pose, &predicted, JUMP_RAD);
        let q =
            q.map_err(|error| StudyError::from(format!("excitation at {t_s:.3} s: {error}")))?;
        worst = worst.max((q - series.q).amax());
        predicted = q + (series.qd + series.qdd * (0.5 * TICK_S)) * TICK_S;
        if tick % every == 0 {
            let state = State { q, ..series };
            data.push((t_s, state, model.dynamics.inverse_dynamics(&state)));
        }
    }
    Ok((data, ticks, worst))
}

fn arbitrary_path(robot: &Robot, seed: u64) -> Vec<(f64, State<JOINTS>)> {
    let path = Trajectory::<JOINTS>::validation(robot, seed);
    let times = (0..=path.ticks(PATH_STEP_S)).map(|tick| tick as f64 * PATH_STEP_S);
    times.map(|t_s| (t_s, path.at(t_s))).collect()
}

fn joint_torque(path: &[(f64, State<JOINTS>, [Joints<JOINTS>; 3])], j: usize) -> JointTorque {
    let rms = |value: &dyn Fn(&[Joints<JOINTS>; 3]) -> f64| {
        root_mean(path.iter().map(|(_, _, tau)| value(tau).powi(2)))
    };
    let peak = |of: usize| {
        let errors = path.iter().map(|(_, _, tau)| tau[of][j] - tau[0][j]);
        errors.map(f64::abs).fold(0.0, f64::max)
    };
    JointTorque {
        torque_rms_nm: rms(&|tau| tau[0][j]),
        bp_physical_rmse_nm: rms(&|tau| tau[1][j] - tau[0][j]),
        bp_physical_peak_nm: peak(1),
        bp_black_box_rmse_nm: rms(&|tau| tau[2][j] - tau[0][j]),
        bp_black_box_peak_nm: peak(2),
    }
}

/// Time, s, motion and torque, N·m.
pub(super) type Sample = (f64, State<JOINTS>, Joints<JOINTS>);

/// The linear rows of some states: every joint's rows over its RMS torque.
struct Rows {
    y: DMatrix<f64>,
    tau: DVector<f64>,
}

impl Rows {
    fn loss(&self, theta: &DVector<f64>) -> f64 {
        ((&self.y * theta - &self.tau).norm_squared() / self.tau.len() as f64).sqrt()
    }
}

/// The rigid body of the links alone, and the columns of its base parameters.
struct RigidBody {
    dynamics: ReferenceModel<JOINTS>,
    columns: Vec<usize>,
    truth: DVector<f64>,
}

impl RigidBody {
    fn new(robot: &Robot) -> Option<Self> {
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
    fn regressor(&self, state: &State<JOINTS>) -> DMatrix<f64> {
        self.dynamics.regressor(state).select_columns(&self.columns)
    }

    fn rows(&self, data: &[Sample], scale: &Joints<JOINTS>) -> Rows {
        let mut y = DMatrix::zeros(data.len() * JOINTS, self.columns.len());
        let mut tau = DVector::zeros(data.len() * JOINTS);
        for (k, (_, state, torque)) in data.iter().enumerate() {
            let block = self.regressor(state);
            for j in 0..JOINTS {
                let row = block.row(j) / scale[j];
                y.row_mut(k * JOINTS + j).copy_from(&row);
                tau[k * JOINTS + j] = torque[j] / scale[j];
            }
        }
        Rows { y, tau }
    }

    fn torque(&self, state: &State<JOINTS>, theta: &DVector<f64>) -> Joints<JOINTS> {
        Joints::from_column_slice((self.regressor(state) * theta).as_slice())
    }
}
