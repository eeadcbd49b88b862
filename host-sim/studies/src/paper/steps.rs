//! The paper's steps (1) to (4): known parameters, no friction, no rotors, no noise, 36 base parameters.

use super::curves::Curves;
use super::rigid::{RigidBody, Sample};
use super::{JOINTS, ROWS};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::identification::{ColumnSet, Layout};
use foretorque_workbench::kinematics::Inverse;
use foretorque_workbench::metrics::TorqueError;
use foretorque_workbench::robot::{Placement, Robot};
use foretorque_workbench::training::{BlackBox, Descent, LinearLayer, PhysicalConfig};
use foretorque_workbench::trajectory::Trajectory;
use nalgebra::DVector;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::error::Error;

/// Step of the joint sequence, s.
const TICK_S: f64 = 1e-3;
/// Step of the arbitrary path, s.
const PATH_STEP_S: f64 = 0.01;
/// Largest step of a joint from its prediction, rad.
const JUMP_RAD: f64 = 0.05;
/// Epochs at which the loss curves are told.
const EPOCHS: [usize; 14] = [
    1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000,
];

/// What the four steps found.
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
    pub trained: Vec<Trained>,
    /// Parameters of the accelerated network against the truth.
    pub parameters: Vec<ParameterRow>,
    /// (4) Joint by joint on the arbitrary path.
    pub joints: Vec<JointTorque>,
}

