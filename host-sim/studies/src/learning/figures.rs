//! Figures of traces, each with its unit in the key.

use super::recorder::PAYLOAD_GRACE_S;
use super::scenario::Scenario;
use super::setup::N;
use super::trace::{Evaluation, Second, Trace};
use foretorque_link::safety::SafetyState;
use foretorque_workbench::metrics::TrackingError;
use foretorque_workbench::plant::Events;
use std::collections::BTreeMap;

/// Figures by name; the unit is the end of the name.
pub(super) type Figures = BTreeMap<String, f64>;

/// The runs of one scenario at one bandwidth.
pub(super) struct Traces {
    pub(super) learning: Trace,
    pub(super) frozen: Trace,
    pub(super) pd: Option<Trace>,
    pub(super) no_network: Option<Trace>,
}

/// Length of the windows in which learned and frozen are compared, s.
const WINDOW_S: usize = 10;
/// Windows that begin earlier do not count, s.
const FIRST_WINDOW_S: usize = 10;
/// Part of a step that is left when it counts as learnt.
const LEARNT: f64 = 0.1;
/// Error that is bad, in a collision.
const BAD: f64 = 0.05;

/// All figures of a scenario.
pub(super) fn figures(scenario: &Scenario, events: &Events<N>, traces: &Traces) -> Figures {
    let mut out = Figures::new();
    let Traces {
        learning,
        frozen,
        pd,
        no_network,
    } = traces;
    let mut put = |name: &str, value: f64| {
        out.insert(name.to_owned(), value);
    };
    let last = |trace: &Trace| {
        trace
            .evaluations
            .last()
            .map_or(f64::NAN, |evaluation| evaluation.nrmse)
    };
    put(
        "first_nrmse_moving_percent",
        100.0 * first(&learning.evaluations),
    );
    put("last_nrmse_moving_percent", 100.0 * last(learning));
    put("last_frozen_nrmse_moving_percent", 100.0 * last(frozen));
    // Short runs have no window that counts.
    if let Some(worst) = worst_window(&learning.seconds, &frozen.seconds) {
        put("worst_window_learned_over_frozen_ratio", worst.0);
        put("worst_window_begins_s", worst.1);
    }
    let tracked = |trace: &Trace| tracking(&trace.seconds);
    put("tracking_learned_mrad", tracked(learning).mean_rms_mrad());
    put("tracking_frozen_mrad", tracked(frozen).mean_rms_mrad());
    for (count, name) in [
        (learning.statistics.accepted, "rows_accepted_count"),
        (learning.statistics.gated, "rows_gated_count"),
        (learning.statistics.rejected, "rows_rejected_count"),
        (learning.statistics.incomplete, "ticks_without_window_count"),
        (learning.late_sets, "late_sets_count"),
    ] {
        put(name, f64::from(count));
    }
    for (flag, count) in &learning.flags {
        put(&format!("{flag}_ticks_count"), f64::from(*count));
    }
    for reason in learning
        .decisions
        .iter()
        .map(|(_, decision)| decision.reason)
    {
        *out.entry(format!("guard_{}_count", snake(&format!("{reason:?}"))))
            .or_default() += 1.0;
    }
    let mut put = |name: &str, value: f64| {
        out.insert(name.to_owned(), value);
    };
    let armed = learning.safety.state == SafetyState::Armed;
    put("armed_at_the_end_count", f64::from(u8::from(armed)));
    put("least_trust_ratio", f64::from(learning.least_trust));
    match scenario.name {
        "convergence" => {
            for (bound, name) in [(0.02, "below_2_percent_s"), (0.01, "below_1_percent_s")] {
                put(name, first_below(&learning.evaluations, bound));
                put(
                    &format!("stays_{name}"),
                    stays_below(&learning.evaluations, bound),
                );
            }
        }
        "standstill" => put("parameter_drift_prior_sigmas", learning.drift),
        _ => {}
    }
    if !events.payloads.is_empty() {
        payloads(events, learning, &mut put);
    }
    if !events.pushes.is_empty() {
        collisions(events, learning, &mut put);
    }
    if let Some(without) = no_network {
        let late = |trace: &Trace| trace.evaluations[trace.evaluations.len() / 2..].to_vec();
        let ratios: Vec<f64> = late(learning)
            .iter()
            .zip(late(without))
            .map(|(with, without)| with.nrmse / without.nrmse)
            .collect();
        put(
            "unseen_with_over_without_network_ratio",
            ratios.iter().sum::<f64>() / ratios.len() as f64,
        );
        put(
            "unseen_with_over_without_network_worst_ratio",
            largest(&ratios),
        );
    }
    if let Some(pd) = pd {
        let alone = tracked(pd);
        put("tracking_pd_mrad", alone.mean_rms_mrad());
        for (trace, name) in [(learning, "learned"), (frozen, "frozen")] {
            let ratios = alone
                .rms_mrad()
                .into_iter()
                .zip(tracked(trace).rms_mrad())
                .map(|(alone, with)| alone / with);
            let ratios: Vec<f64> = ratios.collect();
            let mean = ratios.iter().sum::<f64>() / N as f64;
            put(&format!("pd_over_{name}_mean_ratio"), mean);
            put(
                &format!("pd_over_{name}_worst_joint_ratio"),
                ratios.iter().copied().fold(f64::INFINITY, f64::min),
            );
        }
    }
    out
}

