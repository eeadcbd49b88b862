//! Residual BP networks: one small network a joint learns the residual of the linear model from friction inputs only.
//!
//! They are the board's own networks: same shape, same inputs, output in units of the torque limit.

use super::TrainingNetwork;
use foretorque::feedforward::{JointNetwork, NETWORK_HIDDEN, NETWORK_INPUTS};
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};

/// Mean residual of a joint's torque at one speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedPoint {
    /// Speed, rad/s.
    pub qd: f64,
    /// Residual over the torque limit, a ratio.
    pub residual: f64,
    /// Rows behind it.
    pub weight: f64,
}

/// Random starts; the one with the lowest loss is kept.
const STARTS: u64 = 4;
/// Most steps of one start.
const MOST_STEPS: usize = 100;
/// Weight decay against the error in units of the residual: without it, units fit noise of sparse rows.
const DECAY: f64 = 1e-4;

/// One joint's network in the board's precision, trained on the mean residuals of two halves of a log, and its loss (RMSE,
/// ratio of the torque limit) after every step of the best start. `watch` receives step and loss of every start.
///
/// Levenberg–Marquardt steps on the back-propagated Jacobian [Hagan and Menhaj 1994]: 31 weights are few enough to solve
/// for. Speeds beyond the log, up to `fastest`, rad/s, get the residual at the fastest speed of the log: a rectifier would
/// continue the last slope.
///
/// The network is zero unless networks trained on either half improve the other.
pub fn train_residual(
    halves: &[Vec<SpeedPoint>; 2],
    fastest: f64,
    seed: u64,
    watch: &mut dyn FnMut(usize, f64),
) -> (JointNetwork, Vec<f64>) {
    let (mut gain, mut variance) = (0.0, 0.0);
    for (own, other) in [(0, 1), (1, 0)] {
        let (probe, _) = fit(&halves[own], fastest, seed, &mut |_, _| ());
        let noise = noise(&halves[other]);
        for point in &halves[other] {
            let share = f64::from(probe.forward(&network_inputs(point.qd as f32))[0]);
            gain += point.weight * (2.0 * point.residual - share) * share;
            // Variance of the term before: the residual of n rows has noise² / n.
            variance += 4.0 * noise * point.weight * share * share;
        }
    }
    if gain > CERTAIN * variance.sqrt() {
        return fit(&halves.concat(), fastest, seed, watch);
    }
    (JointNetwork::silent(seed as u32), Vec::new())
}

/// Deviations by which networks must improve rows they were not trained on.
const CERTAIN: f64 = 1.0;

/// Variance of a single row, from the differences of neighbours in speed [von Neumann 1941].
fn noise(points: &[SpeedPoint]) -> f64 {
    let squares = points.windows(2).map(|pair| {
        let joint = pair[0].weight * pair[1].weight / (pair[0].weight + pair[1].weight);
        joint * (pair[0].residual - pair[1].residual).powi(2)
    });
    squares.sum::<f64>() / points.len().saturating_sub(1).max(1) as f64
}

/// Fewest speeds from which a network is trained.
const FEWEST: usize = 30;

/// Network of the best start, and its losses; zero for too few points.
fn fit(
    points: &[SpeedPoint],
    fastest: f64,
    seed: u64,
    watch: &mut dyn FnMut(usize, f64),
) -> (JointNetwork, Vec<f64>) {
    let mut best = (JointNetwork::silent(seed as u32), Vec::new());
    if points.len() < FEWEST {
        return best;
    }
    let mut points = points.to_vec();
    points.extend(beyond(&points, fastest));
    let all: f64 = points.iter().map(|point| point.weight).sum();
    let square = |point: &SpeedPoint| point.weight * point.residual.powi(2);
    let unit = (points.iter().map(square).sum::<f64>() / all).sqrt();
    let unit = unit.max(f64::MIN_POSITIVE);
    let rows: Vec<Row> = points
        .iter()
        .map(|point| Row {
            inputs: std::array::from_fn(|i| f64::from(network_inputs(point.qd as f32)[i])),
            target: point.residual / unit,
            weight: point.weight / all,
        })
        .collect();
    let mut least = f64::INFINITY;
    for start in 0..STARTS {
        let seed = seed.wrapping_add(start);
        let network = TrainingNetwork::silent(NETWORK_INPUTS, NETWORK_HIDDEN, 1, seed);
        let (network, losses) = descend(network, &rows, &mut |step, loss| {
            watch(step, loss * unit);
        });
        if let Some(&loss) = losses.last().filter(|loss| **loss < least) {
            least = loss;
            let losses = losses.iter().map(|loss| loss * unit).collect();
            best = (on_board(&network, unit), losses);
        }
    }
    best
}