/// One way to find the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trained {
    /// What it is.
    pub name: &'static str,
    /// Epochs.
    pub epochs: usize,
    /// RMSE (eq. 20) on the training rows, every joint over its RMS torque, a ratio.
    pub training_loss_ratio: f64,
    /// The same on the held-out rows.
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
) -> Result<(Steps, Curves), Box<dyn Error>> {
    let model = RigidBody::new(robot).ok_or("the UR5 has six joints")?;
    let (data, poses, ik_error) = joint_sequence(robot, excitation, &model)?;
    let mut order: Vec<usize> = (0..data.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    let (training, validation) = order.split_at(order.len() * 4 / 5);
    let pick = |rows: &[usize]| -> Vec<_> { rows.iter().map(|&k| data[k]).collect() };
    let (training, validation) = (pick(training), pick(validation));
    let scale = Joints::from_fn(|j, _| {
        let power: f64 = training.iter().map(|(_, _, tau)| tau[j] * tau[j]).sum();
        (power / training.len() as f64).sqrt()
    });
    let (rows, held) = (
        model.rows(&training, &scale),
        model.rows(&validation, &scale),
    );

    let gram = rows.y.tr_mul(&rows.y);
    let moment = rows.y.tr_mul(&rows.tau);
    let power = rows.tau.norm_squared();
    let layer = LinearLayer::new(&gram, &moment, power, rows.tau.len() as f64);
    let train = |descent, max_epochs: Option<usize>| {
        let mut config = PhysicalConfig {
            starts: 1,
            ..PhysicalConfig::new(descent, seed)
        };
        config.max_epochs = max_epochs.unwrap_or(config.max_epochs);
        layer.train(&config, &mut |_, _| ())
    };
    let path = arbitrary_path(robot, seed);
    let truth: Vec<Joints<JOINTS>> = path
        .iter()
        .map(|(_, state)| model.dynamics.inverse_dynamics(state))
        .collect();
    let on_path = |predict: &dyn Fn(&State<JOINTS>) -> Joints<JOINTS>| {
        let mut error = TorqueError::<JOINTS>::default();
        for ((_, state), truth) in path.iter().zip(&truth) {
            error.add(truth, &predict(state), &state.qd);
        }
        error.nrmse()
    };
    let linear = |name, epochs, theta: &DVector<f64>| Trained {
        name,
        epochs,
        training_loss_ratio: rows.loss(theta),
        validation_loss_ratio: held.loss(theta),
        base_parameter_error_ratio: Some(model.error_ratio(theta)),
        path_nrmse_ratio: on_path(&|state| model.torque(state, theta)),
    };
    let qr = rows.y.clone().qr();
    let solution = qr
        .r()
        .solve_upper_triangular(&qr.q().tr_mul(&rows.tau))
        .ok_or("the excitation does not show all base parameters")?;
    let curve = |descent, epochs: usize| -> Vec<(usize, f64, f64)> {
        let told = EPOCHS.iter().copied().filter(|epoch| *epoch < epochs);
        told.chain([epochs])
            .map(|epoch| {
                let theta = train(descent, Some(epoch)).theta;
                (epoch, rows.loss(&theta), held.loss(&theta))
            })
            .collect()
    };
    let [plain, fast] = [Descent::Plain, Descent::Accelerated].map(|descent| {
        let trained = train(descent, None);
        let epochs = trained.losses.len().saturating_sub(1);
        (trained.theta, epochs, curve(descent, epochs))
    });

    let samples: Vec<_> = training
        .iter()
        .map(|(_, state, tau)| (*state, (*tau).into(), [true; JOINTS]))
        .collect();
    let network = BlackBox::<JOINTS>::train(&samples, seed, &mut |_, _| ());
    let box_torque = |state: &State<JOINTS>| Joints::from(network.torque(state));
    let box_loss = |data: &[Sample]| {
        let square = |(_, state, tau): &Sample| {
            (box_torque(state) - tau)
                .component_div(&scale)
                .norm_squared()
        };
        (data.iter().map(square).sum::<f64>() / (data.len() * JOINTS) as f64).sqrt()
    };
    let trained = vec![
        linear("least squares", 1, &solution),
        linear("bp_physical, gradient descent (eq. 21)", plain.1, &plain.0),
        linear("bp_physical, accelerated", fast.1, &fast.0),
        Trained {
            name: "bp_black_box, 18-32-6 ReLU",
            epochs: network.losses.len(),
            training_loss_ratio: box_loss(&training),
            validation_loss_ratio: box_loss(&validation),
            base_parameter_error_ratio: None,
            path_nrmse_ratio: on_path(&box_torque),
        },
    ];
    let path: Vec<_> = path
        .iter()
        .zip(&truth)
        .map(|((t_s, state), truth)| {
            let torques = [*truth, model.torque(state, &fast.0), box_torque(state)];
            (*t_s, *state, torques)
        })
        .collect();
    let layout = Layout::<JOINTS>::new(robot, &ColumnSet::plain()).ok_or("six joints")?;
    let parameters = layout
        .parameters
        .iter()
        .zip(model.truth.iter().zip(&fast.0));
    let steps = Steps {
        inverse_kinematics_poses: poses,
        inverse_kinematics_error_rad: ik_error,
        training_rows: training.len(),
        validation_rows: validation.len(),
        base_parameters: model.columns.len(),
        trained,
        parameters: parameters
            .map(|(parameter, (truth, value))| ParameterRow {
                name: parameter.name.clone(),
                unit: parameter.unit,
                truth: *truth,
                value: *value,
            })
            .collect(),
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

/// Step (1) and (2): the joint sequence that puts the flange where the excitation puts it, found by inverse kinematics, and
/// its torques. Also the number of poses, and how far the positions are from the series', rad.
fn joint_sequence(
    robot: &Robot,
    excitation: &Excitation,
    model: &RigidBody,
) -> Result<(Vec<Sample>, usize, f64), Box<dyn Error>> {
    let inverse = Inverse::<JOINTS>::new(robot, &Placement::identity()).ok_or("six joints")?;
    let ticks = (excitation.period_s / TICK_S).round() as usize;
    let every = (ticks / ROWS).max(1);
    let mut data = Vec::with_capacity(ROWS);
    let (mut predicted, mut worst) = (excitation.at::<JOINTS>(0.0).q, 0.0_f64);
    for tick in 0..ticks {
        let t_s = tick as f64 * TICK_S;
        let series = excitation.at::<JOINTS>(t_s);
        let pose = inverse.chain().forward(&series.q);
        let q = inverse
            .onwards(&pose, &predicted, JUMP_RAD)
            .map_err(|error| format!("excitation at {t_s:.3} s: {error}"))?;
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
        let square: f64 = path.iter().map(|(_, _, tau)| value(tau).powi(2)).sum();
        (square / path.len().max(1) as f64).sqrt()
    };
    let peak = |of: usize| {
        let errors = path
            .iter()
            .map(|(_, _, tau)| (tau[of][j] - tau[0][j]).abs());
        errors.fold(0.0, f64::max)
    };
    JointTorque {
        torque_rms_nm: rms(&|tau| tau[0][j]),
        bp_physical_rmse_nm: rms(&|tau| tau[1][j] - tau[0][j]),
        bp_physical_peak_nm: peak(1),
        bp_black_box_rmse_nm: rms(&|tau| tau[2][j] - tau[0][j]),
        bp_black_box_peak_nm: peak(2),
    }
}
