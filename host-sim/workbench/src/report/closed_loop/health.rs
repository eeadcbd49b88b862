//! Health of a closed-loop run: ticks without the torque that was asked for, and what was learnt, when and how far.

use crate::closed_loop::TickRecord;
use crate::dynamics::Joints;
use crate::robot::Robot;
use crate::telemetry::numbers;
use foretorque::learning::Reason;
use foretorque::limits::Flags;
use foretorque_link::safety::{SafetyReason, SafetyState, SafetyStatus};
use foretorque_link::wire::{Field, TelemetryFrame};
use serde::Serialize;

/// Share of a run that a trouble may last before it is one.
const TOLERATED: f64 = 0.05;
/// Flags of torques that are not those of the parameters.
const CUT: [Flags; 4] = [
    Flags::SATURATED,
    Flags::SLEWED,
    Flags::STALE_SAMPLE,
    Flags::WITHDRAWN,
];
/// Change of a torque that counts as learnt, share of the torque limit.
const LEARNT_SHARE: f64 = 0.005;
/// Motion that is asked for and the part of it that must happen, rad and ratio.
const ASKED_RAD: f64 = 0.1;
const MOVED_SHARE: f64 = 0.1;
/// Last part of a run over which the learnt torque is averaged, s.
const LAST_S: f64 = 10.0;
/// One kind of decision of the supervisor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DecisionRecord {
    /// Decision; `no decision` before the first.
    pub decision: String,
    /// Times it was the newest one.
    pub times: u32,
    /// First time, s.
    pub first_s: f64,
    /// Time for which it was the newest one, s.
    pub newest_s: f64,
}

/// Learning in a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LearntRecord {
    /// First time at which the learnt change of a torque exceeded 0.5 % of its limit, s; none if never.
    pub adopted_s: Option<f64>,
    /// RMS over the joints of that change in the last 10 s, % of the torque limit.
    pub change_percent: f64,
    /// Lowest and last trust; none without telemetry.
    pub trust: Option<[f32; 2]>,
    /// Decisions of the supervisor, in the order of their first times.
    pub decisions: Vec<DecisionRecord>,
}

/// Counts of a run.
#[derive(Clone, Debug)]
pub(super) struct Health<const N: usize> {
    limits: Joints<N>,
    ranges: [(f64, f64); N],
    ticks: usize,
    unarmed: usize,
    /// Reason of the last of these.
    reason: SafetyReason,
    latched: Option<String>,
    clipped: usize,
    saturated: [usize; N],
    /// Lowest and highest desired, lowest and highest true position, rad.
    travel: Option<[Joints<N>; 4]>,
    feed_forward: Option<Joints<N>>,
    /// Squares of the learnt change by second, in torque limits, and ticks.
    changes: Vec<(f64, usize)>,
    pub(super) learnt: LearntRecord,
    newest: (u32, u8),
}

impl<const N: usize> Health<N> {
    pub(super) fn new(robot: &Robot) -> Self {
        let limits = |j: usize| robot.joints.get(j).map(|joint| joint.limits);
        Self {
            limits: Joints::from_fn(|j, _| limits(j).map_or(f64::INFINITY, |l| l.torque)),
            ranges: std::array::from_fn(|j| limits(j).map_or((0.0, 0.0), |l| l.position)),
            ticks: 0,
            unarmed: 0,
            reason: SafetyReason::None,
            latched: None,
            clipped: 0,
            saturated: [0; N],
            travel: None,
            feed_forward: None,
            changes: Vec::new(),
            learnt: LearntRecord::default(),
            newest: (0, 0),
        }
    }

