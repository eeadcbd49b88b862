//! One run of an arm in closed loop, what is kept of it, and batch identification on its rows.

use super::PERIOD_S;
use super::job::Bench;
use super::world::Source;
use crate::StudyError;
use foretorque::arm::Arm;
use foretorque::feedforward::{ParameterSet, evaluate};
use foretorque::joint::JointMeasurement;
use foretorque::learning::{
    ConditionedSample, LearnerConfig, LinearParameters, MeasurementWindow, torque_row,
};
use foretorque_link::bank::ParameterBank;
use foretorque_link::safety::SafetyState;
use foretorque_link::wire::{Field, TelemetryFrame};
use foretorque_workbench::board::{Client, Native};
use foretorque_workbench::closed_loop::{ClosedLoop, motion_f32};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::identification::JointSums;
use foretorque_workbench::metrics::{MOVING_RAD_S, TrackingError};
use foretorque_workbench::plant::Plant;
use foretorque_workbench::telemetry::numbers;
use foretorque_workbench::trajectory::Trajectory;
use nalgebra::{DMatrix, DVector};
use std::time::Duration;

/// Ticks between two comparisons of torques, and between two looks at the unseen path.
const EVERY: usize = 5;
const LOOK: usize = 500;
/// Rows this soon after a payload changes are in no window, s.
const GRACE_S: f64 = 2.5;
/// Time from a pick to the look at its mass, s.
const WEIGHED_S: f64 = 3.0;
/// Length of the windows, s.
const WINDOW_S: usize = 10;
/// Codes that are false on undisturbed motion: an alarm of change detection, a payload.
const DISTURBED: [u8; 2] = [1, 2];

/// Errors of one second, squares in units of the joints' scale: learnt and start.
type Second = [f64; 2];

pub(super) struct Trace<const N: usize> {
    pub(super) seconds: Vec<Second>,
    pub(super) tracking: TrackingError<N>,
    pub(super) alarms: u32,
    /// Payload mass the board reports, kg, by tick of the look.
    pub(super) weighed: Vec<f64>,
    pub(super) curve: Vec<(f64, f64)>,
    pub(super) rows: Rows<N>,
    pub(super) armed: bool,
}

fn window_ratios(seconds: &[Second]) -> Vec<f64> {
    let ratio = |window: &[Second]| {
        let sum = |k: usize| window.iter().map(|second| second[k]).sum::<f64>();
        match (sum(0), sum(1)) {
            (0.0, 0.0) => None,
            (learnt, start) if (learnt + start).is_finite() => Some((learnt / start).sqrt()),
            _ => Some(f64::INFINITY),
        }
    };
    seconds.windows(WINDOW_S).filter_map(ratio).collect()
}

impl<const N: usize> Trace<N> {
    /// Learnt error over that of the start on every window with motion; infinite where a torque was not finite.
    pub(super) fn windows(&self) -> Vec<f64> {
        window_ratios(&self.seconds)
    }
}

impl<const N: usize> Bench<N> {
    /// Mean tracking error in the second half of `path`, mrad, with the torques that a perfect model of the measured ones
    /// would predict as feed-forward.
    pub(super) fn truth_tracking(
        &self,
        mut plant: Plant<N>,
        source: Source,
        path: &Trajectory<N>,
        ticks: usize,
    ) -> Result<f64, StudyError> {
        let pd = &self.pd[usize::from(source.has_torque_loop())];
        let mut play = ClosedLoop::new(&mut plant, pd, path, PERIOD_S, None)?;
        let mut tracking = TrackingError::default();
        for tick in 0..ticks {
            let next = path.at((tick + 1) as f64 * PERIOD_S);
            let torque = plant.true_torque(&next).cast();
            let record = play.tick_with(&mut plant, |_| Ok::<_, StudyError>(Some(torque)))?;
            if 2 * tick > ticks {
                tracking.add(&(record.desired.q - record.q));
            }
        }
        Ok(tracking.mean_rms_mrad())
    }

