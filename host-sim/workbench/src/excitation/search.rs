//! The search: seeded starts, a quasi-Newton method with growing penalty weights, a certificate for each result.

mod speeds;

use super::certificate::Certificate;
use super::certify::certify;
use super::clearance::Clearances;
use super::information::{Criterion, Experiment, SIGN_WIDTH_RAD_S as SIGN_WIDTH};
use super::objective::{INSTANTS, Objective, PenaltyWeights, SearchConfig, basis, descend};
use super::path::Excitation;
use super::rows::{Frames, Rows};
use super::series::{Bases, Extremes, JointSeries, VARIABLES};
use super::{refused, unseen};
use crate::Refusal;
use crate::dynamics::PerJoint;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use speeds::{TORQUE_SHARES, torques};
use std::f64::consts::TAU;
use std::num::NonZeroUsize;

/// Share of the limits that a search uses: motion between its instants takes 0.2 %.
const LIMIT_SHARE: f64 = 0.995;
/// Share of the condition number's limit that a search uses.
const CONDITION_SHARE: f64 = 0.998;
/// Half the largest step between the points of the certificate, s.
const HALF_STEP_S: f64 = 0.5e-3;
/// Weights of the penalties in the coarse rounds, which every start runs.
const COARSE_WEIGHTS: [f64; 3] = [3.0, 30.0, 300.0];
/// A coarse round takes the iterations of a final round divided by this.
const COARSE_DIVISOR: usize = 8;
/// One start in this many enters the final rounds.
const FINALIST_EVERY: usize = 4;
/// Weights of the penalties in the final rounds. With the last, a limit that binds on one instant in fifty is exceeded by about
/// 0.3 %.
const FINAL_WEIGHTS: [f64; 2] = [3e3, 3e4];
/// Extra rounds with larger weights while the certificate reports a violated limit.
const REPAIRS: usize = 4;
/// Random candidates for each start.
const POOL: usize = 8;
/// Least share of its tightest limit that a random series uses.
const LEAST_SHARE: f64 = 0.4;