/// One equation of the training.
struct Row {
    inputs: [f64; NETWORK_INPUTS],
    target: f64,
    /// Share of all rows.
    weight: f64,
}

/// Points between the fastest speed seen, each way, and `fastest`, with the mean residual near the fastest speed seen.
/// Together they weigh a tenth of what was seen.
fn beyond(points: &[SpeedPoint], fastest: f64) -> Vec<SpeedPoint> {
    const COUNT: usize = 20;
    let all: f64 = points.iter().map(|point| point.weight).sum();
    let mut out = Vec::new();
    for way in [1.0, -1.0] {
        let speeds = points.iter().map(|point| point.qd * way);
        let seen = speeds.fold(0.0, f64::max);
        let (mut sum, mut weight) = (0.0, 0.0);
        for point in points.iter().filter(|point| point.qd * way > 0.8 * seen) {
            sum += point.weight * point.residual;
            weight += point.weight;
        }
        if seen > 0.0 && seen < fastest {
            out.extend((1..=COUNT).map(|k| SpeedPoint {
                qd: way * (seen + (fastest - seen) * k as f64 / COUNT as f64),
                residual: sum / weight,
                weight: 0.05 * all / COUNT as f64,
            }));
        }
    }
    out
}

/// Levenberg–Marquardt steps from `network`; returns the network and the RMSE after each.
fn descend(
    mut network: TrainingNetwork,
    rows: &[Row],
    watch: &mut dyn FnMut(usize, f64),
) -> (TrainingNetwork, Vec<f64>) {
    let size = network.weights.len();
    let mut damping = 1e-2;
    let mut loss = objective(&network, rows);
    let mut losses = vec![loss.1];
    'steps: for _ in 0..MOST_STEPS {
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut slope = DVector::<f64>::zeros(size);
        let mut jacobian = vec![0.0; size];
        let (mut a, mut y) = ([0.0; NETWORK_HIDDEN], [0.0]);
        for row in rows {
            let x = &row.inputs;
            network.forward(x, &mut a, &mut y);
            jacobian.fill(0.0);
            network.backward(x, &a, &[1.0], &mut jacobian);
            let error = y[0] - row.target;
            for r in 0..size {
                if jacobian[r] == 0.0 {
                    continue;
                }
                let weighted = row.weight * jacobian[r];
                slope[r] += weighted * error;
                // One triangle, by contiguous columns. nalgebra's `ger` takes longer: it adds up inactive units too.
                let mut column = normal.column_mut(r);
                for (sum, other) in column.as_mut_slice().iter_mut().zip(&jacobian[..=r]) {
                    *sum += weighted * other;
                }
            }
        }
        for (k, weight) in network.weights.iter().enumerate() {
            slope[k] += DECAY * weight;
            normal[(k, k)] += DECAY;
        }
        normal.fill_lower_triangle_with_upper_triangle();
        loop {
            let mut damped = normal.clone();
            for k in 0..size {
                damped[(k, k)] += damping * (normal[(k, k)] + 1e-6);
            }
            let mut moved = network.clone();
            if let Some(cholesky) = damped.cholesky() {
                let step = cholesky.solve(&slope);
                for (weight, step) in moved.weights.iter_mut().zip(step.iter()) {
                    *weight -= step;
                }
            }
            let now = objective(&moved, rows);
            if now.0 < loss.0 {
                let gain = loss.0 - now.0;
                network = moved;
                loss = now;
                losses.push(now.1);
                watch(losses.len() - 1, now.1);
                damping = (damping * 0.3_f64).max(1e-9);
                if gain < 1e-7 * loss.0 {
                    break 'steps;
                }
                break;
            }
            damping *= 4.0;
            if damping > 1e8 {
                break 'steps;
            }
        }
    }
    (network, losses)
}