    /// Plays `path`, with the board that starts from a bank and learns, or not; or without one.
    ///
    /// * `rows_s` rows for batch identification are kept up to this time, s; 0 keeps all
    pub(super) fn run<A: Arm<N, P>, const P: usize>(
        &self,
        (mut plant, source): (Plant<N>, Source),
        path: &Trajectory<N>,
        start: Option<(&ParameterBank, bool)>,
        ticks: usize,
        rows_s: f64,
    ) -> Result<Trace<N>, StudyError> {
        let mut board = None;
        let mut started = None;
        if let Some((bank, _)) = start {
            let native = Box::new(Native::<A, N, P>::new()?);
            let mut client = Client::connect::<A, P>(native, Duration::from_secs(1))?;
            client.upload_bank(bank)?;
            started = Some(bank.set::<A, N, P>()?);
            board = Some(client);
        }
        let pd = &self.pd[usize::from(source.has_torque_loop())];
        let mut play = ClosedLoop::new(&mut plant, pd, path, PERIOD_S, board.as_mut())?;
        let learns = start.is_some_and(|(_, learns)| learns);
        if let Some(board) = &mut board {
            board.learning(learns)?;
            board.stream(Field::Quality.bit() | Field::Decision.bit(), 2)?;
        }
        let mut trace = Trace {
            seconds: Vec::new(),
            tracking: TrackingError::default(),
            alarms: 0,
            weighed: Vec::new(),
            curve: Vec::new(),
            rows: Rows::new(&LearnerConfig::<N, P>::for_arm::<A>(PERIOD_S as f32)),
            armed: true,
        };
        let (mut acting, mut decided, mut mass) = (Joints::zeros(), 0.0, 0.0);
        let (mut carried, mut changed_s) = (false, f64::NEG_INFINITY);
        for tick in 0..ticks {
            let t_s = tick as f64 * PERIOD_S;
            if let (Some(board), Some(started), true) = (&mut board, &started, learns)
                && tick.is_multiple_of(LOOK)
            {
                let set = board.read_bank()?.set::<A, N, P>()?;
                let needed = self.needed(&plant);
                let before = self.unseen_error::<A, P>(started, &needed);
                let error = self.unseen_error::<A, P>(&set, &needed) / before;
                trace.curve.push((t_s, error));
            }
            let record = play.tick(&mut plant, board.as_mut())?;
            if plant.carried().is_some() != carried {
                (carried, changed_s) = (!carried, t_s);
            }
            if carried && (t_s - changed_s - WEIGHED_S).abs() < 0.5 * PERIOD_S {
                trace.weighed.push(mass);
            }
            if 2 * tick > ticks {
                trace.tracking.add(&(record.desired.q - record.q));
            }
            if rows_s == 0.0 || t_s < rows_s {
                let measured = record.reported.map(|reported| JointMeasurement {
                    q: reported.q.cast(),
                    tau: reported.tau.cast(),
                });
                trace.rows.push(measured.as_ref());
            }
            let compared = tick > 0 && tick % EVERY == 0 && t_s - changed_s > GRACE_S;
            if let (Some(started), true) = (&started, compared) {
                let needed = plant.true_torque(&record.desired);
                let motion = motion_f32(&record.desired);
                let frozen: Joints<N> = evaluate::<A, N, P>(started, &motion).total.cast();
                let (second, length) = (t_s as usize, trace.seconds.len());
                trace.seconds.resize(length.max(second + 1), [0.0; 2]);
                for j in (0..N).filter(|&j| record.desired.qd[j].abs() > MOVING_RAD_S) {
                    let square = |tau: f64| ((tau - needed[j]) / self.scale[j]).powi(2);
                    let sums = &mut trace.seconds[second];
                    sums[0] += square(acting[j]);
                    sums[1] += square(frozen[j]);
                }
            }
            acting = record.feed_forward.cast();
            if let Some(board) = &mut board {
                trace.armed = board.safety().state == SafetyState::Armed;
                for frame in board.take_telemetry() {
                    watch::<N>(&frame, &mut decided, &mut trace.alarms, &mut mass);
                }
            }
        }
        Ok(trace)
    }
}

/// Takes the payload mass, new alarms and new payloads out of a frame.
fn watch<const N: usize>(
    frame: &TelemetryFrame,
    decided: &mut f64,
    alarms: &mut u32,
    mass: &mut f64,
) {
    for (field, bytes) in frame.fields(N) {
        let values = numbers(field, bytes);
        match field {
            Field::Quality => *mass = values[2],
            Field::Decision => {
                let (count, code) = (values[0], values[1] as u8);
                *alarms += u32::from(count != *decided && DISTURBED.contains(&code));
                *decided = count;
            }
            _ => {}
        }
    }
}

/// Every how many-th tick gives rows.
const STRIDE: usize = 10;
/// Prior standard deviations of the batch, in those of the learner: hardly any prior.
const DOUBT: f64 = 10.0;
/// Rows of a block that is added at once, and rows of half a second.
const BLOCK: usize = 64;
const CORRELATED: usize = (0.5 / PERIOD_S) as usize / STRIDE;

/// Rows as the board filters them.
pub(super) struct Rows<const N: usize> {
    window: MeasurementWindow<N>,
    ticks: usize,
    rows: Vec<ConditionedSample<N>>,
}

impl<const N: usize> Rows<N> {
    /// No rows; the motion filter is that of `config`.
    pub(super) fn new<const P: usize>(config: &LearnerConfig<N, P>) -> Self {
        Self {
            window: MeasurementWindow::new(config.decimation, config.delay),
            ticks: 0,
            rows: Vec::new(),
        }
    }

    /// Takes the measurement of one tick, if one came.
    pub(super) fn push(&mut self, measured: Option<&JointMeasurement<N>>) {
        self.window.push(measured);
        self.ticks += 1;
        if self.ticks.is_multiple_of(STRIDE) {
            self.rows
                .extend(self.window.conditioned(1.0 / PERIOD_S as f32));
        }
    }

