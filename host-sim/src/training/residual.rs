//! The residual BP networks: one small network a joint learns what the linear model leaves, from friction inputs only.
//!
//! They are the board's own networks: same shape, same inputs, output in units of the torque limit.

use super::TrainingNetwork;
use foretorque::feedforward::{JointNetwork, NETWORK_HIDDEN, NETWORK_INPUTS};
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};

/// How a residual network is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualConfig {
    /// Seed of the random starts.
    pub seed: u64,
    /// Random starts; the one with the lowest loss counts.
    pub starts: usize,
    /// Most steps of one start.
    pub max_steps: usize,
    /// Rows at most.
    pub rows: usize,
    /// Weight decay against the error in units of noise: without it, units fit noise where few rows are.
    pub decay: f64,
}

impl Default for ResidualConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            starts: 4,
            max_steps: 60,
            rows: 4000,
            decay: 1e-3,
        }
    }
}

/// Trains one joint's network on velocities, rad/s, and residuals over the torque limit, ratios. Returns the network in
/// the board's precision, and the loss (RMSE, ratio of the torque limit) after every step of the best start; `watch` sees step and loss of every start.
///
/// Levenberg–Marquardt steps on the back-propagated Jacobian [Hagan and Menhaj 1994]: 31 weights are few enough to solve
/// for. A residual counts for no more than three deviations from those at nearly the same speed. Speeds the log does not hold, up to `fastest`,
/// rad/s, are given the residual at the fastest speed it does hold: a rectifier would continue the last slope.
///
/// A network that was trained on every other tenth of the samples and does not improve the tenths between says nothing.
pub fn train_residual(
    samples: &[(f64, f64)],
    fastest: f64,
    config: &ResidualConfig,
    watch: &mut dyn FnMut(usize, f64),
) -> (JointNetwork, Vec<f64>) {
    let tenth = samples.len().div_ceil(10).max(1);
    let every_other = |first: usize| -> Vec<(f64, f64)> {
        let blocks = samples.chunks(tenth).skip(first).step_by(2);
        blocks.flatten().copied().collect()
    };
    let (probe, _) = fit(&every_other(0), fastest, config, &mut |_, _| ());
    let unseen = every_other(1);
    let without: f64 = unseen.iter().map(|(_, residual)| residual * residual).sum();
    let left = |(qd, residual): &(f64, f64)| {
        (f64::from(probe.forward(&network_inputs(*qd as f32))[0]) - residual).powi(2)
    };
    let with: f64 = unseen.iter().map(left).sum();
    if with < WORTHWHILE * without {
        fit(samples, fastest, config, watch)
    } else {
        (JointNetwork::silent(config.seed as u32), Vec::new())
    }
}

/// A network must leave less than this share of the power of residuals it was not trained on.
const WORTHWHILE: f64 = 0.98;

fn fit(
    samples: &[(f64, f64)],
    fastest: f64,
    config: &ResidualConfig,
    watch: &mut dyn FnMut(usize, f64),
) -> (JointNetwork, Vec<f64>) {
    let stride = samples.len().div_ceil(config.rows).max(1);
    let mut rows: Vec<(f64, f64)> = samples.iter().copied().step_by(stride).collect();
    if rows.len() < 4 * JointNetwork::WEIGHTS {
        // Too little to learn from: say nothing.
        return (JointNetwork::silent(config.seed as u32), Vec::new());
    }
    without_outliers(&mut rows);
    rows.extend(beyond(&rows, fastest));
    let inputs: Vec<[f64; NETWORK_INPUTS]> = rows
        .iter()
        .map(|(qd, _)| std::array::from_fn(|i| f64::from(network_inputs(*qd as f32)[i])))
        .collect();
    let unit = (rows.iter().map(|(_, r)| r * r).sum::<f64>() / rows.len() as f64).sqrt();
    let unit = unit.max(f64::MIN_POSITIVE);
    let targets: Vec<f64> = rows.iter().map(|(_, r)| r / unit).collect();
    let mut best: Option<(TrainingNetwork, Vec<f64>)> = None;
    for start in 0..config.starts.max(1) as u64 {
        let network = TrainingNetwork::silent(
            NETWORK_INPUTS,
            NETWORK_HIDDEN,
            1,
            config.seed.wrapping_add(start),
        );
        let (network, losses) = descend(network, &inputs, &targets, config, &mut |step, loss| {
            watch(step, loss * unit);
        });
        let loss = |losses: &[f64]| losses.last().copied().unwrap_or(f64::INFINITY);
        if best
            .as_ref()
            .is_none_or(|(_, before)| loss(&losses) < loss(before))
        {
            best = Some((network, losses));
        }
    }
    match best {
        Some((network, losses)) => (
            on_board(&network, unit),
            losses.iter().map(|loss| loss * unit).collect(),
        ),
        None => (JointNetwork::silent(config.seed as u32), Vec::new()),
    }
}

/// Neighbours in speed a residual is compared with, on each side.
const NEIGHBOURS: usize = 25;

/// Sorts the rows by speed and cuts every residual to three deviations (by the median) around the median of its
/// neighbours in speed: the scatter is judged where it is, so that a peak at low speed is no outlier.
fn without_outliers(rows: &mut [(f64, f64)]) {
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let residuals: Vec<f64> = rows.iter().map(|(_, residual)| *residual).collect();
    let middle = |values: &mut [f64]| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    for (row, (_, residual)) in rows.iter_mut().enumerate() {
        let near = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(residuals.len());
        let mut values = residuals[near].to_vec();
        let centre = middle(&mut values);
        for value in &mut values {
            *value = (*value - centre).abs();
        }
        let bound = 3.0 * 1.4826 * middle(&mut values);
        *residual = residual.clamp(centre - bound, centre + bound);
    }
}