    /// Takes one tick.
    ///
    /// * `safety` state of the board; none without a board
    /// * `started` torque of the parameters that the run began with, for the desired motion, N·m
    pub(super) fn add(
        &mut self,
        record: &TickRecord<N>,
        safety: Option<SafetyStatus>,
        started: Option<&Joints<N>>,
    ) {
        self.ticks += 1;
        for j in 0..N {
            self.saturated[j] += usize::from(record.tau[j].abs() >= self.limits[j]);
        }
        let flags = Flags(record.flags);
        let clipped = [Flags::LEARNED_CLIPPED, Flags::PAYLOAD_CLIPPED];
        self.clipped += usize::from(clipped.into_iter().any(|flag| flags.contains(flag)));
        let (asked, is) = (record.desired.q, record.q);
        let [low, high, least, most] = self.travel.get_or_insert([asked, asked, is, is]);
        (*low, *high) = (low.inf(&asked), high.sup(&asked));
        (*least, *most) = (least.inf(&is), most.sup(&is));
        if let Some(safety) = safety {
            if safety.state != SafetyState::Armed {
                self.unarmed += 1;
                self.reason = safety.reason;
            }
            if safety.state == SafetyState::Fault && self.latched.is_none() {
                let reason = safety.reason;
                let place = self.beyond(&is);
                self.latched = Some(format!("latched at {:.2} s ({reason}{place})", record.t_s));
            }
        }
        // The torque answered in the last tick is that for the motion of this one.
        if let (Some(feed_forward), Some(started)) = (self.feed_forward, started) {
            let change = (feed_forward - started).component_div(&self.limits);
            if self.learnt.adopted_s.is_none() && change.amax() > LEARNT_SHARE {
                self.learnt.adopted_s = Some(record.t_s);
            }
            let second = record.t_s.max(0.0) as usize;
            let seconds = self.changes.len().max(second + 1);
            self.changes.resize(seconds, (0.0, 0));
            let sum = &mut self.changes[second];
            *sum = (sum.0 + change.norm_squared() / N as f64, sum.1 + 1);
        }
        // A torque that is cut, held or ended differs from that of its parameters for another reason than learning.
        let armed = safety.is_none_or(|safety| safety.state == SafetyState::Armed);
        let whole = armed && !CUT.into_iter().any(|flag| flags.contains(flag));
        self.feed_forward = whole.then(|| record.feed_forward.cast());
    }

    /// The joint that is furthest beyond its range at `q`, in words; empty if none is.
    fn beyond(&self, q: &Joints<N>) -> String {
        let past = |j: &usize| (self.ranges[*j].0 - q[*j]).max(q[*j] - self.ranges[*j].1);
        let worst = (0..N).max_by(|a, b| past(a).total_cmp(&past(b)));
        let Some(j) = worst.filter(|j| past(j) > 0.0) else {
            return String::new();
        };
        let ((low, high), joint, q) = (self.ranges[j], j + 1, q[j]);
        format!(": joint {joint} at {q:.3} rad, range {low:.3} to {high:.3}")
    }

    /// Takes telemetry frames with trust and decisions, `every_s` apart.
    pub(super) fn take(&mut self, frames: &[TelemetryFrame], every_s: f64, period_s: f64) {
        for frame in frames {
            let t_s = f64::from(frame.tick) * period_s;
            for (field, bytes) in frame.fields(N) {
                let values = numbers(field, bytes);
                match field {
                    Field::Quality => {
                        let trust = values[0] as f32;
                        let least = self.learnt.trust.map_or(trust, |[least, _]| least);
                        self.learnt.trust = Some([least.min(trust), trust]);
                    }
                    Field::Decision => {
                        self.decision(values[0] as u32, values[1] as u8, t_s, every_s);
                    }
                    _ => {}
                }
            }
        }
    }

    fn decision(&mut self, count: u32, code: u8, t_s: f64, every_s: f64) {
        let code = if count == 0 { 0 } else { code };
        let name = match (code, Reason::from_code(code)) {
            (_, Some(reason)) => reason.to_string(),
            (0, None) => "no decision".to_owned(),
            (code, None) => format!("decision {code}"),
        };
        let skipped = count.saturating_sub(self.newest.0 + 1);
        if skipped > 0 {
            self.record("decision between two records".to_owned(), t_s)
                .times += skipped;
        }
        let is_new = self.newest != (count, code) && count > 0;
        self.newest = (count, code);
        let record = self.record(name, t_s);
        record.newest_s += every_s;
        record.times += u32::from(is_new);
    }

