//! Delay of the torques behind the positions.

use super::explained::ROUNDING;
use super::{ANALYTIC, DELAY_S, FAST_RAD_S, Judgement};
use crate::dynamics::Motion;
use crate::identification::columns::Layout;
use crate::identification::normal::equilibrated;
use nalgebra::{DMatrix, DVector};
use std::collections::VecDeque;

/// Delays that are tried on each side of none, and the largest of them, s.
const TRIED: usize = 20;
const LONGEST_S: f64 = 0.1;

/// Standard deviations from which a delay counts: beyond it are as few of Student's t with the seven degrees of freedom that
/// [`PARTS`] have, as of a normal distribution beyond three [JCGM 100:2008, table G.2].
const CLEAR: f64 = 4.53;
/// Rows that follow one another are averaged over this long: noise of the encoders comes back in the torque through the
/// joint controller, ahead of the position it is seen in, and is fast.
const AVERAGED_S: f64 = 0.1;

/// Averages beyond the number of columns from which the noise of a joint is estimated.
const SURE: f64 = 8.0;
/// Columns of a joint beside those of the model: offset, friction that falls and that grows with the speed, and gravity along
/// two axes across the described one, which a base has that is tilted.
const MORE: usize = 5;

/// Parts of a log that are left out in turn. The scatter of the delays without them counts what a deviation from the
/// residuals does not: residuals that stay alike for long, and a second smallest cost elsewhere.
const PARTS: usize = 8;

/// Normal equations of one joint with its torque at several delays, part by part of the log.
#[derive(Default)]
pub(super) struct Delay {
    /// Up to twice as many as parts; then neighbours are joined.
    sums: Vec<Sums>,
    /// Averages in each of them.
    full: f64,
    /// Columns and torques of the last rows that follow one another.
    last: VecDeque<DVector<f64>>,
}

#[derive(Clone)]
struct Sums {
    /// Number of averages.
    count: f64,
    /// Products of all columns and the torques at all delays with one another.
    products: DMatrix<f64>,
}

const DELAYS: usize = 2 * TRIED + 1;

/// Rows between two delays that are tried.
fn step_rows(period_s: f64) -> usize {
    ((LONGEST_S / TRIED as f64 / period_s).round() as usize).max(1)
}

/// Rows in which a joint is fast, and was and will be for `reach` rows: at a reversal it sticks, where friction is no function
/// of its speed, and a filter smears that over its length.
pub(super) fn fast_rows(states: &[Motion], joint: usize, reach: usize) -> Vec<bool> {
    let fast = states.iter();
    let fast = fast.map(|state| state.qd[joint].abs() > FAST_RAD_S);
    let fast: Vec<bool> = fast.collect();
    let around = |row: usize| row.saturating_sub(reach)..fast.len().min(row + reach + 1);
    let stays = |row| fast[around(row)].iter().all(|fast| *fast);
    (0..fast.len()).map(stays).collect()
}

impl Delay {
    /// Adds row `row` of a log with a row every `period_s` with the torques `tau_nm` around it; more columns stand beside the
    /// columns `x`, `across` among them. A row that is not `fast`, or one without all torques, ends an average.
    ///
    /// * `across` torques of gravity along two axes across the described one, N·m
    pub(super) fn add(
        &mut self,
        (x, across): (&[f64], [f64; 2]),
        (qd, fast): (f64, bool),
        (row, stride, period_s): (usize, usize, f64),
        tau_nm: &dyn Fn(usize) -> Option<f64>,
    ) {
        let step = step_rows(period_s);
        let first = row.checked_sub(TRIED * step);
        let torque = |first: usize| -> Option<Vec<f64>> {
            (0..DELAYS).map(|k| tau_nm(first + k * step)).collect()
        };
        let torques = first.and_then(torque).filter(|_| fast);
        let Some(torques) = torques else {
            self.last.clear();
            return;
        };
        let falling = qd.signum() * (-qd.abs() / FAST_RAD_S).exp();
        let more: [f64; MORE] = [1.0, falling, qd * qd.abs(), across[0], across[1]];
        let row = [x, &more, &torques].concat();
        let rows = (AVERAGED_S / (stride as f64 * period_s)).round().max(1.0);
        self.last.push_back(DVector::from_vec(row));
        if (self.last.len() as f64) < rows {
            return;
        }
        let average = self.last.iter().sum::<DVector<f64>>() / rows;
        self.last.pop_front();
        let last = self.sums.last();
        if last.is_none_or(|last| last.count >= self.full) {
            if self.sums.len() == 2 * PARTS {
                self.sums = self.sums.chunks(2).filter_map(joined).collect();
                self.full *= 2.0;
            }
            self.full = self.full.max(1.0);
            let size = average.len();
            self.sums.push(Sums {
                count: 0.0,
                products: DMatrix::zeros(size, size),
            });
        }
        if let Some(last) = self.sums.last_mut() {
            // Averages overlap: so many of them are worth one.
            last.products.ger(1.0 / rows, &average, &average, 1.0);
            last.count += 1.0 / rows;
        }
    }

