//! Judgement of logs against the description: units, signs, order of joints, delay, excitation; and of what was fitted.
//!
//! A log is compared with the description's torques of its own motion, which need not be accurate: masses 30 % off leave
//! the sign, the order of the joints and the unit visible.

mod compare;
mod delay;
mod explained;
mod fitted;
mod ranges;
mod readings;
mod sums;

pub use fitted::unexplained;
pub(super) use fitted::{after_fit, change, description};

use super::columns::{ColumnSet, Layout};
use super::dataset::Thinned;
use super::methods::wls;
use super::normal::NormalEquations;
use super::prepare::{PrepareConfig, other_unit_of_time};
use super::stream::for_each_prepared;
use super::{IdentifyError, listed};
use crate::dynamics::{Motion, PerJoint};
use crate::robot::{LINK_PARAMETERS, Robot};
use compare::compare;
use delay::{Delay, delay, fast_rows};
use fitted::{across, payload};
use nalgebra::DMatrix;
use ranges::units;
use readings::at_rate;
use serde::Serialize;
use std::path::PathBuf;
use sums::{Extremes, scan};

/// Most rows that are compared with the description.
const ROWS: usize = 1199;
/// Gravity decides over sign and size where its RMS is this share of the torque limit.
const GRAVITY_SHARE: f64 = 0.05;
/// Range of the RMS torque over that of a description with friction.
const SOUND_SIZE: (f64, f64) = (0.2, 5.0);
/// Speed and range from which a joint counts as moved, rad/s and rad.
const MOVED: (f64, f64) = (0.2, 0.2);
/// Speed from which the delay is estimated, rad/s: the step of friction at a reversal passes for a delay.
const FAST_RAD_S: f64 = 0.2;
/// Range of a sound torque over that of the description.
const SOUND_SCALE: (f64, f64) = (0.4, 2.4);
/// Error of the centre of mass of a body of the description, m.
const CENTRE_M: f64 = 0.03;
/// A torque with more than this share of its variance unexplained is noise.
const NOISE_SHARE: f64 = 0.9;
/// Delay of the torque that is refused, and that is noted, s.
const DELAY_S: (f64, f64) = (10e-3, 4e-3);
/// Largest difference of the periods of logs of one rate, share.
const SAME_PERIOD: f64 = 0.01;
/// Standard deviations from which an estimate counts; analytic ones are about 2.5 times too small.
const DEVIATIONS: f64 = 5.0;
const ANALYTIC: f64 = 2.5;

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// No bank is written.
    pub refuses: bool,
    /// One line.
    pub text: String,
}

/// Figures of one joint.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct JointCheck {
    /// Range of positions, rad.
    pub position_rad: (f64, f64),
    /// Largest speed, rad/s.
    pub speed_rad_s: f64,
    /// RMS torque while the joint moves, N·m.
    pub torque_rms_nm: f64,
    /// Noise of the filtered torque, N·m, from its scatter between neighbouring rows.
    pub noise_floor_nm: f64,
    /// Share of the variance of the torque that neither the description nor friction nor a rotor explains.
    pub unexplained_ratio: f64,
    /// Torque over that of the description's links; none where gravity is too small to tell.
    pub scale_ratio: Option<f64>,
}

/// Judgement of logs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judgement {
    /// Findings, refusals first.
    pub findings: Vec<Finding>,
    /// Joint by joint.
    pub joints: Vec<JointCheck>,
    /// Time between rows, s.
    pub period_s: f64,
    /// Delay of the torques behind the positions, s, and its standard deviation.
    pub delay_s: Option<(f64, f64)>,
    /// Parameters that the motion does not show.
    pub unseen: Vec<String>,
    /// Condition number of all columns at unit length.
    pub condition_number_equilibrated: Option<f64>,
    /// Remarks of the readers.
    pub notes: Vec<String>,
}

impl Judgement {
    /// There is a finding that refuses a bank.
    pub fn refuses(&self) -> bool {
        self.findings.iter().any(|finding| finding.refuses)
    }

    /// Warnings of a log of training: all findings that do not refuse, and the parameters that the motion does not show.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let findings = self.findings.iter().filter(|finding| !finding.refuses);
        let unseen = (!self.unseen.is_empty())
            .then(|| format!("the motion does not show {}", listed(&self.unseen)));
        findings.map(|finding| finding.text.clone()).chain(unseen)
    }

    pub(super) fn find(&mut self, refuses: bool, text: impl Into<String>) {
        let text = text.into();
        self.findings.push(Finding { refuses, text });
        self.findings.sort_by_key(|finding| !finding.refuses);
    }
}

/// Finding on logs in which no joint moves.
pub(super) fn at_rest(config: &PrepareConfig) -> String {
    let still_rad_s = config.still_rad_s;
    format!(
        "no joint moves faster than {still_rad_s} rad/s: record a motion, or give a smaller --still-rad-s"
    )
}

