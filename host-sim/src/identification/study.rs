//! All methods side by side on the same logs.

use super::columns::{ColumnSet, FrictionColumn, Layout};
use super::methods::{Fit, MethodName, irls, ols, wls};
use super::normal::{IdentificationError, NormalEquations};
use super::prepare::PrepareConfig;
use super::record::{MethodRecord, ParameterRecord, Report, SplitRecord};
use super::stream::{Gathered, SampleRow, for_each_prepared};
use super::validation::{Candidate, FileScores};
use crate::robot::Robot;
use crate::training::{
    BlackBox, Descent, LinearLayer, PhysicalConfig, ResidualConfig, Trained, train_residual,
};
use foretorque::feedforward::JointNetwork;
use nalgebra::DVector;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What is to be done.
#[derive(Clone, Debug)]
pub struct IdentifyConfig {
    /// Methods.
    pub methods: Vec<MethodName>,
    /// Friction columns.
    pub columns: ColumnSet,
    /// Filters and standstill.
    pub prepare: PrepareConfig,
    /// Seed of random starts and of the split.
    pub seed: u64,
    /// The robot whose parameters are the truth, if somebody knows it.
    pub truth: Option<Robot>,
}

/// Told what goes on: stage, and the loss while a network trains.
pub type Progress<'a> = &'a dyn Fn(&str);

/// What came out.
#[derive(Clone, Debug)]
pub struct Outcome<const N: usize> {
    /// All figures.
    pub report: Report,
    /// Layout of the plain columns, which the board has.
    pub plain: Layout<N>,
    /// The robust fit over the plain columns.
    pub plain_fit: Fit<N>,
    /// Residual networks, if they were trained.
    pub networks: Option<Box<[JointNetwork; N]>>,
    /// Time, measured and predicted torque on the first validation log: of the recommended method.
    pub trace: Vec<(f64, [f64; N], [f64; N])>,
}

/// One method after its training.
struct Solved<const N: usize> {
    name: MethodName,
    candidate: Candidate<N>,
    fit: Option<Fit<N>>,
    rows: usize,
    epochs: usize,
    seconds: f64,
    losses: Vec<(usize, f64)>,
    epochs_to_wls: Option<[Option<usize>; 2]>,
}

/// What a method is trained on.
struct Material<'a, const N: usize> {
    sums: &'a NormalEquations<N>,
    clean_sums: &'a NormalEquations<N>,
    sample: Vec<&'a SampleRow<N>>,
    rows: usize,
}

/// Share of the rows the paper trains on.
const TRAINING_SHARE: f64 = 0.8;
/// Points of a loss curve in the report.
const CURVE: usize = 200;

