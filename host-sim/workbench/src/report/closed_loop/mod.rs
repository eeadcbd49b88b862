//! A closed-loop run: figures, curves, and the page that shows them.

mod health;
mod page;

pub use health::{DecisionRecord, LearntRecord};
pub use page::page;

use crate::closed_loop::TickRecord;
use crate::dynamics::Joints;
use crate::metrics::TrackingError;
use crate::robot::Robot;
use foretorque::limits::Flags;
use foretorque_link::safety::SafetyStatus;
use foretorque_link::store::StoreHealth;
use foretorque_link::telemetry::{Cost, Statistics};
use foretorque_link::wire::TelemetryFrame;
use health::Health;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Points a curve keeps.
const PAGE_POINTS: usize = 4000;

/// Flags of the torque that report a limit or a fault, with their meanings.
const FLAGS: [(Flags, &str); 13] = [
    (Flags::SATURATED, "torque cut to its limit"),
    (Flags::SLEWED, "torque held back by its slew limit"),
    (Flags::NETWORK_CLIPPED, "network share cut to its bound"),
    (Flags::LEARNED_CLIPPED, "learnt change cut to its bound"),
    (Flags::STALE_SAMPLE, "no usable sample in time"),
    (
        Flags::SHARE_FALLBACK,
        "committed share stood in for a bad one",
    ),
    (Flags::NOT_FINITE, "a number was not finite"),
    (Flags::SET_LATE, "learnt set came late"),
    (Flags::DESIRED_CLAMPED, "desired motion cut to its limits"),
    (Flags::NO_MEASUREMENT, "sample without measurement"),
    (Flags::WITHDRAWN, "torque on its way to zero"),
    (Flags::PAYLOAD_CLIPPED, "payload's torque cut to its bound"),
    (Flags::GRAVITY_LOST, "nothing carries a joint"),
];

/// The figures of `report.json`. Nothing in it depends on the clock on the wall.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClosedLoopReport {
    /// The run.
    #[serde(flatten)]
    pub run: RunDescription,
    /// Ticks played.
    pub ticks: usize,
    /// Everything that kept the arm from its torque or motion, the gravest first.
    pub troubles: Vec<String>,
    /// Learning in the run.
    pub learnt: LearntRecord,
    /// RMS position error, mean of the joints, mrad.
    pub tracking_rms_mrad: f64,
    /// RMS tracking error of each joint, mrad.
    pub tracking_rms_joint_mrad: Vec<f64>,
    /// Largest position error of every joint, mrad.
    pub tracking_peak_joint_mrad: Vec<f64>,
    /// RMS torque asked of every drive, N·m.
    pub torque_rms_nm: Vec<f64>,
    /// Largest torque asked of every drive, N·m.
    pub torque_peak_nm: Vec<f64>,
    /// RMS feed-forward torque of every joint, N·m.
    pub feed_forward_rms_nm: Vec<f64>,
    /// Ticks that carried each flag; flags that never rose are left out.
    pub flag_ticks: BTreeMap<&'static str, usize>,
    /// Counters of the link, kept by the board.
    pub link: LinkReport,
    /// Learnt sets that came late.
    pub late_sets: u32,
    /// Learning samples lost to a full queue.
    pub learning_samples_lost: u32,
    /// State of the board's store.
    pub store: StoreHealth,
    /// Cost of a tick, counts of the board's counter; 0 where it has none.
    pub tick_cost: BoardCost,
    /// Cost of learning from one tick, likewise.
    pub learning_cost: BoardCost,
}

/// Description of a closed-loop run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunDescription {
    /// Name of the robot.
    pub robot: String,
    /// The board.
    pub board: String,
    /// Seed of plant, noise and validation path.
    pub seed: u64,
    /// Period of the tick, s.
    pub period_s: f64,
    /// Compiler of the board's code.
    pub toolchain: String,
    /// The board learnt while it ran.
    pub learning: bool,
    /// From the board's first instructions to its hello, µs; nothing where its counter is no clock.
    pub boot_us: Option<u32>,
}

/// Mean and largest cost, counts of the board's counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct BoardCost {
    /// Mean.
    pub mean: u32,
    /// Largest.
    pub max: u32,
}

impl From<Cost> for BoardCost {
    fn from(Cost { mean, max }: Cost) -> Self {
        Self { mean, max }
    }
}

/// Counters of the link: key in `report.json`, name on the page, count; good frames first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkReport([(&'static str, &'static str, u32); 8]);

impl From<&Statistics> for LinkReport {
    fn from(counted: &Statistics) -> Self {
        Self([
            ("frames", "good frames", counted.frames),
            ("crc_errors", "wrong checksum", counted.crc_errors),
            (
                "framing_errors",
                "cut short or too long",
                counted.framing_errors,
            ),
            (
                "foreign_version",
                "other protocol version",
                counted.foreign_version,
            ),
            ("unknown", "unknown message", counted.unknown),
            ("missed", "missing", counted.missed),
            ("repeated", "repeated or late", counted.repeated),
            (
                "overruns",
                "missed deadlines and overruns",
                counted.overruns,
            ),
        ])
    }
}

impl Serialize for LinkReport {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(key, _, count)| (key, count)))
    }
}

impl LinkReport {
    /// Bad, missing and unknown frames, missed deadlines and overruns.
    pub fn errors(&self) -> u32 {
        self.0[1..].iter().map(|(_, _, count)| count).sum()
    }
}

