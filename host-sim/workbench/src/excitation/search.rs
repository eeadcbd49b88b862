//! The search: seeded starts, a quasi-Newton method under growing penalties on the limits, a certificate for each result.

use super::certificate::{Certificate, Provenance, certify};
use super::clearance::Clearances;
use super::descent::descend;
use super::information::{Criterion, Experiment};
use super::objective::{INSTANTS, Objective, PenaltyWeights};
use super::rows::{Frames, Rows};
use super::series::Extremes;
use super::variables::{Bases, VARIABLES};
use super::{Excitation, ExcitationError, JointSeries, ORDER};
use crate::dynamics::Joints;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use std::num::NonZeroUsize;

/// Share of the limits that a search uses: what lies between its instants takes 0.2 %.
const LIMIT_SHARE: f64 = 0.995;
/// Share of the condition number's limit that a search uses.
const CONDITION_SHARE: f64 = 0.998;
/// Margin for the motion between the points of the certificate: half its step at most, s.
const HALF_STEP_S: f64 = 0.5e-3;
/// Weights of the penalties in the rounds that every start runs.
const COARSE_WEIGHTS: [f64; 3] = [3.0, 30.0, 300.0];
/// A round of those takes this fraction of the iterations.
const COARSE_SHARE: usize = 8;
/// One in so many starts goes on.
const FINALIST_EVERY: usize = 4;
/// Weights in the rounds of those that do. With the last, a limit that binds on one instant in fifty is exceeded by about
/// 0.3 %.
const FINAL_WEIGHTS: [f64; 2] = [3e3, 3e4];
/// Rounds that press harder when the certificate finds a limit missed.
const REPAIRS: usize = 4;
/// Random candidates looked at for each start.
const POOL: usize = 8;

/// Settings of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchConfig {
    /// Period of the fundamental, s.
    pub period_s: f64,
    /// Objective.
    pub criterion: Criterion,
    /// Limit of the condition number under [`Criterion::Constrained`].
    pub condition_limit: f64,
    /// Seed of the starts.
    pub seed: u64,
    /// Starts.
    pub starts: usize,
    /// Most iterations of a round for the finalists, one start in four; the rounds before are shorter.
    pub iterations: usize,
    /// Range of every joint around zero, rad, on top of the robot's own.
    pub range_rad: f64,
    /// Threads; the result does not depend on them. `None`: all cores.
    pub threads: Option<NonZeroUsize>,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self {
            period_s: 10.0,
            criterion: Criterion::Constrained,
            condition_limit: 60.0,
            seed: 1,
            starts: 24,
            iterations: 240,
            range_rad: PI,
            threads: None,
        }
    }
}

/// The best excitation of all starts, with its certificate; all its limits hold.
///
/// With `given`, that trajectory is the only start, and the result is never worse than it unless it misses a limit.
/// `progress(done, all)` is called from this thread.
///
/// Errors: [`ExcitationError`]: a robot that has not `N` joints, an empty range, no start that keeps all limits.
pub fn optimise<const N: usize>(
    robot: &Robot,
    config: &SearchConfig,
    given: Option<&Excitation>,
    mut progress: impl FnMut(usize, usize),
) -> Result<Excitation, ExcitationError> {
    let search = Search::<N>::new(robot, config)?;
    let threads = config.threads.map_or_else(cores, NonZeroUsize::get);
    let starts = match given {
        Some(excitation) => vec![search.variables(excitation)],
        None => search.starts()?,
    };
    let finalists = starts.len().div_ceil(FINALIST_EVERY);
    let all = starts.len() + finalists;
    let mut done = 0;
    progress(done, all);
    let mut count = || {
        done += 1;
        progress(done, all);
    };
    let mut coarse = in_parallel(
        threads,
        &starts,
        |start| search.coarse_search(start),
        &mut count,
    );
    // Stable: equal values keep the order of their starts.
    coarse.sort_by(|a, b| a.0.total_cmp(&b.0));
    coarse.truncate(finalists);
    let mut results = in_parallel(
        threads,
        &coarse,
        |coarse| search.finish(&coarse.1),
        &mut count,
    );
    if let Some(excitation) = given {
        let kept = Excitation {
            seed: config.seed,
            certificate: None,
            ..excitation.clone()
        };
        results.insert(0, search.certified(kept));
    }
    search.best(results)
}