/// Fall of the logarithm of the power that the best parameters leave, summed over the joints, by a clock of `rate` times the
/// rate; 0 where the motion does not show all parameters.
fn fall_at_rate(
    layout: &Layout,
    rows: &[(Motion, PerJoint<f64>)],
    still_rad_s: f64,
    rate: f64,
) -> f64 {
    let left = |rate: f64| {
        let joints = layout.joints();
        let mut sums = NormalEquations::new(layout, 0);
        let mut scratch = DMatrix::zeros(joints, (LINK_PARAMETERS + 1) * joints);
        let mut panel = Vec::new();
        for (state, tau) in rows {
            panel.clear();
            layout.append_row(&at_rate(state, rate), 0.0, &mut scratch, &mut panel);
            for (joint, sums) in sums.joints.iter_mut().enumerate() {
                if state.qd[joint].abs() > still_rad_s {
                    sums.add(layout.columns(joint, &panel), &[tau[joint]]);
                }
            }
        }
        let fit = wls(&sums, layout).ok()?;
        Some(fit.sigma.iter().map(|sigma| 2.0 * sigma.ln()).sum::<f64>())
    };
    let fall = left(1.0).zip(left(rate)).map(|(own, other)| own - other);
    fall.filter(|fall| fall.is_finite()).unwrap_or(0.0)
}

/// Judges logs before anything is identified.
///
/// Errors: [`IdentifyError`] of a log that cannot be read.
pub fn judge(
    robot: &Robot,
    logs: &[PathBuf],
    columns: &ColumnSet,
    config: &PrepareConfig,
) -> Result<Judgement, IdentifyError> {
    let layout = Layout::new(robot, columns);
    let joints = layout.joints();
    let mut judgement = Judgement::default();
    let mut extremes = vec![Extremes::none(); joints];
    let mut currents = false;
    for path in logs {
        config.check(path, robot)?;
        let (period_s, of_currents) = scan(path, robot, &mut extremes)?;
        judgement.period_s = period_s;
        currents |= of_currents;
        let hint = other_unit_of_time(judgement.period_s);
        if !hint.is_empty() {
            let text = format!("its rows are {:.3} s apart{hint}", judgement.period_s);
            judgement.find(true, text);
            return Ok(judgement);
        }
    }
    units(&mut judgement, robot, &extremes, currents);
    if judgement.refuses() {
        return Ok(judgement);
    }
    let mut sample = Thinned::new(ROWS);
    let mut sums = NormalEquations::new(&layout, 0);
    // Delays are counted in rows, so those of each period are apart.
    let mut delays: Vec<(f64, Vec<Delay>)> = Vec::new();
    let across = across(robot);
    // The largest gain of noise.
    let mut gain = 0.0_f64;
    for path in logs {
        for_each_prepared(
            path,
            robot,
            &layout,
            config,
            &mut judgement.notes,
            &mut |own, prepared| {
                gain = gain.max(own.noise_gain());
                let stride = own.stride();
                let fast = (0..joints).map(|j| fast_rows(&prepared.states, j, own.smear()));
                let fast: Vec<Vec<bool>> = fast.collect();
                let same = |other: f64| (own.period_s / other - 1.0).abs() < SAME_PERIOD;
                let place = delays.iter().position(|(other, _)| same(*other));
                let place = place.unwrap_or(delays.len());
                if place == delays.len() {
                    let none = (0..joints).map(|_| Delay::default());
                    delays.push((own.period_s, none.collect()));
                }
                let (period_s, delays) = &mut delays[place];
                for row in prepared.core.clone().step_by(stride) {
                    let tau = PerJoint::from(&prepared.tau[row * joints..][..joints]);
                    let state = prepared.states[row];
                    // Brakes may hold an arm at rest.
                    if state.qd.iter().any(|qd| qd.abs() > own.still_rad_s) {
                        sample.push((state, tau));
                    }
                    let turned = across.each_ref();
                    let turned = turned.map(|(_, model)| model.gravity_torques(&state.q));
                    for joint in 0..joints {
                        let x = layout.columns(joint, &prepared.panel[row * layout.width..]);
                        let qd = state.qd[joint];
                        if qd.abs() > own.still_rad_s {
                            sums.joints[joint].add(x, &[tau[joint]]);
                        }
                        let tau = |row: usize| prepared.tau.get(row * joints + joint).copied();
                        delays[joint].add(
                            (x, turned.each_ref().map(|tau| tau[joint])),
                            (qd, fast[joint][row]),
                            (row, stride, *period_s),
                            &tau,
                        );
                    }
                }
            },
        )?;
    }
    if sums.count() == 0.0 {
        judgement.find(true, at_rest(config));
        return Ok(judgement);
    }
    match sums.check_rank(&layout) {
        Err(IdentifyError::RankDeficient(_, _, names)) => judgement.unseen = names,
        Err(other) => return Err(other),
        Ok(()) => {
            judgement.condition_number_equilibrated = Some(sums.condition_numbers(&layout).1);
        }
    }
    let fitted = |rate| fall_at_rate(&layout, &sample.kept, config.still_rad_s, rate);
    let payload = || {
        let flange = payload(robot, &layout, &wls(&sums, &layout).ok()?)?;
        flange.is_most().then(|| flange.finding())
    };
    let fits = (&fitted as &_, &payload as &_);
    compare(&mut judgement, robot, &sample.kept, &extremes, gain, fits);
    if !judgement.refuses() {
        for (period_s, delays) in &delays {
            delay(&mut judgement, &layout, delays, *period_s);
        }
    }
    Ok(judgement)
}