    /// The record of a decision, begun at `t_s`, s, where it is the first one.
    fn record(&mut self, decision: String, t_s: f64) -> &mut DecisionRecord {
        let known = &mut self.learnt.decisions;
        let place = known.iter().position(|known| known.decision == decision);
        let place = place.unwrap_or(known.len());
        if place == known.len() {
            known.push(DecisionRecord {
                decision,
                times: 0,
                first_s: t_s,
                newest_s: 0.0,
            });
        }
        &mut known[place]
    }

    /// Learning up to the end of the run.
    pub(super) fn learnt(&self) -> LearntRecord {
        let last = self.changes.len().saturating_sub(LAST_S as usize);
        let seconds = self.changes[last..].iter();
        let (sum, ticks) = seconds.fold((0.0, 0), |(sum, ticks), (s, t)| (sum + s, ticks + t));
        LearntRecord {
            change_percent: 100.0 * (sum / ticks.max(1) as f64).sqrt(),
            ..self.learnt.clone()
        }
    }

    /// Everything that kept the arm from its torque or its motion, the gravest first: a latched fault, a joint that hardly moved,
    /// all else for more than 5 % of the run.
    pub(super) fn troubles(&self) -> Vec<String> {
        let share = |ticks: usize| ticks as f64 / self.ticks.max(1) as f64;
        let long = |ticks: usize| share(ticks) > TOLERATED;
        let percent = |ticks: usize| format!("{:.0} % of the run", 100.0 * share(ticks));
        let mut troubles = Vec::new();
        let unarmed = percent(self.unarmed);
        if let Some(latched) = &self.latched {
            troubles.push(format!("board {latched}, without torque for {unarmed}"));
        } else if long(self.unarmed) {
            let reason = match self.reason {
                SafetyReason::None => String::new(),
                reason => format!(" ({reason})"),
            };
            troubles.push(format!("board not armed for {unarmed}{reason}"));
        }
        for j in (0..N).filter(|&j| long(self.saturated[j])) {
            let ticks = percent(self.saturated[j]);
            troubles.push(format!("joint {} at its torque limit for {ticks}", j + 1));
        }
        if let Some([low, high, least, most]) = &self.travel {
            for j in 0..N {
                let (asked, moved) = (high[j] - low[j], most[j] - least[j]);
                if asked > ASKED_RAD && moved < MOVED_SHARE * asked {
                    let (joint, way) = (j + 1, format!("{moved:.3} rad of {asked:.3} rad"));
                    troubles.push(format!("joint {joint} hardly moved: {way}"));
                }
            }
        }
        if long(self.clipped) {
            let ticks = percent(self.clipped);
            troubles.push(format!("learnt torque clipped for {ticks}"));
        }
        troubles
    }
}