/// `DriveGain` → `drive_gain`.
fn snake(name: &str) -> String {
    let mut out = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(letter.to_lowercase());
    }
    out
}

fn first(evaluations: &[Evaluation]) -> f64 {
    evaluations
        .first()
        .map_or(f64::NAN, |evaluation| evaluation.nrmse)
}

/// Time at which the error is first below `bound`, s; NaN if never.
fn first_below(evaluations: &[Evaluation], bound: f64) -> f64 {
    let found = evaluations
        .iter()
        .find(|evaluation| evaluation.nrmse < bound);
    found.map_or(f64::NAN, |evaluation| evaluation.t_s)
}

/// From when on the error stays below `bound`, s; not a number if never.
fn stays_below(evaluations: &[Evaluation], bound: f64) -> f64 {
    let above = evaluations
        .iter()
        .rposition(|evaluation| evaluation.nrmse >= bound);
    let first = above.map_or(0, |above| above + 1);
    evaluations
        .get(first)
        .map_or(f64::NAN, |evaluation| evaluation.t_s)
}

/// The worst ratio of learned over frozen error on any window that counts and has motion, and where that begins, s.
fn worst_window(learned: &[Second], frozen: &[Second]) -> Option<(f64, f64)> {
    let windows = learned.windows(WINDOW_S).zip(frozen.windows(WINDOW_S));
    windows
        .enumerate()
        .skip(FIRST_WINDOW_S)
        .map(|(begin, (learned, frozen))| (nrmse(learned) / nrmse(frozen), begin as f64))
        .filter(|(ratio, _)| ratio.is_finite())
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

/// NRMSE of the moving rows of some seconds, ratio.
pub(super) fn nrmse(seconds: &[Second]) -> f64 {
    let ratios: Vec<f64> = (0..N)
        .filter_map(|j| {
            let error: f64 = seconds.iter().map(|second| second.error[j]).sum();
            let torque: f64 = seconds.iter().map(|second| second.torque[j]).sum();
            (torque > 0.0).then(|| error / torque)
        })
        .collect();
    (ratios.iter().sum::<f64>() / ratios.len() as f64).sqrt()
}

/// Tracking error of the second half.
fn tracking(seconds: &[Second]) -> TrackingError<N> {
    let mut sum = TrackingError::default();
    for second in seconds.iter().skip(seconds.len() / 2) {
        sum.merge(&second.tracking);
    }
    sum
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NAN, f64::max)
}

