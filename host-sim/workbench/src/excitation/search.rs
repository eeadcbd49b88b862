//! The search: seeded starts, a quasi-Newton method with growing penalty weights, a certificate for each result.

use super::certificate::{Certificate, certify};
use super::clearance::Clearances;
use super::information::{Criterion, Experiment, SIGN_WIDTH_RAD_S as SIGN_WIDTH};
use super::objective::{INSTANTS, Objective, SearchConfig, basis, descend};
use super::rows::{Frames, Rows};
use super::series::{Bases, Extremes, JointSeries, VARIABLES};
use super::{Excitation, refused, unseen};
use crate::Refusal;
use crate::dynamics::PerJoint;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use crate::trajectory::via::TORQUE_SHARE;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
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

/// Random series by which feasible speeds are found, and instants of each.
const TRIALS: usize = 256;
const TRIAL_INSTANTS: usize = 50;
/// Factor on the speed of a joint whose torque is too large, and steps before a joint counts as too weak: to 2 %.
const SLOWER: f64 = 0.7;
const SLOWDOWNS: usize = 12;
/// Shares of the torque limits for the described arm: the true one may be a quarter heavier; and where that leaves no path,
/// what bounds on the rates between points leave.
const TORQUE_SHARES: [f64; 2] = [TORQUE_SHARE, 0.9];

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
    let mut searched = |search: &Search<'_>| {
        let mut done = 0;
        progress(done, all);
        let mut count = || {
            done += 1;
            progress(done, all);
        };
        let coarse_search = |start: &Vec<f64>| search.coarse_search(start);
        let mut coarse = in_parallel(threads, &starts, coarse_search, &mut count);
        // Stable: equal values keep the order of their starts.
        coarse.sort_by(|a, b| a.0.total_cmp(&b.0));
        coarse.truncate(finalists);
        let finish = |(_, variables): &(f64, Vec<f64>)| search.finish(variables);
        let mut results = in_parallel(threads, &coarse, finish, &mut count);
        if let Some(excitation) = given {
            let kept = Excitation {
                seed: config.seed,
                certificate: None,
                ..excitation.clone()
            };
            results.insert(0, search.certified(kept));
        }
        search.best(&results)
    };
    let found = searched(&search);
    if config.condition_required || found.is_ok() {
        return found;
    }
    // No start keeps the condition number: a search for it breaks other limits, so it is made anew without.
    search.config.condition_limit = f64::INFINITY;
    search.objective.ln_condition_limit = f64::INFINITY;
    searched(&search)
}

