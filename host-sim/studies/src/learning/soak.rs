//! Ten million ticks of learning: nothing overflows, nothing drifts away, and the board gives the same bits.

use super::PERIOD_S;
use super::twin::{CHUNK, N, P, Set, twin};
use crate::{Outcome, Progress, StudyError, bank_of, unsupported};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::evaluate;
use foretorque::joint::{JointMeasurement, JointSample};
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::board::{Client, Native, Transport};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::metrics::TorqueError;
use foretorque_workbench::parallel::use_every_core;
use foretorque_workbench::plant::{Events, Payload, Plant, PlantConfig};
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::via::ViaPath;
use foretorque_workbench::trajectory::{Trajectory, VALIDATION_PEAK_RAD_S};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::rc::Rc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Lengths of the soak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoakConfig {
    /// Seed of arm, prior, path and noise.
    pub seed: u64,
    /// Ticks of the native run.
    pub ticks: usize,
    /// Ticks that are compared with the board.
    pub board_ticks: usize,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SoakReport {
    /// Version of this program.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Ticks of the native run.
    pub ticks_count: usize,
    /// Ticks with a torque or a parameter that was not finite.
    pub not_finite_ticks_count: usize,
    /// Smallest entry of the covariance's diagonal factor, in units of the prior's variance.
    pub least_diagonal_ratio: f64,
    /// Largest distance of the estimator from its twin in f64, prior standard deviations.
    pub twin_distance_worst_prior_sigmas: f64,
    /// Rows of that comparison.
    pub twin_rows_count: usize,
    /// Sets that were not there in time.
    pub late_sets_count: u32,
    /// Error on the unseen path at the end, moving rows.
    pub last_nrmse_moving_percent: f64,
    /// Decisions of the supervisor by reason.
    pub decisions_count: BTreeMap<String, u32>,
    /// Ticks compared with the board, and those in which a torque had other bits.
    pub board_ticks_count: usize,
    /// See above.
    pub board_ticks_with_other_bits_count: usize,
}

impl SoakReport {
    /// The counts that must be zero; `None` where they are.
    pub fn failure(&self) -> Option<String> {
        let not_finite = self.not_finite_ticks_count;
        let other_bits = self.board_ticks_with_other_bits_count;
        (not_finite + other_bits > 0).then(|| {
            format!("{not_finite} ticks are not finite, {other_bits} have other bits on the board")
        })
    }
}

/// The arm of a seed.
struct Setup {
    seed: u64,
    /// The arm as described.
    described: Robot,
    /// The arm as it is.
    truth: Robot,
    /// The wrong prior: inertias 20 % and friction 40 % off.
    wrong: ParameterBank,
}

impl Setup {
    fn new(seed: u64) -> Result<Self, StudyError> {
        let described = Robot::load("ur5")?;
        let truth = described.perturbed(seed);
        let wrong = truth.wrong_prior(seed.wrapping_add(1));
        Ok(Self {
            seed,
            described,
            truth,
            wrong: bank_of::<Ur5, N, P>(&wrong),
        })
    }

    /// Torque error of `set` on moving rows of a path that is never played, by what `plant` needs there.
    fn unseen_error(&self, set: &Set, plant: &Plant<N>) -> f64 {
        let unseen = Trajectory::<N>::validation(&self.described, self.seed.wrapping_add(2));
        let mut error = TorqueError::default();
        for k in 0..UNSEEN_POINTS {
            let state = unseen.at(k as f64 / UNSEEN_POINTS as f64 * unseen.duration_s());
            let predicted = evaluate::<Ur5, N, P>(set, &motion_f32(&state)).total;
            error.add(&plant.true_torque(&state), &predicted.cast(), &state.qd);
        }
        error.nrmse_moving()
    }
}

const UNSEEN_POINTS: usize = 250;
/// Length of the path and of the standstill behind it, s; then it begins anew.
const PATH_S: f64 = 590.0;
const ROUND_S: f64 = 600.0;
/// In every so many seconds a payload of 2 kg is held for the last ten.
const PAYLOAD_EVERY_S: f64 = 40.0;
/// Centre of mass of the payload in the frame of the last link, m: 5 cm beyond the flange and aside.
const PAYLOAD_COM_M: [f64; 3] = [0.02, -0.01, 0.0823 + 0.05];

/// An arm that does exactly what it should, and reports it with noise.
struct Source<'w> {
    setup: &'w Setup,
    path: Trajectory<N>,
    arms: [Plant<N>; 2],
    random: ChaCha8Rng,
    tick: usize,
    /// The arm as it was at the last sample: without or with a payload.
    arm: usize,
}