    /// The bank that fits the rows best, beginning at `start`, with the standard deviations that correlated residuals leave.
    pub(super) fn fit<A: Arm<N, P>, const P: usize>(
        &self,
        start: &ParameterSet<N, P>,
    ) -> ParameterBank {
        let config = LearnerConfig::<N, P>::for_arm::<A>(PERIOD_S as f32);
        let (origin, sigma) = (LinearParameters::of(start), config.sigma);
        let scale = DVector::from_vec(sigma.iter().map(|s| DOUBT * f64::from(*s)).collect());
        let rows = |joint: usize| {
            let moving = move |seen: &&ConditionedSample<N>| {
                seen.motion.qd[joint].abs() >= config.velocity_gate
            };
            self.rows.iter().filter(moving).map(move |seen| {
                let row = torque_row::<A, N, P>(joint, seen);
                (row, f64::from(seen.tau[joint] - row.dot(&origin)))
            })
        };
        let scaled = |row: &LinearParameters<N, P>| {
            DVector::from_iterator(scale.len(), row.iter().map(|x| f64::from(*x)))
                .component_mul(&scale)
        };
        // Columns in prior standard deviations.
        let sums: [JointSums; N] = std::array::from_fn(|joint| {
            let rows: Vec<_> = rows(joint).collect();
            let mut sums = JointSums::new(scale.len());
            for block in rows.chunks(BLOCK) {
                let columns: Vec<_> = block.iter().map(|(row, _)| scaled(row)).collect();
                let x = DMatrix::from_columns(&columns);
                let tau: Vec<f64> = block.iter().map(|(_, tau)| *tau).collect();
                sums.add(x.as_slice(), &tau);
            }
            sums
        });
        let (mut weights, mut found) = ([1.0; N], DVector::zeros(scale.len()));
        let solve = |weights: &[f64; N]| {
            let mut normal = DMatrix::<f64>::identity(scale.len(), scale.len());
            let mut right = DVector::zeros(scale.len());
            for (sums, weight) in sums.iter().zip(weights) {
                normal += &sums.gram * *weight;
                right.axpy(*weight, &sums.moment, 1.0);
            }
            let normal = normal.cholesky()?;
            Some((normal.solve(&right), normal))
        };
        for _ in 0..3 {
            weights = std::array::from_fn(|joint| 1.0 / sums[joint].mean_square(&found).max(1e-9));
            found = solve(&weights).map_or(found, |(found, _)| found);
        }
        // Half-second blocks of correlated residuals carry less information than as many independent ones.
        let inflated: [f64; N] = std::array::from_fn(|joint| {
            let residuals = rows(joint).map(|(row, tau)| tau - scaled(&row).dot(&found));
            let residuals: Vec<f64> = residuals.collect();
            weights[joint] / correlation(&residuals)
        });
        let variances = solve(&inflated).map(|(_, normal)| normal.inverse().diagonal());
        let mut fitted = origin;
        for (fitted, moved) in fitted.iter_mut().zip(found.component_mul(&scale).iter()) {
            *fitted += *moved as f32;
        }
        let mut set = *start;
        fitted.write(&mut set);
        let mut bank = ParameterBank::from_set::<A, N, P>(&set);
        if let Some(variances) = variances {
            let mut deviations = LinearParameters::<N, P>::filled(0.0);
            for (k, deviation) in deviations.iter_mut().enumerate() {
                *deviation = (variances[k].sqrt() * scale[k]) as f32;
            }
            let friction = deviations.friction.as_flattened();
            let rigid = bank.columns.len() - friction.len();
            let all = deviations.rigid[..rigid].iter().chain(friction);
            for (column, deviation) in bank.columns.iter_mut().zip(all) {
                column.deviation = *deviation;
            }
        }
        bank
    }
}

/// Variance of the sum of a block over that of independent values, at least 1.
fn correlation(residuals: &[f64]) -> f64 {
    let blocks = residuals.chunks_exact(CORRELATED);
    let sums: f64 = blocks.map(|block| block.iter().sum::<f64>().powi(2)).sum();
    let squares: f64 = residuals.iter().map(|e| e * e).sum();
    let count = (residuals.len() / CORRELATED * CORRELATED) as f64;
    let plain = squares * count / residuals.len().max(1) as f64;
    if plain > 0.0 {
        (sums / plain).max(1.0)
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_with_a_torque_that_is_not_finite_are_the_worst() {
        let mut seconds = [[1.0, 4.0]; 3 * WINDOW_S];
        assert!(window_ratios(&seconds).iter().all(|ratio| *ratio == 0.5));
        seconds[0][0] = f64::NAN;
        let ratios = window_ratios(&seconds);
        assert_eq!((ratios[0], ratios[1]), (f64::INFINITY, 0.5));
        assert!(window_ratios(&[[0.0; 2]; WINDOW_S]).is_empty(), "rest");
    }
}
