//! One run: one arm, one board, one scenario.

use super::controller::Controller;
use super::identified::Starts;
use super::recorder::Recorder;
use super::scenario::Scenario;
use super::setup::{N, PERIOD_S, Setup};
use super::trace::Trace;
use crate::StudyError;
use foretorque_link::safety::SafetyReason;
use foretorque_workbench::closed_loop::{Answer, ClosedLoop, motion_f32};
use foretorque_workbench::dynamics::Joints;
use std::convert::Infallible;

/// Board at the other end of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Board {
    /// Nothing: PD control alone.
    None,
    /// A board that never learns.
    Frozen,
    /// A board with the firmware's configuration, everything switched on.
    Learning,
    /// A learning board whose networks are not trained.
    NoNetwork,
}

/// Settings of a run.
#[derive(Clone, Copy)]
pub(super) struct Run<'w> {
    pub(super) setup: &'w Setup,
    pub(super) starts: &'w Starts,
    pub(super) scenario: &'w Scenario,
    pub(super) bandwidth_hz: f64,
    pub(super) board: Board,
    pub(super) quick: bool,
    /// Record samples and torques.
    pub(super) recording: bool,
}

/// A board that refuses to be armed.
pub(super) fn unarmed(reason: SafetyReason) -> StudyError {
    StudyError::Unusable(format!("the board was not armed: {reason:?}"))
}

impl Run<'_> {
    /// Ticks it takes.
    pub(super) fn ticks(&self) -> usize {
        (self.scenario.length_s(self.quick) / PERIOD_S).round() as usize
    }

    /// Runs it.
    pub(super) fn trace(&self, progress: &dyn Fn(usize)) -> Result<Trace, StudyError> {
        let Self {
            setup, scenario, ..
        } = *self;
        let pd = setup.pd(self.bandwidth_hz);
        let path = scenario.trajectory(setup, self.quick);
        let events = scenario.events(setup, self.quick);
        let plant = setup.plant(scenario.plant, scenario.viscous, scenario.stream)?;
        let mut plant = plant
            .with_events(events.clone())
            .with_faults(scenario.faults);
        let start = self.starts.set(scenario.start);
        let learning = matches!(self.board, Board::Learning | Board::NoNetwork);
        let mut config = scenario.start.config();
        if self.board == Board::NoNetwork {
            config.network.output_sigma = 0.0;
        }
        let mut board = Controller::new(start, config, learning)?;
        let mut run = ClosedLoop::new(&mut plant, &pd, &path, PERIOD_S, None)?;
        let arming = board.arming_sample(motion_f32(&path.at(0.0)));
        board.arm(&arming).map_err(unarmed)?;
        let mut recorder = Recorder::new(setup, scenario, events, self.ticks(), &path, &plant);
        let mut acting = Joints::zeros();
        for tick in 0..self.ticks() {
            recorder.evaluate(tick, &board, &plant);
            recorder.decisions(tick, &board);
            let (mut asked, mut torque) = (None, None);
            let Ok(record) = run.tick_with::<Infallible>(&mut plant, |sample| {
                asked = sample.copied();
                if self.board == Board::None {
                    return Ok(None);
                }
                torque = Some(board.tick(sample));
                Ok(torque.map(|torque| Answer {
                    total: torque.total,
                    shares: None,
                    flags: torque.flags.0,
                }))
            });
            let needed = plant.true_torque(&record.desired);
            recorder.add(record.t_s, &record.desired.qd, &needed, &acting);
            recorder.weigh(tick, &motion_f32(&record.desired));
            recorder.track(record.t_s, &(record.desired.q - record.q));
            if let Some(torque) = torque {
                recorder.count(torque.flags, &torque.total.into());
                if self.recording {
                    let bits = <[f32; N]>::from(torque.total).map(f32::to_bits);
                    recorder.trace.recording.push((asked, bits));
                }
            }
            acting = record.feed_forward.cast();
            if tick % 1000 == 999 {
                progress(1000);
            }
        }
        recorder.trace.arming = Some(arming);
        recorder.trace.safety = board.safety();
        Ok(recorder.finish(&board, &plant, self.ticks()))
    }
}
