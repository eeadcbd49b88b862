//! Estimators side by side on the same rows, and what more rows a tick buy.

use super::baselines::{Firmware, Nlms, Rls, RowEstimator};
use super::controller::Controller;
use super::scenario::PAYLOAD_COM_M;
use super::world::{N, P, PERIOD_S, World};
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::evaluate;
use foretorque::joint::JointVector;
use foretorque::learning::{
    ConditionedSample, DELAY, LinearParameters, MeasurementWindow, cogging_attenuation, torque_row,
};
use foretorque_workbench::closed_loop::{Answer, ClosedLoop};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::parallel::{cores, in_parallel};
use foretorque_workbench::plant::{Events, Payload, PlantConfig};
use foretorque_workbench::trajectory::Trajectory;
use serde::Serialize;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::error::Error;

/// How one estimator did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MethodReport {
    /// Rows a tick.
    pub rows_a_tick_count: usize,
    /// Multiply-adds of the estimator a tick, to leading order.
    pub multiply_adds_a_tick_count: usize,
    /// From when on the error on the unseen path stays below 2 %, s; `null` if never.
    pub stays_below_2_percent_s: f64,
    /// The same for 1 %.
    pub stays_below_1_percent_s: f64,
    /// Error after a minute of task, and after a minute of standstill behind it, moving rows.
    pub after_task_nrmse_moving_percent: f64,
    /// See above.
    pub after_standstill_nrmse_moving_percent: f64,
    /// Time after a 3 kg payload is picked until the error is below a tenth of its torque, without any detector, s;
    /// `null` if not within 45 s.
    pub payload_3kg_to_10_percent_s: f64,
    /// Time, s, and error on the unseen path while the task is learnt.
    pub nrmse_moving_percent: Vec<(f64, f64)>,
}

/// Length of task and standstill, s; of the part with the payload, and when it is picked.
const TASK_S: f64 = 60.0;
const STILL_S: f64 = 60.0;
const LOADED_S: f64 = 60.0;
const PICK_S: f64 = 15.0;
/// Ticks between two looks.
const LOOK: usize = 100;

/// An instant as the board's filter shows it, and the torques of that tick alone.
struct Instant {
    seen: ConditionedSample<N>,
    raw: JointVector<N>,
}

/// A closed-loop run as rows, with the truth at every look.
struct Part {
    rows: Vec<Option<Instant>>,
    needed: Vec<Vec<Joints<N>>>,
}

/// An estimator and how it is fed.
struct Method {
    name: &'static str,
    kind: Kind,
    rows_a_tick: usize,
    gated: bool,
}

/// Which estimator.
#[derive(Clone, Copy)]
enum Kind {
    Firmware,
    Nlms,
    Rls,
    RlsF32,
}

const fn method(name: &'static str, kind: Kind, rows_a_tick: usize, gated: bool) -> Method {
    Method {
        name,
        kind,
        rows_a_tick,
        gated,
    }
}

/// The firmware's filter comes first, then what an engineer would try before it.
const METHODS: [Method; 9] = [
    method("ud-1-row", Kind::Firmware, 1, true),
    method("nlms-1-row", Kind::Nlms, 1, true),
    method("ud-2-rows", Kind::Firmware, 2, true),
    method("ud-6-rows", Kind::Firmware, 6, true),
    method("nlms-6-rows", Kind::Nlms, 6, true),
    method("nlms-1-row-ungated", Kind::Nlms, 1, false),
    method("rls-1-row", Kind::Rls, 1, true),
    method("rls-1-row-ungated", Kind::Rls, 1, false),
    method("rls-f32-1-row-ungated", Kind::RlsF32, 1, false),
];
/// How many of them the short form runs.
const SHORT: usize = 2;

/// Learning rate and forgetting factors as usually chosen.
const NLMS_RATE: f64 = 0.05;
const FORGETTING: f64 = 0.9999;

/// All estimators by name.
///
/// * `short` for the tests: two estimators, a tenth of the time
pub(super) fn compare(
    world: &World,
    short: bool,
    progress: &dyn Fn(usize, usize),
) -> Result<BTreeMap<String, MethodReport>, Box<dyn Error>> {
    let length = if short { 0.1 } else { 1.0 };
    let parts = [
        part(world, TASK_S * length, STILL_S * length, None)?,
        part(world, LOADED_S * length, 0.0, Some(PICK_S * length))?,
    ];
    let methods = &METHODS[..if short { SHORT } else { METHODS.len() }];
    let done = Cell::new(0);
    let work = |method: &Method| (method.name.to_owned(), learn(world, &parts, method));
    let reports = in_parallel(cores(), methods, work, || {
        done.set(done.get() + 1);
        progress(done.get(), methods.len());
    });
    Ok(reports.into_iter().collect())
}

impl Kind {
    fn started(self, world: &World) -> Box<dyn RowEstimator> {
        let (config, wrong) = (Controller::config(), &world.wrong);
        match self {
            Self::Firmware => Box::new(Firmware::new(config, wrong)),
            Self::Nlms => Box::new(Nlms::new(&config, wrong, NLMS_RATE)),
            Self::Rls => Box::new(Rls::<f64>::new(&config, wrong, FORGETTING)),
            Self::RlsF32 => Box::new(Rls::<f32>::new(&config, wrong, FORGETTING)),
        }
    }
}