impl<'w> Source<'w> {
    fn new(setup: &'w Setup) -> Result<Self, StudyError> {
        let noise = setup.seed.wrapping_mul(1000);
        let plant = Plant::new(&setup.truth, PlantConfig::default(), noise);
        let plant = plant.ok_or_else(|| unsupported(N))?;
        let seed = setup.seed.wrapping_add(203);
        let path = ViaPath::random(&setup.described, seed, PATH_S, VALIDATION_PEAK_RAD_S);
        let payload = Payload::cube(2.0, PAYLOAD_COM_M, 0.0, f64::INFINITY);
        let loaded = plant.clone().with_events(Events {
            payloads: vec![payload],
            pushes: Vec::new(),
        });
        Ok(Self {
            setup,
            path: Trajectory::Via(path),
            arms: [plant, loaded],
            random: ChaCha8Rng::seed_from_u64(setup.seed),
            tick: 0,
            arm: 0,
        })
    }

    fn next(&mut self) -> JointSample<N> {
        let t_s = (self.tick as f64 * PERIOD_S) % ROUND_S;
        self.tick += 1;
        let wanted = self.path.at(t_s);
        self.arm = usize::from(t_s % PAYLOAD_EVERY_S > PAYLOAD_EVERY_S - 10.0);
        let torque = self.arms[self.arm].true_torque(&wanted);
        let count = TAU / 131_072.0;
        let joints = &self.setup.described.joints;
        let noisy = |j: usize| {
            let noise = self.random.sample::<f64, _>(StandardNormal);
            (torque[j] + 0.01 * joints[j].limits.torque * noise) as f32
        };
        let measured = JointMeasurement {
            q: wanted.q.map(|q| ((q / count).round() * count) as f32),
            tau: std::array::from_fn(noisy).into(),
        };
        // The path begins anew somewhere else: what is measured does not join on.
        let joins = t_s > 0.0;
        JointSample {
            desired: motion_f32(&wanted),
            measured: joins.then_some(measured),
        }
    }
}

/// Runs it; a part of it on `board` too, where there is one.
///
/// Errors: the board's.
pub fn run(
    config: &SoakConfig,
    board: Option<&mut Client<N>>,
    progress: Progress<'_>,
) -> Result<Outcome<SoakReport>, StudyError> {
    let setup = Setup::new(config.seed)?;
    let board_ticks = board.as_ref().map_or(0, |_| config.board_ticks);
    let all = 2 * config.ticks + board_ticks;
    let done = AtomicUsize::new(0);
    let advance = || {
        let before = done.fetch_add(CHUNK, Ordering::Relaxed);
        progress("ticks", (before + CHUNK).min(all), all);
    };
    let (native, twin, other_bits) = std::thread::scope(|scope| {
        let native = scope.spawn(|| {
            use_every_core();
            native(&setup, config.ticks, &advance)
        });
        let twin = scope.spawn(|| {
            use_every_core();
            let mut source = Source::new(&setup)?;
            let samples = (0..config.ticks).map(|_| source.next());
            let prior = setup.wrong.set::<Ur5, N, P>()?;
            Ok::<_, StudyError>(twin(&prior, samples, &advance))
        });
        let other_bits = match board {
            Some(board) => on_board(&setup, board, board_ticks, &advance),
            None => Ok(0),
        };
        (native.join(), twin.join(), other_bits)
    });
    let (twin_distance, twin_rows) = twin.map_err(|_| stopped("the twin"))??;
    let mut report = native.map_err(|_| stopped("the native run"))??;
    report.twin_distance_worst_prior_sigmas = twin_distance;
    report.twin_rows_count = twin_rows;
    report.board_ticks_count = board_ticks;
    report.board_ticks_with_other_bits_count = other_bits?;
    outcome(report)
}

fn stopped(what: &str) -> StudyError {
    StudyError::from(format!("{what} stopped"))
}