/// Identifies, validates, reports. `None` as layout means the robot has not `N` joints.
///
/// Errors: of the logs ([`crate::table::TableError`]), or [`IdentificationError`].
pub fn identify<const N: usize>(
    robot: &Robot,
    logs: &[PathBuf],
    validate: &[PathBuf],
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Outcome<N>, Box<dyn Error>> {
    let other_size = || format!("robot '{}' has not {N} joints", robot.name);
    let layout = Layout::<N>::new(robot, &config.columns).ok_or_else(other_size)?;
    let plain = Layout::<N>::new(robot, &ColumnSet::plain()).ok_or_else(other_size)?;
    let mut notes = Vec::new();
    let mut gathered = Gathered::new(&layout);
    for path in logs {
        progress(&format!("reading {}", path.display()));
        for_each_prepared(
            path,
            robot,
            &layout,
            &config.prepare,
            &mut notes,
            &mut |preparation, prepared| {
                gathered.add(&layout, &config.prepare, preparation, &prepared);
            },
        )?;
    }
    if gathered.sums.count() == 0.0 {
        let names: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
        return Err(Box::new(IdentificationError::NoMotion {
            logs: names.join(", "),
        }));
    }
    gathered.sums.check_rank(&layout)?;
    if gathered.thinning > 1 {
        notes.push(format!(
            "irls, bp_black_box and bp_residual used every {}th of the rows in the sums; the other methods all of them",
            gathered.thinning
        ));
    }
    let all = Material {
        sums: &gathered.sums,
        clean_sums: &gathered.clean_sums,
        sample: gathered.sample.iter().collect(),
        rows: gathered.rows,
    };
    let plain_fit =
        wls(&gathered.clean_sums.subset(&layout, &plain), &plain).ok_or_else(unsolvable)?;
    let solved = solve_all(robot, &layout, &plain, &all, config, progress)?;
    progress("80/20 split");
    let splits = split(robot, &layout, &plain, &gathered, config)?;
    let recommended = recommended(&solved);
    // The recommended method comes first, so that it is the one in the plot.
    let mut candidates: Vec<&Candidate<N>> = vec![&solved[recommended].candidate];
    candidates.extend(solved.iter().map(|solved| &solved.candidate));
    let bound = wls(&gathered.sums, &layout).ok_or_else(unsolvable)?;
    let truth = config.truth.as_ref().map(|truth| truths(truth, &layout));
    let mut methods: BTreeMap<String, MethodRecord> = BTreeMap::new();
    for (solved, split) in solved.iter().zip(splits) {
        methods.insert(
            solved.name.to_string(),
            solved.record(&layout, truth.as_deref(), split),
        );
    }
    if let Some(trained) = methods.get_mut("bp_physical") {
        trained.base_parameter_error_ratio_by_epoch =
            error_curve(&all, &layout, &bound, truth.as_deref(), config);
    }
    let mut trace = Vec::new();
    for path in validate {
        progress(&format!("validating {}", path.display()));
        let mut scores = FileScores::new(&layout, candidates.len());
        for_each_prepared(
            path,
            robot,
            &layout,
            &config.prepare,
            &mut notes,
            &mut |preparation, prepared| {
                scores.add(
                    &layout,
                    &config.prepare,
                    preparation,
                    &prepared,
                    &candidates,
                );
            },
        )?;
        let key = key_of(path, validate);
        let limit = scores.propagated(&layout, &bound.covariance);
        for (place, solved) in solved.iter().enumerate() {
            let mut record = scores.record(place + 1);
            record.cramer_rao_nrmse_moving_ratio = Some(limit);
            if let (Some(truth), Candidate::Linear(theta)) = (&truth, &solved.candidate)
                && truth.iter().all(Option::is_some)
            {
                let truth = DVector::from_iterator(
                    truth.len(),
                    truth.iter().map(|value| value.unwrap_or(0.0)),
                );
                record.truth_nrmse_moving_ratio =
                    Some(scores.propagated_error(&layout, &(theta - truth)));
            }
            if let Some(method) = methods.get_mut(&solved.name.to_string()) {
                method.validation.insert(key.clone(), record);
            }
        }
        if trace.is_empty() {
            trace = scores.trace;
        }
    }
    let (condition_number, condition_number_equilibrated) =
        gathered.sums.condition_numbers(&layout);
    let networks = solved.iter().find_map(|solved| match &solved.candidate {
        Candidate::Residual { networks, .. } => Some(networks.clone()),
        _ => None,
    });
    let report = Report {
        robot: robot.name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        columns: config.columns.to_string(),
        logs: logs.iter().map(|path| key_of(path, logs)).collect(),
        notes,
        motion_cutoff_hz: config.prepare.motion_hz,
        torque_cutoff_hz: config.prepare.torque_hz,
        still_rad_s: config.prepare.still_rad_s,
        rows_read: gathered.rows_read,
        rows_used: gathered.rows,
        still_share_ratio: gathered
            .still
            .iter()
            .map(|&still| still as f64 / gathered.rows_read.max(1) as f64)
            .collect(),
        spikes: gathered.spikes,
        rank: layout.parameters.len(),
        condition_number,
        condition_number_of: "raw SI regressor of the base parameters, moving rows, Craig link frames, first independent columns from left to right".to_owned(),
        condition_number_equilibrated,
        recommended: solved[recommended].name.to_string(),
        methods,
    };
    Ok(Outcome {
        report,
        plain,
        plain_fit,
        networks,
        trace,
    })
}

fn unsolvable() -> String {
    "the normal equations cannot be solved".to_owned()
}

/// The robust fit where it was asked for, else the first method that has parameters, else the first.
fn recommended<const N: usize>(solved: &[Solved<N>]) -> usize {
    let place = |wanted: &dyn Fn(&Solved<N>) -> bool| solved.iter().position(wanted);
    place(&|solved| solved.name == MethodName::BpResidual)
        .or_else(|| place(&|solved| solved.name == MethodName::Irls))
        .or_else(|| place(&|solved| solved.fit.is_some()))
        .unwrap_or(0)
}

/// The file's name, or its path where two files share a name.
fn key_of(path: &Path, all: &[PathBuf]) -> String {
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    let twins = all
        .iter()
        .filter(|other| other.file_name() == path.file_name())
        .count();
    name.filter(|_| twins <= 1)
        .unwrap_or_else(|| path.display().to_string())
}

/// True parameters as far as the layout's columns have one. A column is the truth's own only where nothing of the truth
/// hides in another column.
fn truths<const N: usize>(robot: &Robot, layout: &Layout<N>) -> Vec<Option<f64>> {
    let base = robot.base_parameters();
    let mut out: Vec<Option<f64>> = base.into_iter().map(Some).collect();
    for parameter in layout.parameters.iter().skip(layout.base) {
        out.push(parameter.friction.and_then(|(column, joint)| {
            let friction = &robot.joints[joint].friction;
            let simple = friction.stribeck_ratio == 0.0;
            match column {
                FrictionColumn::Viscous if simple => Some(friction.viscous),
                FrictionColumn::Coulomb if simple => Some(friction.coulomb),
                FrictionColumn::CoggingSine => Some(friction.cogging),
                FrictionColumn::Viscous | FrictionColumn::Coulomb => None,
                FrictionColumn::StribeckNarrow | FrictionColumn::StribeckWide if !simple => None,
                _ => Some(0.0),
            }
        }));
    }
    out
}

fn solve_all<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    plain: &Layout<N>,
    material: &Material<'_, N>,
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Vec<Solved<N>>, Box<dyn Error>> {
    let mut out = Vec::new();
    for &name in &config.methods {
        progress(&name.to_string());
        let start = Instant::now();
        let mut solved = match name {
            MethodName::Ols => linear(name, ols(material.sums, layout), material.rows)?,
            MethodName::Wls => linear(name, wls(material.sums, layout), material.rows)?,
            MethodName::Irls => linear(
                name,
                irls(material.clean_sums, &material.sample, layout),
                material.sample.len(),
            )?,
            MethodName::BpPhysical => physical(layout, material, config, progress)?,
            MethodName::BpBlackBox => black_box(material, config, progress),
            MethodName::BpResidual => residual(robot, layout, plain, material, config)?,
        };
        solved.seconds = start.elapsed().as_secs_f64();
        out.push(solved);
    }
    Ok(out)
}

fn linear<const N: usize>(
    name: MethodName,
    fit: Option<Fit<N>>,
    rows: usize,
) -> Result<Solved<N>, Box<dyn Error>> {
    let fit = fit.ok_or_else(unsolvable)?;
    Ok(Solved {
        name,
        candidate: Candidate::Linear(fit.theta.clone()),
        rows,
        epochs: fit.iterations,
        seconds: 0.0,
        losses: Vec::new(),
        epochs_to_wls: None,
        fit: Some(fit),
    })
}

fn layer_of<const N: usize>(
    material: &Material<'_, N>,
    layout: &Layout<N>,
    fit: &Fit<N>,
) -> LinearLayer {
    let (gram, moment) = material.sums.weighted(layout, &fit.sigma);
    let joints = material.sums.joints.iter().zip(&fit.sigma);
    let power = joints
        .map(|(joint, sigma)| joint.power / (sigma * sigma))
        .sum();
    LinearLayer::new(&gram, &moment, power, material.sums.count())
}

/// Every joint's rows are divided by the noise an ordinary fit leaves, so that the layer's loss is the weighted one.
fn physical<const N: usize>(
    layout: &Layout<N>,
    material: &Material<'_, N>,
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Solved<N>, Box<dyn Error>> {
    let reference = wls(material.sums, layout).ok_or_else(unsolvable)?;
    let layer = layer_of(material, layout, &reference);
    let goal = layer.loss_of(&reference.theta);
    let mut watch =
        |epoch: usize, loss: f64| progress(&format!("bp_physical  epoch {epoch}  loss {loss:.5}"));
    let train = |descent, watch: &mut dyn FnMut(usize, f64)| -> Trained {
        layer.train(&PhysicalConfig::new(descent, config.seed), watch)
    };
    let fast = train(Descent::Accelerated, &mut watch);
    let slow = train(Descent::Plain, &mut watch);
    Ok(Solved {
        name: MethodName::BpPhysical,
        candidate: Candidate::Linear(fast.theta.clone()),
        rows: material.rows,
        epochs: fast.losses.len().saturating_sub(1),
        seconds: 0.0,
        losses: thinned(&fast.losses),
        epochs_to_wls: Some([fast.epochs_to(1.05, goal), slow.epochs_to(1.05, goal)]),
        // The layer ends where weighted least squares does, so its uncertainty is the same.
        fit: Some(Fit {
            theta: fast.theta,
            ..reference
        }),
    })
}

/// Error of the base parameters as the accelerated layer trains; empty without a truth.
fn error_curve<const N: usize>(
    material: &Material<'_, N>,
    layout: &Layout<N>,
    reference: &Fit<N>,
    truth: Option<&[Option<f64>]>,
    config: &IdentifyConfig,
) -> Vec<(usize, f64)> {
    let Some(truth) = truth else {
        return Vec::new();
    };
    let layer = layer_of(material, layout, reference);
    let mut curve = Vec::new();
    for max_epochs in [1, 2, 5, 10, 20, 30, 50, 75, 100, 150, 200, 300, 500, 1000] {
        let config = PhysicalConfig {
            max_epochs,
            starts: 1,
            ..PhysicalConfig::new(Descent::Accelerated, config.seed)
        };
        let trained = layer.train(&config, &mut |_, _| ());
        if let Some(error) = base_error(&trained.theta, truth, layout.base) {
            curve.push((max_epochs, error));
        }
    }
    curve
}

fn black_box<const N: usize>(
    material: &Material<'_, N>,
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Solved<N> {
    let rows: Vec<_> = material
        .sample
        .iter()
        .map(|row| (row.state, row.tau, row.moving))
        .collect();
    let network = BlackBox::train(&rows, config.seed, &mut |epoch, loss| {
        progress(&format!("bp_black_box  epoch {epoch}  loss {loss:.5}"));
    });
    Solved {
        name: MethodName::BpBlackBox,
        rows: rows.len(),
        epochs: network.losses.len(),
        seconds: 0.0,
        losses: thinned(&network.losses),
        candidate: Candidate::BlackBox(Box::new(network)),
        fit: None,
        epochs_to_wls: None,
    }
}

fn residual<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    plain: &Layout<N>,
    material: &Material<'_, N>,
    config: &IdentifyConfig,
) -> Result<Solved<N>, Box<dyn Error>> {
    let fit = wls(&material.clean_sums.subset(layout, plain), plain).ok_or_else(unsolvable)?;
    let places = layout.places_of(plain);
    let widened = |values: &DVector<f64>| {
        let mut out = DVector::zeros(layout.parameters.len());
        for (value, &place) in values.iter().zip(&places) {
            out[place] = *value;
        }
        out
    };
    let theta = widened(&fit.theta);
    let limits: [f64; N] = std::array::from_fn(|joint| robot.joints[joint].limits.torque);
    let trained: Vec<(JointNetwork, Vec<f64>)> = std::thread::scope(|scope| {
        let theta = &theta;
        let joints: Vec<_> = (0..N)
            .map(|joint| {
                scope.spawn(move || {
                    let moving = material.sample.iter().filter(|row| row.moving[joint]);
                    let samples: Vec<(f64, f64)> = moving
                        .map(|row| {
                            let left = row.clean[joint] - row.linear(layout, theta, joint);
                            (row.state.qd[joint], left / limits[joint])
                        })
                        .collect();
                    let residual = ResidualConfig {
                        seed: config.seed,
                        ..ResidualConfig::default()
                    };
                    train_residual(&samples, robot.joints[joint].limits.velocity, &residual)
                })
            })
            .collect();
        // A joint that panicked has said so already.
        joints
            .into_iter()
            .filter_map(|joint| joint.join().ok())
            .collect()
    });
    let epochs = trained
        .iter()
        .map(|(_, losses)| losses.len())
        .max()
        .unwrap_or(0);
    let mean: Vec<f64> = (0..epochs)
        .map(|epoch| {
            let at = |losses: &[f64]| losses.get(epoch).or(losses.last()).copied().unwrap_or(0.0);
            trained.iter().map(|(_, losses)| at(losses)).sum::<f64>() / N as f64
        })
        .collect();
    let networks: Vec<JointNetwork> = trained.into_iter().map(|(network, _)| network).collect();
    let networks: [JointNetwork; N] = networks
        .try_into()
        .map_err(|_| "a network could not be trained")?;
    let mut covariance = nalgebra::DMatrix::zeros(layout.parameters.len(), layout.parameters.len());
    for (row, &r) in places.iter().enumerate() {
        for (column, &c) in places.iter().enumerate() {
            covariance[(r, c)] = fit.covariance[(row, column)];
        }
    }
    Ok(Solved {
        name: MethodName::BpResidual,
        candidate: Candidate::Residual {
            theta: theta.clone(),
            networks: Box::new(networks),
            limits,
        },
        fit: Some(Fit {
            theta,
            covariance,
            sigma: fit.sigma,
            iterations: fit.iterations,
        }),
        rows: material.sample.len(),
        epochs,
        seconds: 0.0,
        losses: thinned(&mean),
        epochs_to_wls: None,
    })
}

/// Trains on 80 % of the rows, drawn at random, and scores on the rest.
fn split<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    plain: &Layout<N>,
    gathered: &Gathered<N>,
    config: &IdentifyConfig,
) -> Result<Vec<SplitRecord>, Box<dyn Error>> {
    let mut random = ChaCha8Rng::seed_from_u64(config.seed);
    let (training, held_out): (Vec<&SampleRow<N>>, Vec<&SampleRow<N>>) = gathered
        .sample
        .iter()
        .partition(|_| random.random_range(0.0..1.0) < TRAINING_SHARE);
    let sums = |pick: fn(&SampleRow<N>) -> &[f64; N]| {
        let mut sums = NormalEquations::new(layout);
        for joint in 0..N {
            let (mut x, mut tau) = (Vec::new(), Vec::new());
            for row in training.iter().filter(|row| row.moving[joint]) {
                let start = layout.offset[joint];
                x.extend_from_slice(&row.panel[start..start + layout.active[joint].len()]);
                tau.push(pick(row)[joint]);
            }
            sums.joints[joint].add(&x, &tau);
        }
        sums
    };
    let (raw, clean) = (sums(|row| &row.tau), sums(|row| &row.clean));
    let material = Material {
        sums: &raw,
        clean_sums: &clean,
        rows: training.len(),
        sample: training,
    };
    let solved = solve_all(robot, layout, plain, &material, config, &|_| ())?;
    Ok(solved
        .iter()
        .map(|solved| {
            let (mut rmse, mut ratio) = (Vec::new(), Vec::new());
            for joint in 0..N {
                let (mut error, mut power, mut count) = (0.0, 0.0, 0.0);
                for row in held_out.iter().filter(|row| row.moving[joint]) {
                    let theta = solved.candidate.theta();
                    let linear = theta.map_or(0.0, |theta| row.linear(layout, theta, joint));
                    let network = solved
                        .candidate
                        .network(&row.state)
                        .map_or(0.0, |tau| tau[joint]);
                    error += (linear + network - row.tau[joint]).powi(2);
                    power += row.tau[joint].powi(2);
                    count += 1.0;
                }
                rmse.push((count > 0.0).then(|| f64::sqrt(error / count)));
                ratio.push((power > 0.0).then(|| f64::sqrt(error / power)));
            }
            SplitRecord {
                rmse_moving_nm: rmse,
                nrmse_moving_ratio: ratio,
            }
        })
        .collect())
}

impl<const N: usize> Solved<N> {
    fn record(
        &self,
        layout: &Layout<N>,
        truth: Option<&[Option<f64>]>,
        split_80_20: SplitRecord,
    ) -> MethodRecord {
        let parameters = self.fit.as_ref().map_or_else(Vec::new, |fit| {
            let deviations = fit.deviations();
            let named = layout.parameters.iter().enumerate();
            // Columns the method does not have carry neither value nor deviation.
            let own = named.filter(|(place, _)| fit.covariance[(*place, *place)] > 0.0);
            own.map(|(place, parameter)| ParameterRecord {
                name: parameter.name.clone(),
                value: fit.theta[place],
                unit: parameter.unit.to_owned(),
                std: deviations[place],
                truth: truth.and_then(|truth| truth[place]),
            })
            .collect()
        });
        let base_parameter_error_ratio = match (&self.fit, truth) {
            (Some(fit), Some(truth)) => base_error(&fit.theta, truth, layout.base),
            _ => None,
        };
        MethodRecord {
            validation: BTreeMap::new(),
            split_80_20,
            parameters,
            base_parameter_error_ratio,
            noise_nm: self
                .fit
                .as_ref()
                .map_or_else(Vec::new, |fit| fit.sigma.to_vec()),
            rows: self.rows,
            epochs: self.epochs,
            seconds: self.seconds,
            loss_ratio: self.losses.clone(),
            epochs_to_1_05_wls: self.epochs_to_wls,
            base_parameter_error_ratio_by_epoch: Vec::new(),
        }
    }
}

fn base_error(theta: &DVector<f64>, truth: &[Option<f64>], base: usize) -> Option<f64> {
    let truth: Vec<f64> = truth.iter().take(base).copied().collect::<Option<_>>()?;
    let error: f64 = truth
        .iter()
        .zip(theta.iter())
        .map(|(a, b)| (a - b).powi(2))
        .sum();
    let size: f64 = truth.iter().map(|value| value * value).sum();
    Some((error / size).sqrt())
}

/// Epoch and loss, at most [`CURVE`] points, first and last kept.
fn thinned(losses: &[f64]) -> Vec<(usize, f64)> {
    let stride = losses.len().div_ceil(CURVE).max(1);
    let last = losses.len().saturating_sub(1);
    let points = losses.iter().copied().enumerate();
    points
        .filter(|(epoch, _)| epoch % stride == 0 || *epoch == last)
        .collect()
}