/// Gathers a closed-loop run tick by tick.
#[derive(Clone, Debug)]
pub struct ClosedLoopLog<const N: usize> {
    every: usize,
    rounds: usize,
    seen: usize,
    health: Health<N>,
    points: Vec<Point<N>>,
    /// Shares of one joint: time, s, and rigid body, friction, network, N·m.
    shares: [Vec<(f64, [f64; 3])>; N],
    flags: [usize; FLAGS.len()],
    tracking: TrackingError<N>,
    peak_mrad: Joints<N>,
    square_tau: Joints<N>,
    peak_tau: Joints<N>,
    square_feed: Joints<N>,
}

#[derive(Clone, Copy, Debug)]
struct Point<const N: usize> {
    t_s: f64,
    error_mrad: Joints<N>,
    tau: Joints<N>,
    feed_forward: Joints<N>,
}

impl<const N: usize> ClosedLoopLog<N> {
    /// For a run of `robot` over `ticks`.
    pub fn new(robot: &Robot, ticks: usize) -> Self {
        Self {
            every: (ticks / PAGE_POINTS).max(1),
            rounds: (ticks / N / PAGE_POINTS).max(1),
            seen: 0,
            health: Health::new(robot),
            points: Vec::new(),
            shares: std::array::from_fn(|_| Vec::new()),
            flags: [0; FLAGS.len()],
            tracking: TrackingError::default(),
            peak_mrad: Joints::zeros(),
            square_tau: Joints::zeros(),
            peak_tau: Joints::zeros(),
            square_feed: Joints::zeros(),
        }
    }

    /// Takes one tick.
    ///
    /// * `safety` state of the board; none without one
    /// * `started` torque of the parameters that the run began with, for the desired motion, N·m
    pub fn add(
        &mut self,
        record: &TickRecord<N>,
        safety: Option<SafetyStatus>,
        started: Option<&Joints<N>>,
    ) {
        self.health.add(record, safety, started);
        let error = record.desired.q - record.q;
        let feed_forward: Joints<N> = record.feed_forward.cast();
        self.tracking.add(&error);
        self.peak_mrad = self.peak_mrad.sup(&(error.abs() * 1e3));
        self.square_tau += record.tau.component_mul(&record.tau);
        self.peak_tau = self.peak_tau.sup(&record.tau.abs());
        self.square_feed += feed_forward.component_mul(&feed_forward);
        for (count, (flag, _)) in self.flags.iter_mut().zip(FLAGS) {
            *count += usize::from(Flags(record.flags).contains(flag));
        }
        if self.seen.is_multiple_of(self.every) {
            self.points.push(Point {
                t_s: record.t_s,
                error_mrad: error * 1e3,
                tau: record.tau,
                feed_forward,
            });
        }
        // A reply carries the shares of one joint, the next one's in the next tick: whole rounds are kept, or dropped.
        if (self.seen / N).is_multiple_of(self.rounds) {
            for (joint, curve) in self.shares.iter_mut().enumerate() {
                let shares = record.shares.and_then(|shares| shares.of(joint));
                curve.extend(shares.map(|shares| (record.t_s, shares.map(f64::from))));
            }
        }
        self.seen += 1;
    }

    /// Takes telemetry with trust and decisions, from records `every` ticks apart.
    pub fn take(&mut self, frames: &[TelemetryFrame], every: u16, period_s: f64) {
        self.health
            .take(frames, f64::from(every) * period_s, period_s);
    }

    /// Everything that kept the arm from its torque or motion, the gravest first.
    pub fn troubles(&self) -> Vec<String> {
        self.health.troubles()
    }

    /// RMS tracking error of every joint, mrad.
    pub fn tracking_rms_mrad(&self) -> Vec<f64> {
        self.tracking.rms_mrad()
    }

    /// The figures of the run, with the statistics of its board at the end.
    pub fn report(&self, run: RunDescription, statistics: &Statistics) -> ClosedLoopReport {
        let joints = |values: &Joints<N>| values.iter().copied().collect();
        let flags = FLAGS.iter().zip(self.flags).filter(|(_, count)| *count > 0);
        ClosedLoopReport {
            run,
            ticks: self.seen,
            troubles: self.health.troubles(),
            learnt: self.health.learnt(),
            tracking_rms_mrad: self.tracking.mean_rms_mrad(),
            tracking_rms_joint_mrad: self.tracking.rms_mrad(),
            tracking_peak_joint_mrad: joints(&self.peak_mrad),
            torque_rms_nm: self.root_mean(&self.square_tau),
            torque_peak_nm: joints(&self.peak_tau),
            feed_forward_rms_nm: self.root_mean(&self.square_feed),
            flag_ticks: flags
                .map(|((flag, _), count)| (flag.name(), count))
                .collect(),
            link: LinkReport::from(statistics),
            late_sets: statistics.late_sets,
            learning_samples_lost: statistics.learning_samples_lost,
            store: statistics.store,
            tick_cost: statistics.tick_cost.into(),
            learning_cost: statistics.learn_cost.into(),
        }
    }

    fn root_mean(&self, squares: &Joints<N>) -> Vec<f64> {
        let count = self.seen.max(1) as f64;
        squares.iter().map(|sum| (sum / count).sqrt()).collect()
    }
}