/// The arm at work under PD control and the wrong model, as the board's filter would show it.
fn part(
    world: &World,
    task_s: f64,
    still_s: f64,
    pick_s: Option<f64>,
) -> Result<Part, Box<dyn Error>> {
    let stream = 100 + u64::from(pick_s.is_some());
    let payload = pick_s.map(|pick_s| Payload::cube(3.0, PAYLOAD_COM_M, pick_s, f64::INFINITY));
    let mut plant = world
        .plant(PlantConfig::default(), 1.0, stream)?
        .with_events(Events {
            payloads: payload.into_iter().collect(),
            pushes: Vec::new(),
        });
    let pd = world.pd(6.0);
    let path = Trajectory::Via(world.task(task_s, stream));
    let mut run = ClosedLoop::new(&mut plant, &pd, &path, PERIOD_S, None)?;
    let mut window = MeasurementWindow::<N>::new();
    let (mut rows, mut needed) = (Vec::new(), Vec::new());
    let mut torques = Vec::new();
    for tick in 0..((task_s + still_s) / PERIOD_S).round() as usize {
        if tick.is_multiple_of(LOOK) {
            needed.push(world.needed(&plant));
        }
        let Ok(_) = run.tick_with::<Infallible>(&mut plant, |sample| {
            let measured = sample.and_then(|sample| sample.measured);
            window.push(measured.as_ref());
            torques.push(measured.map(|measured| measured.tau));
            Ok(sample.map(|sample| Answer {
                total: evaluate::<Ur5, N, P>(&world.wrong, &sample.desired).total,
                shares: None,
                flags: 0,
            }))
        });
        let seen = window.conditioned(1.0 / PERIOD_S as f32);
        let raw = torques.iter().rev().nth(DELAY).copied().flatten();
        rows.push(seen.zip(raw).map(|(seen, raw)| Instant { seen, raw }));
    }
    Ok(Part { rows, needed })
}

/// The torque row of `joint` as the filter of the motion leaves it, for torques that ask nothing against cogging.
pub(super) fn heard_row(joint: usize, seen: &ConditionedSample<N>) -> LinearParameters<N, P> {
    let mut row = torque_row::<Ur5, N, P>(joint, seen);
    let cycles = <Ur5 as Arm<N, P>>::COGGING_CYCLES[joint];
    let share = cogging_attenuation(cycles * seen.motion.qd[joint] * PERIOD_S as f32);
    row.attenuate_cogging(joint, share, &LinearParameters::filled(0.0));
    row
}

fn learn(world: &World, parts: &[Part; 2], feed: &Method) -> MethodReport {
    let mut method = feed.kind.started(world);
    let gate = Controller::config().velocity_gate;
    let mut set = world.wrong;
    let mut curves = [Vec::new(), Vec::new()];
    for (part, curve) in parts.iter().zip(&mut curves) {
        for (tick, instant) in part.rows.iter().enumerate() {
            if tick.is_multiple_of(LOOK) {
                method.parameters().write(&mut set);
                let said = world.said(&set);
                let needed = &part.needed[tick / LOOK];
                let nrmse = world.error(&said, needed).nrmse_moving();
                let missed = world.in_limits(&said, needed);
                curve.push((tick as f64 * PERIOD_S, 100.0 * nrmse, missed));
            }
            let Some(Instant { seen, raw }) = instant else {
                continue;
            };
            // A mean of five ticks' torques would be counted several times by rows that come more often than that.
            let tau = if feed.rows_a_tick > 1 { raw } else { &seen.tau };
            for k in 0..feed.rows_a_tick {
                let joint = (tick * feed.rows_a_tick + k) % N;
                if !feed.gated || seen.motion.qd[joint].abs() >= gate {
                    let row = heard_row(joint, seen);
                    method.correct(joint, &row, tau[joint]);
                }
            }
        }
    }
    let [task, loaded] = curves;
    // The first part is task and standstill of the same length.
    let task_end = task.len() / 2;
    let curve: Vec<(f64, f64)> = task[..task_end].iter().map(|(t, e, _)| (*t, *e)).collect();
    let stays = |bound: f64| {
        let above = curve.iter().rposition(|(_, error)| *error >= bound);
        let below = curve.get(above.map_or(0, |above| above + 1));
        below.map_or(f64::NAN, |(t_s, _)| *t_s)
    };
    let pick = loaded.len() / 4;
    let step = world.in_limits(&parts[1].needed[pick + 1], &parts[1].needed[pick]);
    let learnt = loaded[pick + 1..]
        .iter()
        .find(|(.., missed)| *missed < 0.1 * step);
    let n = LinearParameters::of(&world.wrong).iter().count();
    let last = |curve: &[(f64, f64, f64)]| curve.last().map_or(f64::NAN, |look| look.1);
    MethodReport {
        rows_a_tick_count: feed.rows_a_tick,
        multiply_adds_a_tick_count: feed.rows_a_tick * method.multiply_adds(n),
        stays_below_2_percent_s: stays(2.0),
        stays_below_1_percent_s: stays(1.0),
        after_task_nrmse_moving_percent: last(&task[..task_end]),
        after_standstill_nrmse_moving_percent: last(&task),
        payload_3kg_to_10_percent_s: learnt.map_or(f64::NAN, |(t_s, ..)| {
            t_s - pick as f64 * LOOK as f64 * PERIOD_S
        }),
        nrmse_moving_percent: curve,
    }
}