    /// Sums of all parts, or `without` one of them.
    fn sums(&self, without: Option<usize>) -> Option<Sums> {
        let count = self.sums.len();
        let kept = (0..count).filter(|sums| Some(sums * PARTS / count) != without);
        joined(kept.map(|sums| &self.sums[sums]))
    }
}

/// Squares that the best parameters leave at every delay, at least those of rounding, and the number of averages beyond that of
/// the columns.
fn rests(Sums { count, products }: &Sums) -> Option<(DVector<f64>, f64)> {
    let columns = products.nrows() - DELAYS;
    let gram = products.view((0, 0), (columns, columns)).into_owned();
    let (unit, size) = equilibrated(&gram);
    let inverse = unit.pseudo_inverse(1e-8).ok()?;
    let rests = DVector::from_fn(DELAYS, |delay, _| {
        let own = products.column(columns + delay);
        let (moment, power) = (own.rows(0, columns), own[columns + delay]);
        let moment = moment.component_mul(&size);
        let left = power - moment.dot(&(&inverse * &moment));
        left.max(ROUNDING * power)
    });
    let used = size.iter().filter(|size| **size > 0.0).count();
    let free = count - used as f64;
    (free > 1.0 && rests.min() > 0.0).then_some((rests, free))
}

/// Minus the logarithm of the likelihood of every delay, up to a constant, and the number of averages beyond that of the
/// columns; `without` one of the parts.
///
/// All joints together: they share the parameters of the links, and 10 s of motion have too few averages for each joint to
/// have parameters of its own.
fn costs(
    delays: &[Delay],
    variances: &[Option<f64>],
    layout: &Layout,
    without: Option<usize>,
) -> Option<(DVector<f64>, f64)> {
    let size = layout.parameters.len() + MORE * layout.joints();
    let mut all = Sums {
        count: 0.0,
        products: DMatrix::zeros(size + DELAYS, size + DELAYS),
    };
    for (joint, (delay, variance)) in delays.iter().zip(variances).enumerate() {
        let (Some(variance), Some(own)) = (variance, delay.sums(without)) else {
            continue;
        };
        let private = layout.parameters.len() + MORE * joint;
        let places = layout.active[joint].iter().copied();
        let places = places.chain(private..private + MORE);
        let places: Vec<usize> = places.chain(size..size + DELAYS).collect();
        for (a, &row) in places.iter().enumerate() {
            for (b, &column) in places.iter().enumerate() {
                all.products[(row, column)] += own.products[(a, b)] / variance;
            }
        }
        all.count += own.count;
    }
    let (rests, free) = rests(&all)?;
    Some((rests.map(|rest| 0.5 * free * rest.ln()), free))
}

/// The sums of all `parts`.
fn joined<'a>(parts: impl IntoIterator<Item = &'a Sums>) -> Option<Sums> {
    let parts = parts.into_iter().cloned();
    parts.reduce(|all, part| Sums {
        count: all.count + part.count,
        products: all.products + part.products,
    })
}

/// Most likely delay and its standard deviation in steps, by a parabola through the smallest cost and its neighbours.
fn vertex(costs: &DVector<f64>) -> (f64, f64) {
    let at = costs.imin().clamp(1, costs.len() - 2);
    let [before, here, after] = [costs[at - 1], costs[at], costs[at + 1]];
    let curvature = (before + after - 2.0 * here).max(f64::MIN_POSITIVE);
    let beside = (0.5 * (before - after) / curvature).clamp(-1.0, 1.0);
    (
        at as f64 + beside - TRIED as f64,
        ANALYTIC / curvature.sqrt(),
    )
}

/// Scatter of the delays of the joints over what their deviations let expect, 1 at least [Birge 1932]: a true delay is that
/// of all joints, what friction does at slow speed is each joint's own.
fn scatter<'a>(joints: impl Iterator<Item = &'a (DVector<f64>, f64)>) -> f64 {
    let own = |(rests, free): &(DVector<f64>, f64)| {
        let (mean, deviation) = vertex(&rests.map(|rest| 0.5 * free * rest.ln()));
        (mean, deviation.powi(-2))
    };
    let joints: Vec<(f64, f64)> = joints.map(own).collect();
    let all: f64 = joints.iter().map(|(_, weight)| weight).sum();
    let mean = joints
        .iter()
        .map(|(mean, weight)| mean * weight)
        .sum::<f64>()
        / all;
    let squares = joints
        .iter()
        .map(|(own, weight)| (own - mean).powi(2) * weight);
    let free = joints.len().saturating_sub(1).max(1) as f64;
    (squares.sum::<f64>() / free).sqrt().max(1.0)
}

