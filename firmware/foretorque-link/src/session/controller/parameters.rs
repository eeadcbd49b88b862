//! Commands that change parameters and states. One that fails has changed nothing.

use super::{Controller, SampleGaps, TickCounters};
use crate::bank::{BankError, JointBounds, Parameters, feed_forward_config};
use crate::excitation::{
    ExcitationCommand, ExcitationError, ExcitationProgram, ExcitationState, Player,
};
use crate::safety::{SafetyLimits, SafetyReason};
use crate::session::{LearnerMailbox, seconds};
use crate::wire::{Configuration, EvaluatedFrame, MotionFrame, NackReason, SampleFrame};
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForwardConfig, evaluate};
use foretorque::joint::JointMotion;
use foretorque::learning::{ParameterSet, Request};

impl<A: Arm<N, P>, const N: usize, const P: usize> Controller<A, N, P> {
    /// Errors: torque flows.
    pub(in crate::session) fn at_rest(&self) -> Result<(), NackReason> {
        match self.safety.at_rest() {
            true => Ok(()),
            false => Err(NackReason::Armed),
        }
    }

    /// Parameters may be written: no torque flows, and learning is off.
    pub(in crate::session) fn writable(&self) -> Result<(), NackReason> {
        self.at_rest()?;
        if self.feed_forward.state().learning {
            Err(NackReason::LearningOn)
        } else {
            Ok(())
        }
    }

    /// Checks a configuration, apart from the capabilities of the board.
    pub(in crate::session) fn configurable(
        &self,
        wanted: &Configuration,
    ) -> Result<(), NackReason> {
        self.writable()?;
        if self.player.state().is_active() {
            return Err(NackReason::Excitation(ExcitationError::Running));
        }
        if !Configuration::PERIODS_US.contains(&wanted.period_us) {
            return Err(NackReason::Period);
        }
        if wanted.brake_close_ms > Configuration::MAX_BRAKE_CLOSE_MS {
            return Err(NackReason::Brake);
        }
        Ok(())
    }

    /// Restarts the tick at 0 with another configuration and the active set; with a key, which signs what is loaded, without
    /// what was learnt.
    // A function of its own: its stack is not that of the other orders.
    #[inline(never)]
    pub(in crate::session) fn configure(
        &mut self,
        wanted: Configuration,
        has_key: bool,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        let state = self.feed_forward.state();
        let set = match has_key {
            true => state.loaded(),
            false => &state.active,
        };
        let set = *set;
        self.restart(wanted, &set, mailbox)
    }

    /// Restarts with these parameters: learning off, tick 0, counters 0, default configuration. A latched fault stays.
    #[inline(never)]
    pub(in crate::session) fn reset(
        &mut self,
        parameters: &Parameters<N, P>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.at_rest()?;
        (self.gains, self.bounds) = (parameters.gains, parameters.bounds);
        self.start = parameters.start;
        self.restart(Configuration::default(), &parameters.set, mailbox)?;
        self.temperatures_c = [SampleFrame::<N>::NO_TEMPERATURE; N];
        self.counters = TickCounters::default();
        mailbox.reset_counters();
        Ok(())
    }

    /// Restarts tick and learner at 0 with `set`. Changes nothing when it fails.
    #[inline(never)]
    fn restart(
        &mut self,
        configuration: Configuration,
        set: &ParameterSet<N, P>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        let period_s = seconds(&configuration);
        let config = self.config_of(&self.bounds, period_s);
        self.feed_forward
            .restart(config.map_err(NackReason::Bank)?, set)
            .map_err(|_| NackReason::Period)?;
        // Another pacing may stop the timer.
        if self.configuration.pacing != configuration.pacing {
            self.credit = None;
        }
        self.configuration = configuration;
        self.player = Player::new::<A, P>(configuration.period_us);
        let limits = self.safety_limits(configuration.period_us);
        let close_us = 1000 * u32::from(configuration.brake_close_ms);
        self.safety
            .restart(limits.with_brake(close_us, configuration.period_us));
        self.newest = None;
        self.ticked = false;
        self.gaps = SampleGaps::default();
        mailbox.restart(period_s, set, self.start);
        Ok(())
    }