/// One robot and one task, ready for any number of starts.
struct Search<'a, const N: usize> {
    robot: &'a Robot,
    config: &'a SearchConfig,
    objective: Objective<N>,
    bases: Bases,
    origin: Provenance,
    /// Clearance asked for, with a margin for the motion between the certificate's points, m.
    clearance: Vec<f64>,
}

impl<'a, const N: usize> Search<'a, N> {
    fn new(robot: &'a Robot, config: &'a SearchConfig) -> Result<Self, ExcitationError> {
        let other_size = || ExcitationError::joints(robot, N);
        let rows = Rows::<N>::new(robot, Frames::Dh).ok_or_else(other_size)?;
        let limits = Extremes::of_limits(robot, config.range_rad, LIMIT_SHARE)?;
        let clearances = Clearances::<N>::new(robot).ok_or_else(other_size)?;
        for index in 0..clearances.count() {
            let (most_m, asked_m) = (clearances.most(index), clearances.asked);
            if most_m < asked_m {
                return Err(ExcitationError::OutOfReach {
                    of: clearances.name(index),
                    most_m,
                    asked_m,
                });
            }
        }
        let fastest = Joints::<N>::from_fn(|j, _| limits[j].qd);
        let clearance = (0..clearances.count())
            .map(|index| clearances.asked + 0.001 + clearances.rate(index, &fastest) * HALF_STEP_S)
            .collect();
        let torque = std::array::from_fn(|j| {
            let (friction, limit) = (&robot.joints[j].friction, robot.joints[j].limits.torque);
            let beyond = friction.coulomb * friction.stribeck_ratio + friction.cogging;
            // Rates between points are bounded coarsely: leave a tenth.
            (0.9 * limit - beyond).max(0.1 * limit)
        });
        let experiment = Experiment::new(robot, &rows).ok_or_else(other_size)?;
        let parameters = rows.parameters(robot).ok_or_else(other_size)?;
        Ok(Self {
            objective: Objective::new(
                rows,
                experiment,
                clearances,
                limits,
                torque,
                parameters,
                config.criterion,
                config.condition_limit * CONDITION_SHARE,
                config.period_s,
            ),
            robot,
            config,
            bases: Bases::new(),
            origin: Provenance {
                criterion: config.criterion,
                starts: config.starts,
                condition_limit: config.condition_limit,
                range_rad: config.range_rad,
            },
            clearance,
        })
    }

    /// The best of a pool of random candidates, each drawn from its own stream of the seed.
    fn starts(&self) -> Result<Vec<Vec<f64>>, ExcitationError> {
        let omega = TAU / self.config.period_s;
        let penalties = self.penalties(COARSE_WEIGHTS[0], 0.0);
        let mut pool: Vec<(f64, Vec<f64>)> = (0..self.config.starts.max(1) * POOL)
            .map(|stream| {
                let mut random = ChaCha8Rng::seed_from_u64(self.config.seed);
                random.set_stream(stream as u64);
                let variables: Vec<f64> = self
                    .objective
                    .limits
                    .iter()
                    .flat_map(|limit| {
                        let share = random.random_range(0.4..1.0);
                        let series =
                            JointSeries::random(limit, omega, INSTANTS, share, &mut random);
                        self.bases.variables(&series)
                    })
                    .collect();
                (
                    self.objective.value(&variables, &penalties, None),
                    variables,
                )
            })
            .collect();
        // Stable: equal values keep the order of their streams.
        pool.sort_by(|a, b| a.0.total_cmp(&b.0));
        pool.truncate(self.config.starts.max(1));
        Ok(pool.into_iter().map(|(_, variables)| variables).collect())
    }

    fn variables(&self, excitation: &Excitation) -> Vec<f64> {
        let series = excitation.joints.iter();
        series
            .flat_map(|joint| self.bases.variables(joint))
            .collect()
    }

    fn penalties(&self, weight: f64, more_clearance: f64) -> PenaltyWeights {
        PenaltyWeights {
            weight,
            clearance: self.clearance.iter().map(|c| c + more_clearance).collect(),
        }
    }

    /// The first, soft rounds of a start: its value afterwards, and where it got to.
    fn coarse_search(&self, start: &[f64]) -> (f64, Vec<f64>) {
        let mut variables = start.to_vec();
        for weight in COARSE_WEIGHTS {
            let iterations = self.config.iterations.div_ceil(COARSE_SHARE);
            variables = self.descend(variables, &self.penalties(weight, 0.0), iterations);
        }
        let last = self.penalties(COARSE_WEIGHTS[COARSE_WEIGHTS.len() - 1], 0.0);
        (self.objective.value(&variables, &last, None), variables)
    }