/// Rows between the fastest speed seen, each way, and `fastest`, with the mean residual near the fastest speed seen.
fn beyond(rows: &[(f64, f64)], fastest: f64) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for way in [1.0, -1.0] {
        let seen = rows.iter().map(|(qd, _)| qd * way).fold(0.0, f64::max);
        let near: Vec<f64> = rows
            .iter()
            .filter(|(qd, _)| qd * way > 0.9 * seen)
            .map(|(_, residual)| *residual)
            .collect();
        if seen > 0.0 && seen < fastest {
            let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
            let count = rows.len() / 20;
            out.extend((1..=count).map(|k| {
                let qd = seen + (fastest - seen) * k as f64 / count as f64;
                (way * qd, mean)
            }));
        }
    }
    out
}

fn descend(
    mut network: TrainingNetwork,
    inputs: &[[f64; NETWORK_INPUTS]],
    targets: &[f64],
    config: &ResidualConfig,
    watch: &mut dyn FnMut(usize, f64),
) -> (TrainingNetwork, Vec<f64>) {
    let size = network.weights.len();
    let count = targets.len() as f64;
    let mut damping = 1e-2;
    let mut loss = objective(&network, inputs, targets, config.decay);
    let mut losses = vec![loss.1];
    'steps: for _ in 0..config.max_steps {
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut slope = DVector::<f64>::zeros(size);
        let mut jacobian = vec![0.0; size];
        let (mut a, mut y) = ([0.0; NETWORK_HIDDEN], [0.0]);
        for (x, target) in inputs.iter().zip(targets) {
            network.forward(x, &mut a, &mut y);
            jacobian.fill(0.0);
            network.backward(x, &a, &[1.0], &mut jacobian);
            let error = y[0] - target;
            for r in 0..size {
                if jacobian[r] == 0.0 {
                    continue;
                }
                slope[r] += jacobian[r] * error / count;
                for c in 0..=r {
                    normal[(r, c)] += jacobian[r] * jacobian[c] / count;
                }
            }
        }
        for (k, weight) in network.weights.iter().enumerate() {
            slope[k] += config.decay * weight;
            normal[(k, k)] += config.decay;
        }
        for r in 0..size {
            for c in 0..r {
                normal[(c, r)] = normal[(r, c)];
            }
        }
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
            let now = objective(&moved, inputs, targets, config.decay);
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
fn objective(
    network: &TrainingNetwork,
    inputs: &[[f64; NETWORK_INPUTS]],
    targets: &[f64],
    decay: f64,
) -> (f64, f64) {
    let (mut a, mut y) = ([0.0; NETWORK_HIDDEN], [0.0]);
    let mut sum = 0.0;
    for (x, target) in inputs.iter().zip(targets) {
        network.forward(x, &mut a, &mut y);
        sum += (y[0] - target).powi(2);
    }
    let mean = sum / targets.len().max(1) as f64;
    let weights: f64 = network.weights.iter().map(|w| w * w).sum();
    (0.5 * (mean + decay * weights), mean.sqrt())
}

/// The network in the board's precision and order, its output multiplied by `unit`.
fn on_board(network: &TrainingNetwork, unit: f64) -> JointNetwork {
    let [w1, b1, w2, b2] = network.layers();
    let mut out = JointNetwork::zeros();
    for unit_index in 0..NETWORK_HIDDEN {
        for input in 0..NETWORK_INPUTS {
            out.hidden_weights[(unit_index, input)] =
                w1[unit_index * NETWORK_INPUTS + input] as f32;
        }
        out.hidden_bias[unit_index] = b1[unit_index] as f32;
        out.output_weights[(0, unit_index)] = (unit * w2[unit_index]) as f32;
    }
    out.output_bias[0] = (unit * b2[0]) as f32;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stribeck_curve_is_learnt_to_a_fifth_and_holds_beyond_the_speeds_seen() {
        let curve = |qd: f64| 0.02 * qd.signum() * (-(qd / 0.1).powi(2)).exp();
        let samples: Vec<(f64, f64)> = (0..4000)
            .map(|k| 1.5 * (f64::from(k) * 0.0137).sin())
            .filter(|qd| qd.abs() > 0.05)
            .map(|qd| (qd, curve(qd)))
            .collect();
        let (network, losses) =
            train_residual(&samples, 3.0, &ResidualConfig::default(), &mut |_, _| ());
        let error = samples.iter().map(|(qd, r)| {
            (f64::from(network.forward(&network_inputs(*qd as f32))[0]) - r).powi(2)
        });
        let power: f64 = samples.iter().map(|(_, r)| r * r).sum();
        let ratio = (error.sum::<f64>() / power).sqrt();
        assert!(ratio < 0.2, "{ratio}");
        assert!(losses.len() > 1);
        assert!(network.forward(&network_inputs(3.0))[0].abs() < 0.003);
    }

    #[test]
    fn a_network_that_could_only_learn_noise_says_nothing() {
        let samples: Vec<(f64, f64)> = (0..2000)
            .map(|k| {
                let k = f64::from(k);
                ((k * 0.0137).sin(), 0.01 * (k * 12.9898).sin())
            })
            .collect();
        let (network, _) =
            train_residual(&samples, 3.0, &ResidualConfig::default(), &mut |_, _| ());
        assert!((0..20).all(|k| network.forward(&network_inputs(0.1 * k as f32 - 1.0))[0] == 0.0));
    }
}