/// How fast a payload is learnt, and how exactly it is forgotten.
fn payloads(events: &Events<N>, trace: &Trace, put: &mut impl FnMut(&str, f64)) {
    for (name, picked) in [("pick", true), ("release", false)] {
        let mut times: Vec<f64> = events
            .payloads
            .iter()
            .map(|p| if picked { p.from_s } else { p.to_s })
            .map(|change_s| learnt_after(&trace.evaluations, change_s))
            .collect();
        let never = times.iter().filter(|time| time.is_infinite()).count();
        put(&format!("{name}_count"), times.len() as f64);
        put(&format!("{name}_never_learnt_in_2_5_s_count"), never as f64);
        put(
            &format!("{name}_to_10_percent_median_s"),
            median(&mut times),
        );
        put(&format!("{name}_to_10_percent_worst_s"), largest(&times));
    }
    let mass: Vec<f64> = trace
        .weighed
        .iter()
        .map(|(found, true_one)| 100.0 * (f64::from(found.mass) / true_one.body.mass - 1.0).abs())
        .collect();
    put("mass_error_after_1_s_worst_percent", largest(&mass));
    let com: Vec<f64> = trace
        .weighed
        .iter()
        .map(|(found, true_one)| {
            let found = found.com.map(f64::from);
            1e3 * (nalgebra::Vector3::from(found) - true_one.body.com).norm()
        })
        .collect();
    put("com_error_after_1_s_worst_mm", largest(&com));
    // One standard deviation of the worst pick.
    let bounds = trace.weighable.iter();
    let mass: Vec<f64> = bounds
        .clone()
        .map(|(mass, _, payload)| 100.0 * mass / payload.body.mass)
        .collect();
    put("mass_bound_worst_percent", largest(&mass));
    let com: Vec<f64> = bounds.map(|(_, com, _)| 1e3 * com).collect();
    put("com_bound_worst_mm", largest(&com));
    let percent: Vec<f64> = trace.restored.iter().map(|part| 100.0 * part).collect();
    put(
        "torque_after_release_change_worst_percent",
        largest(&percent),
    );
}

/// Time from a change until the error is below a tenth of what it changed, s; infinite if not in the time of grace.
fn learnt_after(evaluations: &[Evaluation], change_s: f64) -> f64 {
    let mut soon = evaluations.iter().filter(|evaluation| {
        evaluation.t_s > change_s && evaluation.t_s <= change_s + PAYLOAD_GRACE_S
    });
    let learnt = soon.find(|evaluation| evaluation.of_step.is_some_and(|part| part < LEARNT));
    learnt.map_or(f64::INFINITY, |evaluation| evaluation.t_s - change_s)
}

/// Number of collisions that spoil the feed-forward, while they last and one second later.
fn collisions(events: &Events<N>, trace: &Trace, put: &mut impl FnMut(&str, f64)) {
    let mut peaks = Vec::new();
    let (mut during, mut after) = (0, 0);
    for push in &events.pushes {
        let near = |from_s: f64, to_s: f64| {
            let evaluations = trace.evaluations.iter();
            evaluations
                .filter(|evaluation| (from_s..=to_s).contains(&evaluation.t_s))
                .map(|evaluation| evaluation.nrmse)
                .fold(0.0, f64::max)
        };
        let peak = near(push.from_s, push.to_s + 1.0);
        during += usize::from(peak > BAD);
        after += usize::from(near(push.to_s + 0.99, push.to_s + 1.05) > BAD);
        peaks.push(100.0 * peak);
    }
    put("collisions_count", peaks.len() as f64);
    put("above_5_percent_during_count", during as f64);
    put("above_5_percent_one_second_after_count", after as f64);
    put("peak_nrmse_moving_worst_percent", largest(&peaks));
    put("peak_nrmse_moving_median_percent", median(&mut peaks));
}
