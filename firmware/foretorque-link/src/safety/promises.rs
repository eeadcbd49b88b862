//! The promises of `docs/safety.md` about torque and time, checked from outside: by tests, fuzzer and fault campaigns.

use super::{SafetyLimits, SafetyReason, SafetyState, SafetyStatus};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::JointVector;

/// Promise that a board has broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Broken {
    /// Every torque is finite.
    Finite,
    /// Every torque is within the arm's limit.
    Limit,
    /// All calls of one period change the torque by one slew step at most, apart from an immediate stop.
    Slew,
    /// Torque and enable need an `Arm` that was acknowledged, and end with the torque.
    Permission,
    /// A board that has left `Armed` returns there only by another `Arm`.
    Rearmed,
    /// An emergency stop ends torque and enable at once.
    Stop,
    /// The torque ends one time-out after the last usable sample, ± 1 period.
    TimeOut,
    /// The torque begins to fall 10 ms after the last usable sample.
    Hold,
    /// After the time-out, a disarming or a fault the torque is zero within the closing time of the brakes and 10 ms.
    End,
}

/// Observer of one board, period by period.
#[derive(Clone, Debug)]
pub struct Promises<const N: usize> {
    limits: SafetyLimits<N>,
    hold_ticks: u32,
    /// Torque has been permitted, and has not ended since.
    permitted: bool,
    /// The board may be in `Armed`.
    may_be_armed: bool,
    /// A stop has arrived since the last check.
    stopped: bool,
    state: SafetyState,
    /// Torque at the beginning of the period.
    slewed_from: JointVector<N>,
    torque: JointVector<N>,
    /// Sum of the torques at the last usable sample, N·m.
    held: f32,
    /// Periods since then.
    silent: u32,
    /// Periods since the board has left `Armed`.
    ending: u32,
}

impl<const N: usize> Promises<N> {
    /// A board after its start.
    pub fn new(limits: SafetyLimits<N>, config: &FeedForwardConfig<N>) -> Self {
        Self {
            limits,
            hold_ticks: config.hold_ticks,
            permitted: false,
            may_be_armed: false,
            stopped: false,
            state: SafetyState::Disarmed,
            slewed_from: JointVector::zeros(),
            torque: JointVector::zeros(),
            held: 0.0,
            silent: 0,
            ending: 0,
        }
    }

    /// An `Arm` was acknowledged.
    pub fn permit(&mut self) {
        (self.permitted, self.may_be_armed) = (true, true);
    }

    /// A stop has arrived: torque and enable are off at the next check, also where another fault was latched before.
    pub fn stop(&mut self) {
        self.stopped = true;
    }

    /// A period begins; before the board's timer.
    pub fn period(&mut self) {
        self.slewed_from = self.torque;
        self.silent = self.silent.saturating_add(1);
        self.ending = self.ending.saturating_add(1);
    }

    /// Checks the board after any call of it.
    ///
    /// * `used` a tick ran on a usable sample
    ///
    /// Errors: the first promise that does not hold.
    pub fn check(
        &mut self,
        torque: &JointVector<N>,
        enabled: bool,
        status: SafetyStatus,
        used: bool,
    ) -> Result<(), Broken> {
        let SafetyStatus { state, reason } = status;
        let before = core::mem::replace(&mut self.state, state);
        let armed = state == SafetyState::Armed;
        let holds = |holds: bool, broken: Broken| if holds { Ok(()) } else { Err(broken) };
        let all = |within: &dyn Fn(usize, f32) -> bool| {
            torque
                .iter()
                .enumerate()
                .all(|(j, &torque)| within(j, torque))
        };
        let of = |vector: &JointVector<N>, joint: usize| vector.get(joint).copied().unwrap_or(0.0);
        let off = all(&|_, torque| torque == 0.0);
        holds(all(&|_, torque| torque.is_finite()), Broken::Finite)?;
        holds(
            all(&|j, torque| torque.abs() <= of(&self.limits.torque, j)),
            Broken::Limit,
        )?;
        let slewed = all(&|j, torque| {
            let step = (torque - of(&self.slewed_from, j)).abs();
            step <= 1.0001 * of(&self.limits.slew_per_tick, j)
        });
        let stop = core::mem::take(&mut self.stopped);
        holds(!stop || off && !enabled, Broken::Stop)?;
        let at_once = stop
            || matches!(
                reason,
                SafetyReason::Stopped | SafetyReason::Drive | SafetyReason::Stage
            );
        let stopped = off && !enabled && at_once;
        holds(slewed || stopped, Broken::Slew)?;
        if stopped {
            self.slewed_from = *torque;
        }
        let flows = armed || state == SafetyState::RampDown;
        holds(enabled == flows && (enabled || off), Broken::Permission)?;
        holds(self.permitted || !enabled, Broken::Permission)?;
        holds(self.may_be_armed || !armed, Broken::Rearmed)?;
        self.permitted &= enabled;
        self.may_be_armed &= armed;
        self.torque = *torque;
        let sum: f32 = torque.iter().map(|torque| torque.abs()).sum();
        if used {
            self.silent = 0;
        }
        if used || !enabled {
            self.held = sum;
        }
        if state != SafetyState::RampDown {
            self.ending = 0;
        }
        let ramp = of(&self.limits.torque, 0) / of(&self.limits.slew_per_tick, 0);
        let end = self.limits.brake_ticks + ramp as u32 + 2;
        holds(self.ending <= end, Broken::End)?;
        let timeout = self.limits.timeout_ticks;
        let left = before == SafetyState::Armed && !armed;
        let early = left && reason == SafetyReason::CommandTimeout && self.silent + 1 < timeout;
        let late = armed && self.silent > timeout;
        holds(!late && !early, Broken::TimeOut)?;
        let falls = self.limits.brake_ticks > 0 || off || sum < self.held;
        holds(
            !armed || self.silent <= self.hold_ticks + 1 || falls,
            Broken::Hold,
        )
    }
}

/// Arrival of a host's samples, of which it sends one a period, relative to the board's timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// One in every period.
    Exact,
    /// Anything from none to all that wait.
    Jitter,
    /// One in a period, and every now and then another one: the host's clock is fast.
    Early,
    /// One in a period, three periods late.
    Late,
    /// All that an adapter's buffer has collected in up to 60 periods, at once.
    Bursts,
    /// Gaps of any length in which nothing is sent.
    Silence,
}

impl Timing {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Exact,
        Self::Jitter,
        Self::Early,
        Self::Late,
        Self::Bursts,
        Self::Silence,
    ];

    /// Samples that arrive in one period.
    ///
    /// * `waiting` samples sent and not arrived      * `random` any number
    pub fn arriving(self, waiting: u32, random: u32) -> u32 {
        match self {
            Self::Exact | Self::Silence => waiting,
            Self::Jitter => random % (waiting + 1),
            Self::Early => waiting + u32::from(random.is_multiple_of(16)),
            Self::Late => waiting.saturating_sub(3),
            Self::Bursts if waiting <= random % 60 => 0,
            Self::Bursts => waiting,
        }
    }
}