/// Finding where the best of all delays is the longest that is tried, with and without every part, and leaves less than half of
/// the power that no delay leaves.
///
/// * `costs` [`costs`] of all parts first
fn beyond(costs: &[(DVector<f64>, f64)], step_s: f64) -> Option<String> {
    let best = costs[0].0.imin();
    let at_an_end = best == 0 || best == DELAYS - 1;
    let halves = |(costs, free): &(DVector<f64>, f64)| {
        costs[TRIED] - costs[best] > 0.5 * free * std::f64::consts::LN_2
    };
    let sure = costs
        .iter()
        .all(|part| part.0.imin() == best && halves(part));
    (at_an_end && sure).then(|| {
        let side = if best == 0 { "ahead of" } else { "behind" };
        format!(
            "torques are {:.0} ms or more {side} the positions: do both have one clock? Shift them",
            1e3 * TRIED as f64 * step_s
        )
    })
}

/// Delay of the torques behind the positions, common to all joints, of rows `period_s` apart.
pub(super) fn delay(judgement: &mut Judgement, layout: &Layout, delays: &[Delay], period_s: f64) {
    // Of a joint alone, where it moved for long enough.
    let alone = |delay: &Delay| rests(&delay.sums(None)?).filter(|(_, free)| *free >= SURE);
    let alone: Vec<_> = delays.iter().map(alone).collect();
    let variance = |(rests, free): &(DVector<f64>, f64)| rests.min() / free;
    let variances: Vec<_> = alone
        .iter()
        .map(|joint| joint.as_ref().map(variance))
        .collect();
    let parts = [None].into_iter().chain((0..PARTS).map(Some));
    let costs = parts.map(|without| costs(delays, &variances, layout, without));
    let Some(costs) = costs.collect::<Option<Vec<_>>>() else {
        return;
    };
    let step_s = step_rows(period_s) as f64 * period_s;
    if let Some(text) = beyond(&costs, step_s) {
        judgement.find(true, text);
        return;
    }
    let (mean, analytic) = vertex(&costs[0].0);
    // The jackknife of Quenouille and Tukey.
    let without: Vec<f64> = costs[1..]
        .iter()
        .map(|(costs, _)| vertex(costs).0)
        .collect();
    let centre = without.iter().sum::<f64>() / PARTS as f64;
    let squares: f64 = without.iter().map(|one| (one - centre).powi(2)).sum();
    let jackknife = (squares * (PARTS - 1) as f64 / PARTS as f64).sqrt();
    let deviation = analytic.max(jackknife) * scatter(alone.iter().flatten());
    let (mean, deviation) = (mean * step_s, deviation * step_s);
    if deviation > LONGEST_S {
        return;
    }
    // Of logs with several periods, the longest.
    if judgement
        .delay_s
        .is_none_or(|(other, _)| other.abs() < mean.abs())
    {
        judgement.delay_s = Some((mean, deviation));
    }
    let clear = mean.abs() > CLEAR * deviation;
    if clear && mean.abs() > DELAY_S.1 {
        let refuses = mean.abs() > DELAY_S.0;
        let side = if mean > 0.0 { "behind" } else { "ahead of" };
        let text = format!(
            "torques are {:.1} ± {:.1} ms {side} the positions: shift them, a delay biases inertias and friction",
            1e3 * mean.abs(),
            1e3 * deviation
        );
        judgement.find(refuses, text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::PerJoint;

    #[test]
    fn delays_that_differ_from_joint_to_joint_are_uncertain() {
        // Parabolas about a delay in steps.
        let joint = |steps: f64| {
            let rest =
                |k: usize, _: usize| (1e-3 * (k as f64 - TRIED as f64 - steps).powi(2)).exp();
            (DVector::from_fn(DELAYS, rest), 200.0)
        };
        let of = |delays: [f64; 3]| scatter(delays.map(joint).iter());
        assert_eq!(of([4.0, 4.1, 3.9]), 1.0);
        assert!(of([-9.0, -2.0, 8.0]) > 1.5);
    }

    #[test]
    fn rows_beside_a_slow_one_are_not_fast() {
        let speeds = [1.0, 1.0, 1.0, 0.1, 1.0, 1.0, 1.0];
        let state = |qd: f64| Motion {
            q: PerJoint::repeat(1, 0.0),
            qd: PerJoint::repeat(1, qd),
            qdd: PerJoint::repeat(1, 0.0),
        };
        let fast = fast_rows(&speeds.map(state), 0, 1);
        assert_eq!(fast, [true, true, false, false, false, true, true]);
    }
}