impl LearntRecord {
    /// Summary in one line.
    pub fn line(&self) -> String {
        let adopted = match self.adopted_s {
            Some(t_s) => format!(
                "torque changed from {t_s:.1} s on, by {:.1} % of its limit at the end",
                self.change_percent
            ),
            None => "nothing adopted".to_owned(),
        };
        let decisions: Vec<String> = self
            .decisions
            .iter()
            .map(|d| match d.times {
                0 => format!("{} for {:.1} s", d.decision, d.newest_s),
                1 => format!("{} at {:.1} s", d.decision, d.first_s),
                times => format!("{times} x {}, first at {:.1} s", d.decision, d.first_s),
            })
            .collect();
        let trust = self.trust.map_or(String::new(), |[least, last]| {
            format!("; trust {last:.2}, lowest {least:.2}")
        });
        let parts: Vec<String> = std::iter::once(adopted).chain(decisions).collect();
        format!("learning: {}{trust}", parts.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::State;
    use crate::plant::Measurement;
    use foretorque::joint::JointVector;

    /// Record of a tick with joint 2 at `q2`, and `tau2` asked of it.
    fn tick(t_s: f64, q2: f64, tau2: f64) -> TickRecord<6> {
        let (mut q, mut tau) = (Joints::zeros(), Joints::zeros());
        (q[1], tau[1]) = (q2, tau2);
        TickRecord {
            t_s,
            desired: State::rest(q),
            q,
            measured: Measurement { q, tau },
            reported: None,
            tau,
            feed_forward: JointVector::repeat(0.1 * t_s as f32),
            shares: None,
            flags: 0,
            stage: None,
        }
    }

    #[test]
    fn what_keeps_the_arm_from_its_torque_is_named_and_a_sound_run_has_nothing() {
        let robot = Robot::load("ur5").expect("built in");
        let armed = SafetyStatus {
            state: SafetyState::Armed,
            reason: SafetyReason::None,
        };
        let latched = SafetyStatus {
            state: SafetyState::Fault,
            reason: SafetyReason::PositionRange,
        };
        let run = |ticks: usize, q2: f64, tau2: f64, fault: usize| {
            let mut health = Health::<6>::new(&robot);
            for k in 0..100 {
                let late = f64::from(k >= 100 - ticks);
                let safety = if k >= 100 - fault { latched } else { armed };
                let record = tick(k as f64 * 0.1, late * q2, late * tau2);
                health.add(&record, Some(safety), Some(&Joints::zeros()));
            }
            health
        };
        assert_eq!(run(4, 0.5, 150.0, 0).troubles(), Vec::<String>::new());
        let saturated = "joint 2 at its torque limit for 30 % of the run";
        assert_eq!(run(30, 0.5, 150.0, 0).troubles(), [saturated]);
        let mut disarmed = Health::<6>::new(&robot);
        let stopped = SafetyStatus {
            state: SafetyState::Disarmed,
            reason: SafetyReason::Stopped,
        };
        disarmed.add(&tick(0.0, 0.0, 0.0), Some(stopped), None);
        let trouble = disarmed.troubles().concat();
        let reason = SafetyReason::Stopped;
        assert_eq!(
            trouble,
            format!("board not armed for 100 % of the run ({reason})")
        );
        let latched = run(90, 6.5, 10.0, 80);
        let trouble = &latched.troubles()[0];
        let place = "board latched at 2.00 s (measured position out of range: joint 2 at 6.500";
        let named = trouble.starts_with(place) && trouble.ends_with("80 % of the run");
        assert!(named, "{trouble}");
        // The feed-forward grows by 0.01 N·m a tick: the wrists pass 0.5 % of 28 N·m at 1.4 s, seen one tick later.
        let learnt = latched.learnt();
        let adopted_s = learnt.adopted_s.expect("it grows");
        assert!((adopted_s - 1.6).abs() < 0.11, "{adopted_s}");
        let (line, begin) = (learnt.line(), "learning: torque changed from 1.");
        assert!(line.starts_with(begin), "{line}");
    }

    #[test]
    fn decisions_are_counted_and_timed() {
        let robot = Robot::load("ur5").expect("built in");
        let mut health = Health::<6>::new(&robot);
        assert_eq!(health.learnt().line(), "learning: nothing adopted");
        for (count, code) in [(0, 0), (0, 0), (1, 25), (1, 25), (4, 24), (4, 24), (4, 24)] {
            health.decision(count, code, f64::from(count), 0.5);
        }
        let line = "learning: nothing adopted; no decision for 1.0 s; following begins at 1.0 s; 2 x decision between two records, first at 4.0 s; torques reversed at 4.0 s";
        assert_eq!(health.learnt().line(), line);
    }
}