/// One robot and one task, ready for any number of starts.
struct Search<'a> {
    robot: &'a Robot,
    config: SearchConfig,
    objective: Objective,
    bases: Bases,
    /// Share of the joints' velocity and acceleration limits that is used.
    speed_share: Vec<f64>,
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
        let required = |index| base + clearances.rate(index, &fastest) * HALF_STEP_S;
        let required_m = (0..clearances.count()).map(required).collect();
        let experiment = Experiment::new(robot, &rows);
        let parameters = rows.parameters(robot).ok_or_else(unseen)?;
        let bases = Bases::new();
        Ok(Self {
            objective: Objective {
                experiment,
                required_m,
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
        let mut pool: Vec<(f64, Vec<f64>)> = (0..self.config.starts.max(1) * POOL)
            .map(|stream| {
                let variables = self.variables(&self.random_series(stream as u64));
                let value = self.objective.value(&variables, COARSE_WEIGHTS[0], None);
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

    /// Rounds with growing weights of the penalties.
    fn rounds(&self, weights: &[f64], iterations: usize, start: &[f64]) -> Vec<f64> {
        weights.iter().fold(start.to_vec(), |variables, weight| {
            descend(&self.objective, *weight, variables, iterations)
        })
    }

    /// The coarse rounds of a start: value and variables at their end.
    fn coarse_search(&self, start: &[f64]) -> (f64, Vec<f64>) {
        let iterations = self.config.iterations.div_ceil(COARSE_DIVISOR);
        let variables = self.rounds(&COARSE_WEIGHTS, iterations, start);
        let last = COARSE_WEIGHTS[COARSE_WEIGHTS.len() - 1];
        (self.objective.value(&variables, last, None), variables)
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
            let weight = FINAL_WEIGHTS[1] * 4.0_f64.powi(repair as i32);
            let objective = objective.get_or_insert_with(|| self.objective.clone());
            tighten(&mut objective.torque, certificate);
            // Each repair requires 1 mm more distance than the one before.
            let required_m = self.objective.required_m.iter();
            objective.required_m = required_m.map(|m| m + 0.001 * repair as f64).collect();
            variables = descend(objective, weight, variables, self.config.iterations);
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
        if let Some((_, refusal)) = nearest {
            return Err(refusal);
        }
        let mut errors = results.iter().rev();
        let last = errors.find_map(|result| result.as_ref().err());
        Err(last.cloned().unwrap_or_else(unseen))
    }

    /// Slows the joints whose torque limits allow no motion at full speed, until one of [`TRIALS`] random series keeps all of
    /// them. Gravity, friction and inertia are those of the description.
    ///
    /// Errors: a line that names the joints that need more however slow they are.
    fn adapt_speed(&mut self) -> Result<(), Refusal> {
        let full = self.objective.limits.clone();
        for torque_share in TORQUE_SHARES {
            self.objective.torque = torques(self.robot, torque_share);
            self.objective.limits.clone_from(&full);
            self.speed_share.fill(1.0);
            for _ in 0..SLOWDOWNS {
                let needed = self.least_torques();
                let share = |j: usize| needed[j] / self.objective.torque[j];
                if (0..full.len()).all(|j| share(j) <= 1.0) {
                    return Ok(());
                }
                for (j, limits) in full.iter().enumerate() {
                    // The joints before a weak one shake it, too: they slow down half as much.
                    let beyond = (j + 1..full.len()).any(|k| share(k) > 1.0);
                    let factor = match (share(j) > 1.0, beyond) {
                        (true, _) => SLOWER,
                        (false, true) => SLOWER.sqrt(),
                        (false, false) => 1.0,
                    };
                    self.speed_share[j] *= factor;
                    let speed = self.speed_share[j];
                    self.objective.limits[j].qd = limits.qd * speed;
                    self.objective.limits[j].qdd = limits.qdd * speed;
                }
            }
        }
        let needed = self.least_torques();
        let joints = self.robot.joints.iter().zip(needed.iter());
        let weak = joints.zip(self.objective.torque.iter());
        let weak = weak.filter(|((_, needed), allowed)| needed > allowed);
        let weak = weak.map(|((joint, needed), allowed)| {
            format!(
                "joint '{}' needs {needed:.3} N·m even where it hardly moves, of which {:.3} N·m are friction, its limit is {} N·m and leaves {allowed:.3} N·m for the motion",
                joint.name, joint.friction.coulomb, joint.limits.torque
            )
        });
        let weak = weak.collect::<Vec<_>>().join("; ");
        let refused = || refused(format!("{weak}: correct it with --torque-limits"));
        weak.is_empty().then_some(()).ok_or_else(refused)
    }

    /// Largest torque of every joint, N·m, on the random series that comes nearest to keeping all torque limits.
    fn least_torques(&self) -> PerJoint<f64> {
        let Objective {
            rows, parameters, ..
        } = &self.objective;
        let joints = rows.joints();
        let mut best = (f64::INFINITY, PerJoint::repeat(joints, f64::INFINITY));
        for trial in 0..TRIALS {
            let (period_s, series) = (self.config.period_s, self.random_series(trial as u64));
            let excitation = Excitation::of(self.robot, period_s, self.config.seed, series);
            let instants = excitation.instants(TRIAL_INSTANTS);
            let torques = rows.transposed(&instants, SIGN_WIDTH).tr_mul(parameters);
            let most = PerJoint::from_fn(joints, |j| {
                let own = torques.iter().skip(j).step_by(joints);
                own.fold(0.0_f64, |most, tau| most.max(tau.abs()))
            });
            let shares = most.iter().zip(self.objective.torque.iter());
            let share = shares.fold(0.0_f64, |worst, (tau, limit)| worst.max(tau / limit));
            if share < best.0 {
                best = (share, most);
            }
        }
        best.1
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

/// Torque that friction leaves each joint of `share` of its limit, N·m; a tenth of the limit at least.
fn torques(robot: &Robot, share: f64) -> PerJoint<f64> {
    PerJoint::from_fn(robot.joint_count(), |j| {
        let (friction, limit) = (&robot.joints[j].friction, robot.joints[j].limits.torque);
        let beyond = friction.coulomb * friction.stribeck_ratio + friction.cogging;
        (share * limit - beyond).max(0.1 * limit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_agrees_with_central_differences() {
        let robot = Robot::load("ur5").expect("built in");
        use Criterion::{Condition, Constrained, DOptimal, VOptimal};
        for criterion in [Condition, DOptimal, VOptimal, Constrained] {
            let config = SearchConfig {
                criterion,
                starts: 1,
                ..SearchConfig::default()
            };
            let search = Search::new(&robot, &config).expect("a search");
            let start = search.starts().remove(0);
            // Beyond the limits, so that every penalty takes part.
            let start: Vec<f64> = start.iter().map(|x| 1.3 * x).collect();
            let mut gradient = vec![0.0; start.len()];
            let objective = &search.objective;
            objective.value(&start, 10.0, Some(&mut gradient));
            let size = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
            for (v, found) in gradient.iter().enumerate() {
                let h = 1e-5;
                let at = |step: f64| {
                    let mut moved = start.clone();
                    moved[v] += step;
                    objective.value(&moved, 10.0, None)
                };
                let expected = (at(h) - at(-h)) / (2.0 * h);
                let close = (found - expected).abs() < 1e-4 * size;
                assert!(close, "{criterion:?}, variable {v}: {found} {expected}");
            }
        }
    }

    #[test]
    fn joints_slow_down_to_what_friction_leaves_and_a_weak_one_is_named() {
        let config = SearchConfig::default();
        let adapted = |robot: &Robot| {
            let mut search = Search::new(robot, &config).expect("a search");
            let found = search.adapt_speed();
            (found, search.speed_share)
        };
        let mut robot = Robot::load("ur5").expect("built in");
        assert_eq!(adapted(&robot), (Ok(()), vec![1.0; 6]));
        // At the speed limit friction alone would take four times the torque limit.
        let limits = robot.joints[2].limits;
        robot.joints[2].friction.viscous = 4.0 * limits.torque / limits.velocity;
        let (found, shares) = adapted(&robot);
        assert_eq!(found, Ok(()));
        let slower = shares[2] < 1.0 && shares[2] > 0.1 && shares[5] == 1.0;
        assert!(slower, "{shares:?}");
        // Gravity at the shoulder and at the elbow.
        robot.joints[1].limits.torque = 1.0;
        robot.joints[2].limits.torque = 0.5;
        let message = adapted(&robot).0.expect_err("too weak").to_string();
        for (joint, limit) in robot.joints[1..3].iter().zip(["1", "0.5"]) {
            let limit = format!("its limit is {limit} N·m and leaves 0.");
            let named = message.contains(&limit) && message.contains(&joint.name);
            assert!(named, "{message}");
        }
        let end = " N·m for the motion: correct it with --torque-limits";
        assert!(message.ends_with(end), "{message}");
    }

    #[test]
    fn friction_of_half_a_torque_limit_leaves_a_path() {
        let mut robot = Robot::load("ur5").expect("built in");
        // Friction that helps to brake: the certificate does not count on it.
        robot.joints[5].friction.coulomb = 0.5 * robot.joints[5].limits.torque;
        robot.joints[4].friction.coulomb = 0.5 * robot.joints[4].limits.torque;
        let config = SearchConfig {
            starts: 4,
            iterations: 40,
            condition_required: false,
            ..SearchConfig::default()
        };
        let found = optimise(&robot, &config, None, |_, _| {}).expect("a path");
        assert!(found.certificate.expect("certified").holds);
    }
}