/// Objective with weight decay, and RMSE without.
fn objective(network: &TrainingNetwork, rows: &[Row]) -> (f64, f64) {
    let (mut a, mut y) = ([0.0; NETWORK_HIDDEN], [0.0]);
    let mut mean = 0.0;
    for row in rows {
        network.forward(&row.inputs, &mut a, &mut y);
        mean += row.weight * (y[0] - row.target).powi(2);
    }
    let weights: f64 = network.weights.iter().map(|w| w * w).sum();
    (0.5 * (mean + DECAY * weights), mean.sqrt())
}

/// The network in the board's precision and order, its output multiplied by `unit`.
fn on_board(network: &TrainingNetwork, unit: f64) -> JointNetwork {
    let [w1, b1, w2, b2] = network.layers();
    let mut out = JointNetwork::zeros();
    for k in 0..NETWORK_HIDDEN {
        for input in 0..NETWORK_INPUTS {
            out.hidden_weights[(k, input)] = w1[k * NETWORK_INPUTS + input] as f32;
        }
        out.hidden_bias[k] = b1[k] as f32;
        out.output_weights[(0, k)] = (unit * w2[k]) as f32;
    }
    out.output_bias[0] = (unit * b2[0]) as f32;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn train(halves: [Vec<SpeedPoint>; 2]) -> (JointNetwork, Vec<f64>) {
        train_residual(&halves, 3.0, 1, &mut |_, _| ())
    }

    fn output(network: &JointNetwork, qd: f64) -> f64 {
        f64::from(network.forward(&network_inputs(qd as f32))[0])
    }

    fn point(qd: f64, residual: f64) -> SpeedPoint {
        let weight = 1.0;
        SpeedPoint {
            qd,
            residual,
            weight,
        }
    }

    #[test]
    fn a_stribeck_curve_is_learnt_to_a_tenth_and_held_beyond() {
        let curve = |qd: f64| 0.02 * qd.signum() * (-(qd / 0.1).powi(2)).exp();
        let speeds = (0..400).map(|k| 1.5 * f64::from(k - 200) / 200.0);
        let speeds = speeds.filter(|qd| qd.abs() > 0.05);
        let points: Vec<SpeedPoint> = speeds.map(|qd| point(qd, curve(qd))).collect();
        let (network, losses) = train([points.clone(), points.clone()]);
        let error = points.iter();
        let error = error.map(|point| (output(&network, point.qd) - point.residual).powi(2));
        let power: f64 = points.iter().map(|point| point.residual.powi(2)).sum();
        let ratio = (error.sum::<f64>() / power).sqrt();
        assert!(ratio < 0.1, "{ratio}");
        assert!(losses.len() > 1);
        assert!(output(&network, 3.0).abs() < 0.003);
    }

    #[test]
    fn a_network_that_could_only_learn_noise_is_zero() {
        let half = |phase: f64| {
            let noise = |k: i32| 0.01 * (f64::from(k) * 12.9898 + phase).sin();
            let points = (0..200).map(|k| point(f64::from(k) / 100.0 - 1.0, noise(k)));
            points.collect()
        };
        let (network, _) = train([half(0.0), half(2.0)]);
        assert!((0..20).all(|k| output(&network, 0.1 * f64::from(k) - 1.0) == 0.0));
    }
}