    /// The last, hard rounds, to the certificate; pressed harder while a limit is missed.
    fn finish(&self, coarse: &[f64]) -> Result<Excitation, ExcitationError> {
        let mut variables = coarse.to_vec();
        for weight in FINAL_WEIGHTS {
            variables = self.descend(
                variables,
                &self.penalties(weight, 0.0),
                self.config.iterations,
            );
        }
        let mut excitation = self.certified(self.fitted(&variables))?;
        let last = FINAL_WEIGHTS[FINAL_WEIGHTS.len() - 1];
        for repair in 1..=REPAIRS {
            if holds(&excitation) {
                break;
            }
            let penalties =
                self.penalties(last * 4.0_f64.powi(repair as i32), 0.001 * repair as f64);
            variables = self.descend(variables, &penalties, self.config.iterations);
            excitation = self.certified(self.fitted(&variables))?;
        }
        Ok(excitation)
    }

    fn descend(
        &self,
        variables: Vec<f64>,
        penalties: &PenaltyWeights,
        iterations: usize,
    ) -> Vec<f64> {
        descend(&self.objective, penalties, variables, iterations)
    }

    /// The variables as a trajectory, what exceeds the joints' limits between the instants taken back.
    fn fitted(&self, variables: &[f64]) -> Excitation {
        let omega = TAU / self.config.period_s;
        let limit = |limit: &Extremes| Extremes {
            // From the search's share back to nearly the whole limit.
            q: limit.q,
            qd: limit.qd * (1.0 - 1e-6) / LIMIT_SHARE,
            qdd: limit.qdd * (1.0 - 1e-6) / LIMIT_SHARE,
        };
        let joints = variables
            .chunks_exact(VARIABLES)
            .zip(&self.objective.limits)
            .map(|(own, limits)| self.bases.series(own).fitted(&limit(limits), omega, 10_000))
            .collect();
        Excitation {
            robot: self.robot.name.clone(),
            period_s: self.config.period_s,
            order: ORDER,
            seed: self.config.seed,
            joints,
            certificate: None,
        }
    }

    fn certified(&self, excitation: Excitation) -> Result<Excitation, ExcitationError> {
        let certificate = certify(self.robot, &excitation, &self.objective, &self.origin)?;
        Ok(Excitation {
            certificate: Some(Box::new(certificate)),
            ..excitation
        })
    }

    /// The best result that holds; the first of equals.
    fn best(
        &self,
        results: Vec<Result<Excitation, ExcitationError>>,
    ) -> Result<Excitation, ExcitationError> {
        let score = |certificate: &Certificate| match self.config.criterion {
            Criterion::Condition => certificate.condition_number_dh,
            Criterion::DOptimal => certificate.ln_spread,
            Criterion::VOptimal | Criterion::Constrained => certificate.predicted_nrmse_percent,
        };
        let mut best: Option<(f64, Excitation)> = None;
        let mut missed: Option<(f64, ExcitationError)> = None;
        let mut refused = ExcitationError::Unseen;
        for result in results {
            let excitation = match result {
                Ok(excitation) => excitation,
                Err(error) => {
                    refused = error;
                    continue;
                }
            };
            let Some(certificate) = &excitation.certificate else {
                continue;
            };
            if certificate.holds {
                let score = score(certificate);
                if best.as_ref().is_none_or(|(lowest, _)| score < *lowest) {
                    best = Some((score, excitation));
                }
            } else if let Some(check) = certificate.worst_limit() {
                let short = -check.margin / check.allowed.abs().max(0.1);
                if missed.as_ref().is_none_or(|(least, _)| short < *least) {
                    let error = ExcitationError::Unkept {
                        limit: format!("{} of {}", check.limit, check.of),
                        reached: quantity(check.worst, check.unit),
                        asked: quantity(check.allowed, check.unit),
                    };
                    missed = Some((short, error));
                }
            }
        }
        match (best, missed) {
            (Some((_, excitation)), _) => Ok(excitation),
            (None, Some((_, error))) => Err(error),
            (None, None) => Err(refused),
        }
    }
}

/// A value with its unit; numbers without one stand alone.
fn quantity(value: f64, unit: &str) -> String {
    match unit {
        "1" => format!("{value:.4}"),
        unit => format!("{value:.4} {unit}"),
    }
}

fn holds(excitation: &Excitation) -> bool {
    let certificate = excitation.certificate.as_ref();
    certificate.is_some_and(|certificate| certificate.holds)
}

#[cfg(test)]
mod tests;
