//! The certificate of an excitation: every limit with its worst value.

use super::information::Criterion;
use super::refused;
use crate::Refusal;
use serde::Serialize;

/// One limit, and the worst that the path makes of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitCheck {
    /// Quantity: position, velocity, acceleration, torque, clearance, condition number.
    pub limit: &'static str,
    /// Joint, or what is kept clear of what.
    pub of: String,
    /// Unit of the three numbers.
    pub unit: &'static str,
    /// Worst value over the period, between the points included.
    pub worst: f64,
    /// The limit.
    pub allowed: f64,
    /// Distance of the worst value from the limit, negative when it is not kept.
    pub margin: f64,
}

impl LimitCheck {
    /// A value that must not exceed its limit.
    pub(super) fn at_most(
        limit: &'static str,
        of: &str,
        unit: &'static str,
        value: (f64, f64),
    ) -> Self {
        let (worst, allowed) = value;
        let margin = allowed - worst;
        Self {
            limit,
            of: of.to_owned(),
            unit,
            worst,
            allowed,
            margin,
        }
    }

    /// A value that must not fall below its limit.
    pub(super) fn at_least(
        limit: &'static str,
        of: &str,
        unit: &'static str,
        value: (f64, f64),
    ) -> Self {
        let margin = value.0 - value.1;
        Self {
            margin,
            ..Self::at_most(limit, of, unit, value)
        }
    }

    /// Margin over the limit. Metres of clearance have no size of their own: against a tenth of a metre.
    pub(super) fn relative_margin(&self) -> f64 {
        self.margin / self.allowed.abs().max(0.1)
    }

    /// Limit, value and requirement, as of a limit that is not kept.
    fn violation(&self) -> String {
        let [reached, required] = [self.worst, self.allowed].map(|x| quantity(x, self.unit));
        format!(
            "{} of {} {reached}, asked for {required}",
            self.limit, self.of
        )
    }
}

/// A value with its unit; numbers without one stand alone.
fn quantity(value: f64, unit: &str) -> String {
    match unit {
        "1" => format!("{value:.4}"),
        unit => format!("{value:.4} {unit}"),
    }
}

/// Limits that were checked before an excitation was handed out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Certificate {
    /// All limits are kept.
    pub holds: bool,
    /// Points of one period that were checked.
    pub points: usize,
    /// Bounds used between the points.
    pub between_points: &'static str,
    /// Every limit with its worst value.
    pub limits: Vec<LimitCheck>,
    /// Columns behind the condition numbers: base parameters of the links, without rotors and friction.
    pub condition_number_columns: usize,
    /// Condition number of the raw stacked regressor (SI) in standard DH link frames.
    pub condition_number_dh: f64,
    /// Condition number in the board's link frames (Craig).
    pub condition_number_board: f64,
    /// Meaning of the condition numbers.
    pub condition_number_note: &'static str,
    /// Predicted torque error on task motion: RMS over joints of error RMS / torque RMS.
    pub predicted_nrmse_percent: f64,
    /// Predicted torque error of every joint on task motion, N·m RMS.
    pub predicted_error_nm: Vec<f64>,
    /// Those errors as shares of the torque limits.
    pub predicted_error_of_limit: Vec<f64>,
    /// Share of the joints' velocity and acceleration limits that the search used: 1 unless the torque limits, friction
    /// included, allow no more.
    pub speed_share: Vec<f64>,
    /// Link frames of `condition_number_dh`: standard DH where the description has DH rows, joint frames elsewhere.
    pub condition_number_frames: &'static str,
    /// Assumptions of the prediction.
    pub predicted_nrmse_note: String,
    /// Half −ln det of the information, per parameter, SI: what D-optimality makes small. Only differences mean something.
    pub ln_spread: f64,
    /// Objective of the search.
    pub criterion: Criterion,
    /// Seed of the search.
    pub seed: u64,
    /// Starts of the search.
    pub starts: usize,
    /// Version of the program.
    pub version: &'static str,
}

impl Certificate {
    /// By how much the worst limit is missed, relative to its size, and the error of all missed ones of its kind.
    pub(super) fn violation(&self) -> Option<(f64, Refusal)> {
        let relative = LimitCheck::relative_margin;
        let limits = || self.limits.iter();
        let worst = limits().min_by(|a, b| relative(a).total_cmp(&relative(b)))?;
        let alike = limits().filter(|check| check.limit == worst.limit);
        let missed = alike.filter(|check| check.margin < 0.0 || *check == worst);
        let missed: Vec<String> = missed.map(LimitCheck::violation).collect();
        let mend = match worst.limit {
            "torque" => ": correct it with --torque-limits, or narrow the motion with --range-rad",
            "condition number" => ": allow a larger one with --condition-limit",
            _ => "",
        };
        let missed = missed.join("; ");
        let refusal = refused(format!(
            "no path keeps all limits; the best one has {missed}{mend}"
        ));
        Some((-relative(worst), refusal))
    }
}