    /// Brings parameters into force, all of them or nothing.
    #[inline(never)]
    pub(in crate::session) fn take_over(
        &mut self,
        parameters: &Parameters<N, P>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        let period_s = seconds(&self.configuration);
        let config = self.config_of(&parameters.bounds, period_s);
        self.feed_forward
            .configure(config.map_err(NackReason::Bank)?)
            .map_err(|_| NackReason::Bank(BankError::Limit(0)))?;
        self.feed_forward
            .load_with(parameters.set, parameters.start, &mut mailbox.exchange);
        (self.gains, self.bounds) = (parameters.gains, parameters.bounds);
        self.start = parameters.start;
        Ok(())
    }

    /// Lowers the torque limits to those of the drives, N × N·m, for good; where no tick can work with them, a fault is latched.
    pub(in crate::session) fn limit_torques(&mut self, limits: [f32; N]) {
        self.drive_limits = limits;
        let period_us = self.configuration.period_us;
        self.safety.restart(self.safety_limits(period_us));
        let config = self.config_of(&self.bounds, seconds(&self.configuration));
        if !config.is_ok_and(|config| self.feed_forward.configure(config).is_ok()) {
            self.safety.trip(SafetyReason::Drive);
        }
    }

    /// Limits of the tick: the lower of the parameters' and the drives'.
    fn config_of(
        &self,
        bounds: &[JointBounds; N],
        period_s: f32,
    ) -> Result<FeedForwardConfig<N>, BankError> {
        let mut config = feed_forward_config::<A, N, P>(bounds, period_s)?;
        for (joint, &limit) in self.drive_limits.iter().enumerate() {
            config.limit_torque(joint, limit);
        }
        Ok(config)
    }

    /// Hard limits: the lower of the arm's and the drives'.
    fn safety_limits(&self, period_us: u32) -> SafetyLimits<N> {
        let mut limits = SafetyLimits::for_arm::<A, P>(period_us);
        limits.limit_torques(&self.drive_limits);
        limits
    }

    /// Shares of the active set for one motion, without state.
    pub(in crate::session) fn evaluate(&self, motion: &MotionFrame<N>) -> EvaluatedFrame<N> {
        let active = &self.feed_forward.state().active;
        (&evaluate::<A, N, P>(active, &JointMotion::from(motion))).into()
    }

    /// Loads an uploaded excitation. A function of its own: its stack is not that of the other orders.
    #[inline(never)]
    pub(in crate::session) fn load_excitation(&mut self, bytes: &[u8]) -> Result<(), NackReason> {
        let program = ExcitationProgram::decode(bytes).ok_or(ExcitationError::Number(0));
        let loaded = program.and_then(|program| self.player.load(&program));
        loaded.map_err(NackReason::Excitation)
    }

    /// Order to the player of excitations.
    pub(in crate::session) fn play(
        &mut self,
        command: ExcitationCommand,
    ) -> Result<ExcitationState, NackReason> {
        let player = &mut self.player;
        player.command(command).map_err(NackReason::Excitation)?;
        if command == ExcitationCommand::Start {
            // A torque that ended without a tick ends no motion that is started after it.
            self.flowed = self.safety.brake_released();
        }
        Ok(player.state())
    }

    /// Emergency stop of torque and learning: the data that led to it may not be fit to learn from.
    pub(in crate::session) fn stop(&mut self, mailbox: &mut LearnerMailbox<N, P>) {
        self.torque_off(SafetyReason::Stopped);
        self.stop_motion();
        // It replaces a request that still waits.
        self.feed_forward
            .request_over(Request::Stop, &mut mailbox.exchange);
    }

    /// Lets a motion that the board plays come to rest on its path.
    pub(in crate::session) fn stop_motion(&mut self) {
        // Without one there is nothing to stop.
        let _ = self.player.command(ExcitationCommand::Stop);
    }

    /// Torque zero at once; latches `fault` unless another is latched.
    pub(in crate::session) fn torque_off(&mut self, fault: SafetyReason) {
        self.safety.torque_off(fault);
        self.feed_forward.applied(self.safety.output());
    }

    pub(in crate::session) fn request(
        &mut self,
        code: u8,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        // The learner's own stop belongs to the emergency stop alone.
        let request = Request::from_code(code).filter(|&request| request != Request::Stop);
        let request = request.ok_or(NackReason::NotCapable)?;
        self.feed_forward
            .request(request, &mut mailbox.exchange)
            .map_err(|_| NackReason::Busy)
    }
}