/// The best excitation of all starts, with its certificate; all its limits hold.
///
/// With `given`, that trajectory is the only start, and the result is never worse than it unless it misses a limit.
/// `progress(done, all)` is called from this thread.
///
/// Errors: an empty range, no start that keeps all limits.
pub fn optimise(
    robot: &Robot,
    config: &SearchConfig,
    given: Option<&Excitation>,
    mut progress: impl FnMut(usize, usize),
) -> Result<Excitation, Refusal> {
    let mut search = Search::new(robot, config)?;
    if given.is_none() {
        search.adapt_speed()?;
    }
    let threads = config.threads.map_or_else(cores, NonZeroUsize::get);
    let starts = match given {
        Some(excitation) => vec![search.variables(&excitation.joints)],
        None => search.starts(),
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
        |(_, variables)| search.finish(variables),
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
    let found = search.best(&results);
    if config.condition_required || found.is_ok() {
        return found;
    }
    // No start keeps the condition number: the certificates are made anew without it.
    search.config.condition_limit = f64::INFINITY;
    let again = |excitation: Excitation| search.certified(excitation);
    let results: Vec<_> = results
        .into_iter()
        .map(|result| result.and_then(again))
        .collect();
    search.best(&results)
}

/// One robot and one task, ready for any number of starts.
struct Search<'a> {
    robot: &'a Robot,
    config: SearchConfig,
    objective: Objective,
    bases: Bases,
    /// Share of the joints' velocity and acceleration limits that is used.
    speed_share: Vec<f64>,
    /// Required clearance plus a margin for the motion between the certificate's points, m.
    clearance: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(robot: &'a Robot, config: &SearchConfig) -> Result<Self, Refusal> {
        let rows = Rows::new(robot, Frames::Dh);
        let limits = Extremes::of_limits(robot, config.range_rad, LIMIT_SHARE)?;
        let clearances = Clearances::new(robot);
        for index in 0..clearances.count() {
            let (largest_m, required_m) = (clearances.upper_bound(index), clearances.required);
            if largest_m < required_m {
                let of = clearances.name(index);
                return Err(refused(format!(
                    "no path keeps all limits; in no pose is {of} clear by more than {largest_m:.3} m, asked for {required_m} m"
                )));
            }
        }
        let fastest = PerJoint::from_fn(limits.len(), |j| limits[j].qd);
        let base = clearances.required + 0.001;
        let clearance = (0..clearances.count())
            .map(|index| base + clearances.rate(index, &fastest) * HALF_STEP_S)
            .collect();
        let experiment = Experiment::new(robot, &rows);
        let parameters = rows.parameters(robot).ok_or_else(unseen)?;
        let bases = Bases::new();
        Ok(Self {
            objective: Objective {
                experiment,
                clearances,
                limits,
                torque: torques(robot, TORQUE_SHARES[0]),
                parameters,
                criterion: config.criterion,
                ln_condition_limit: (config.condition_limit * CONDITION_SHARE).ln(),
                basis: basis(&bases, config.period_s),
                rows,
            },
            robot,
            config: config.clone(),
            bases,
            speed_share: vec![1.0; robot.joint_count()],
            clearance,
        })
    }

    /// Random series of all joints from one stream of the seed.
    fn random_series(&self, stream: u64) -> Vec<JointSeries> {
        let omega = TAU / self.config.period_s;
        let mut random = ChaCha8Rng::seed_from_u64(self.config.seed);
        random.set_stream(stream);
        let limits = self.objective.limits.iter();
        limits
            .map(|limits| {
                let share = random.random_range(LEAST_SHARE..1.0);
                JointSeries::random(limits, omega, INSTANTS, share, &mut random)
            })
            .collect()
    }

    /// The best of a pool of random candidates, each drawn from its own stream of the seed.
    fn starts(&self) -> Vec<Vec<f64>> {
        let penalties = self.penalties(COARSE_WEIGHTS[0], 0.0);
        let mut pool: Vec<(f64, Vec<f64>)> = (0..self.config.starts.max(1) * POOL)
            .map(|stream| {
                let variables = self.variables(&self.random_series(stream as u64));
                let value = self.objective.value(&variables, &penalties, None);
                (value, variables)
            })
            .collect();
        // Stable: equal values keep the order of their streams.
        pool.sort_by(|a, b| a.0.total_cmp(&b.0));
        pool.truncate(self.config.starts.max(1));
        pool.into_iter().map(|(_, variables)| variables).collect()
    }

    fn variables(&self, joints: &[JointSeries]) -> Vec<f64> {
        let variables = |joint| self.bases.variables(joint);
        joints.iter().flat_map(variables).collect()
    }

    fn penalties(&self, weight: f64, extra_clearance: f64) -> PenaltyWeights {
        PenaltyWeights {
            weight,
            clearance: self.clearance.iter().map(|c| c + extra_clearance).collect(),
        }
    }

    /// Rounds with growing weights of the penalties.
    fn rounds(&self, weights: &[f64], iterations: usize, start: &[f64]) -> Vec<f64> {
        weights.iter().fold(start.to_vec(), |variables, weight| {
            let penalties = self.penalties(*weight, 0.0);
            descend(&self.objective, &penalties, variables, iterations)
        })
    }

    /// The coarse rounds of a start: value and variables at their end.
    fn coarse_search(&self, start: &[f64]) -> (f64, Vec<f64>) {
        let iterations = self.config.iterations.div_ceil(COARSE_DIVISOR);
        let variables = self.rounds(&COARSE_WEIGHTS, iterations, start);
        let last = self.penalties(COARSE_WEIGHTS[COARSE_WEIGHTS.len() - 1], 0.0);
        (self.objective.value(&variables, &last, None), variables)
    }

    /// The final rounds and the certificate; repeated with larger weights while a limit is violated.
    fn finish(&self, start: &[f64]) -> Result<Excitation, Refusal> {
        let mut variables = self.rounds(&FINAL_WEIGHTS, self.config.iterations, start);
        let mut excitation = self.certified(self.fitted(&variables))?;
        let mut objective = None;
        for repair in 1..=REPAIRS {
            let Some(certificate) = excitation.certificate.as_ref().filter(|c| !c.holds) else {
                break;
            };
            let penalties = self.penalties(
                FINAL_WEIGHTS[1] * 4.0_f64.powi(repair as i32),
                0.001 * repair as f64,
            );
            let objective = objective.get_or_insert_with(|| self.objective.clone());
            tighten(&mut objective.torque, certificate);
            variables = descend(objective, &penalties, variables, self.config.iterations);
            excitation = self.certified(self.fitted(&variables))?;
        }
        Ok(excitation)
    }

    /// The variables as a trajectory, shrunk where it exceeds the joints' limits between the instants.
    fn fitted(&self, variables: &[f64]) -> Excitation {
        let omega = TAU / self.config.period_s;
        let full = |limits: &Extremes| Extremes {
            // From the search's share back to nearly the whole limit.
            q: limits.q,
            qd: limits.qd * (1.0 - 1e-6) / LIMIT_SHARE,
            qdd: limits.qdd * (1.0 - 1e-6) / LIMIT_SHARE,
        };
        let joints = variables
            .chunks_exact(VARIABLES)
            .zip(&self.objective.limits)
            .map(|(own, limits)| self.bases.series(own).fitted(&full(limits), omega, 10_000))
            .collect();
        Excitation::of(self.robot, self.config.period_s, self.config.seed, joints)
    }

    fn certified(&self, excitation: Excitation) -> Result<Excitation, Refusal> {
        let (config, share) = (&self.config, &self.speed_share);
        let certificate = certify(self.robot, &excitation, &self.objective, config, share)?;
        Ok(Excitation {
            certificate: Some(Box::new(certificate)),
            ..excitation
        })
    }

    /// The best result that holds; the first of equals.
    fn best(&self, results: &[Result<Excitation, Refusal>]) -> Result<Excitation, Refusal> {
        let score = |certificate: &Certificate| match self.config.criterion {
            Criterion::Condition => certificate.condition_number_dh,
            Criterion::DOptimal => certificate.ln_spread,
            Criterion::VOptimal | Criterion::Constrained => certificate.predicted_nrmse_percent,
        };
        let certified = results.iter().flatten();
        let certified = certified.filter_map(|found| Some((found, found.certificate.as_deref()?)));
        let (kept, missed): (Vec<_>, Vec<_>) =
            certified.partition(|(_, certificate)| certificate.holds);
        let best = kept.iter().min_by(|a, b| score(a.1).total_cmp(&score(b.1)));
        if let Some((excitation, _)) = best {
            return Ok((*excitation).clone());
        }
        let missed = missed.iter().filter_map(|(_, missed)| missed.violation());
        let nearest = missed.min_by(|a, b| a.0.total_cmp(&b.0));
        let nearest = nearest.map(|(_, refusal)| refusal);
        let last = results
            .iter()
            .rev()
            .find_map(|result| result.as_ref().err());
        Err(nearest.or_else(|| last.cloned()).unwrap_or_else(unseen))
    }
}

/// Lowers the torques that the search allows by what the certificate reached beyond a limit: it takes friction of either sign,
/// and bounds between its points.
fn tighten(torque: &mut [f64], certificate: &Certificate) {
    let checks = certificate.limits.iter();
    let checks = checks.filter(|check| check.limit == "torque");
    for (torque, check) in torque.iter_mut().zip(checks) {
        *torque *= (check.allowed / check.worst).min(1.0);
    }
}

#[cfg(test)]
mod tests;