fn outcome(report: SoakReport) -> Result<Outcome<SoakReport>, StudyError> {
    let values = serde_json::to_value(&report)?;
    let rows = values.as_object().into_iter().flatten();
    let rows = rows.map(|(name, value)| [name.clone(), value.to_string()]);
    let rows: Vec<[String; 2]> = rows.collect();
    let text = rows
        .iter()
        .map(|[name, value]| format!("{name:<34} {value}\n"));
    let text = text.collect();
    let lead = "Long learning without overflow, drift or a difference in bits.";
    let section = Section::new("Figures", "The unit is the end of the name.");
    let section = section.table("figure | value", rows);
    Ok(Outcome {
        text,
        page: Page::new("Soak", lead).sections([section]),
        broken: report.failure(),
        report,
    })
}

/// Gives `board` the wrong prior and arms it at the begin of the path, learning.
fn begin(source: &Source<'_>, board: &mut Client<N>) -> Result<(), StudyError> {
    board.reset()?;
    board.upload_bank(&source.setup.wrong)?;
    board.learning(true)?;
    let desired = motion_f32(&source.path.at(0.0));
    let tau = board.evaluate(&desired)?.total;
    let measured = Some(JointMeasurement { q: desired.q, tau });
    Ok(board.arm(&JointSample { desired, measured })?)
}

fn client(native: impl Transport + 'static) -> Result<Client<N>, StudyError> {
    let boot = Duration::from_secs(1);
    Ok(Client::connect::<Ur5, P>(Box::new(native), boot)?)
}

/// The board's code in this process.
fn native(setup: &Setup, ticks: usize, advance: &dyn Fn()) -> Result<SoakReport, StudyError> {
    let mut source = Source::new(setup)?;
    let native = Rc::new(RefCell::new(Native::<Ur5, N, P>::new()?));
    let mut board = client(Rc::clone(&native))?;
    begin(&source, &mut board)?;
    let (mut not_finite, mut least) = (0, f64::INFINITY);
    let (mut decided, mut decisions) = (0, BTreeMap::<String, u32>::new());
    for tick in 0..ticks {
        let torque = board.sample(&source.next())?.total;
        let native = native.borrow();
        let feed_forward = native.session.feed_forward();
        let finite = torque.iter().all(|tau| tau.is_finite());
        not_finite += usize::from(!(finite && feed_forward.in_force().is_finite()));
        let log = &feed_forward.state().report.decisions;
        for decision in (decided..log.count()).filter_map(|index| log.get(index)) {
            let reason = format!("{:?}", decision.reason);
            *decisions.entry(reason).or_default() += 1;
        }
        decided = log.count();
        if tick % CHUNK == CHUNK - 1 {
            let diagonal = native.learner.state().estimate.filter().diagonal();
            // Not a number would get lost in a minimum.
            let finite = |d: f32| if d.is_finite() { f64::from(d) } else { -1.0 };
            least = diagonal.iter().map(|&d| finite(d)).fold(least, f64::min);
            advance();
        }
    }
    let native = native.borrow();
    let feed_forward = native.session.feed_forward();
    let error = setup.unseen_error(&feed_forward.in_force(), &source.arms[source.arm]);
    Ok(SoakReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: setup.seed,
        ticks_count: ticks,
        not_finite_ticks_count: not_finite,
        least_diagonal_ratio: least,
        twin_distance_worst_prior_sigmas: f64::NAN,
        twin_rows_count: 0,
        late_sets_count: feed_forward.state().late_sets,
        last_nrmse_moving_percent: 100.0 * error,
        decisions_count: decisions,
        board_ticks_count: 0,
        board_ticks_with_other_bits_count: 0,
    })
}

/// Plays the samples through `board`. Returns the ticks in which a torque had other bits than the native one.
fn on_board(
    setup: &Setup,
    board: &mut Client<N>,
    ticks: usize,
    advance: &dyn Fn(),
) -> Result<usize, StudyError> {
    let mut source = Source::new(setup)?;
    let mut native = client(Native::<Ur5, N, P>::new()?)?;
    begin(&source, &mut native)?;
    begin(&source, board)?;
    let mut other = 0;
    for tick in 0..ticks {
        let sample = source.next();
        let [here, there] = [native.sample(&sample)?, board.sample(&sample)?];
        other += usize::from(here.total.map(f32::to_bits) != there.total.map(f32::to_bits));
        if tick % CHUNK == CHUNK - 1 {
            advance();
        }
    }
    board.learning(false)?;
    Ok(other)
}
