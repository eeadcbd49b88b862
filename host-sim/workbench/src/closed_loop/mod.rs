//! The arm under closed-loop control with a board in the loop.

pub mod control;

use crate::board::{BoardError, BoardShares, Client};
use crate::dynamics::{Joints, State};
use crate::plant::{Measurement, Plant};
use crate::trajectory::Trajectory;
use control::{PdConfig, PdState};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::excitation::ExcitationState;

/// Record of one tick.
#[derive(Clone, Copy, Debug)]
pub struct TickRecord<const N: usize> {
    /// Time at the beginning of the tick, s.
    pub t_s: f64,
    /// Where the arm should be.
    pub desired: State<N>,
    /// Where it is, free of noise, rad.
    pub q: Joints<N>,
    /// Measurement in the drives.
    pub measured: Measurement<N>,
    /// Measurement that arrived at board and log.
    pub reported: Option<Measurement<N>>,
    /// Torque asked of the drives in this tick, N·m.
    pub tau: Joints<N>,
    /// Feed-forward answered in this tick, in effect in the next, N·m. Zero without a board.
    pub feed_forward: JointVector<N>,
    /// Shares of the torque, as far as the reply has them. None without a board.
    pub shares: Option<BoardShares<N>>,
    /// Flags that came with it.
    pub flags: u16,
    /// Where the board's own excitation stands, while it is in charge of the desired motion.
    pub stage: Option<ExcitationState>,
}

/// Answer of a board to one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer<const N: usize> {
    /// The feed-forward torque, N·m.
    pub total: JointVector<N>,
    /// Shares of the torque, as far as known.
    pub shares: Option<BoardShares<N>>,
    /// Flags of the tick.
    pub flags: u16,
}

/// A trajectory that is being played under PD control, with the torque of a board added where there is one.
///
/// The latency of the feed-forward is one tick: the request of tick k asks for the torque of tick k + 1 and carries the
/// motion desired then; what is answered acts from k + 1 on. The PD torque acts at once. A board that plays an excitation of
/// its own answers the motion too, and that is followed in the trajectory's place.
#[derive(Debug)]
pub struct ClosedLoop<'t, const N: usize> {
    pd: &'t PdConfig<N>,
    controller: PdState<N>,
    trajectory: &'t Trajectory<N>,
    period_s: f64,
    tick: usize,
    desired: State<N>,
    answer: JointVector<N>,
}

impl<'t, const N: usize> ClosedLoop<'t, N> {
    /// Puts the arm down at rest at the start of `trajectory` and arms the board, which is shown the arm standing there.
    /// The first tick's feed-forward is the board's for the first desired motion.
    ///
    /// Errors: the board's, and its refusal to be armed.
    pub fn new(
        plant: &mut Plant<N>,
        pd: &'t PdConfig<N>,
        trajectory: &'t Trajectory<N>,
        period_s: f64,
        board: Option<&mut Client<N>>,
    ) -> Result<Self, BoardError> {
        let desired = trajectory.at(0.0);
        plant.place(&desired.q);
        let answer = match board {
            Some(board) => {
                let motion = motion_f32(&desired);
                let answer = board.evaluate(&motion)?.total;
                board.arm(&JointSample {
                    desired: motion,
                    measured: Some(JointMeasurement {
                        q: motion.q,
                        tau: answer,
                    }),
                })?;
                answer
            }
            None => JointVector::zeros(),
        };
        Ok(Self {
            pd,
            controller: PdState::new(desired.q),
            trajectory,
            period_s,
            tick: 0,
            desired,
            answer,
        })
    }

    /// Runs one tick. `board` is the one given to [`new`](Self::new), or none as there.
    ///
    /// Errors: the board's.
    pub fn tick(
        &mut self,
        plant: &mut Plant<N>,
        board: Option<&mut Client<N>>,
    ) -> Result<TickRecord<N>, BoardError> {
        let mut excited = None;
        let mut record = self.tick_with(plant, |sample| {
            let Some(board) = board else {
                return Ok(None);
            };
            let Some(sample) = sample else {
                board.skip_period();
                return Ok(None);
            };
            let reply = board.sample(sample)?;
            excited = reply.excited;
            Ok(Some(Answer {
                total: reply.total,
                shares: Some(reply.shares),
                flags: reply.flags.0,
            }))
        })?;
        if let Some((stage, motion)) = excited {
            // The board chose what the arm shall do in the next tick.
            record.stage = Some(stage);
            self.desired = motion_f64(&motion);
        }
        Ok(record)
    }

    /// Runs one tick with any board. `ask` gets the sample, none if it was lost on the way; without an answer the
    /// feed-forward stays as it is.
    ///
    /// Errors: those of `ask`.
    pub fn tick_with<E>(
        &mut self,
        plant: &mut Plant<N>,
        ask: impl FnOnce(Option<&JointSample<N>>) -> Result<Option<Answer<N>>, E>,
    ) -> Result<TickRecord<N>, E> {
        let desired = self.desired;
        let measured = plant.measure();
        let reported = plant.report(&measured);
        let feedback = control::step(
            self.pd,
            &mut self.controller,
            &measured.q,
            &desired.q,
            &desired.qd,
        );
        let tau = feedback + self.answer.cast::<f64>();
        let next = self.trajectory.at((self.tick + 1) as f64 * self.period_s);
        let sample = reported.map(|reported| JointSample {
            desired: motion_f32(&next),
            measured: Some(JointMeasurement {
                q: reported.q.cast(),
                tau: reported.tau.cast(),
            }),
        });
        let answer = ask(sample.as_ref())?;
        if let Some(answer) = answer {
            self.answer = answer.total;
        }
        let record = TickRecord {
            t_s: self.tick as f64 * self.period_s,
            desired,
            q: *plant.q(),
            measured,
            reported,
            tau,
            feed_forward: self.answer,
            shares: answer.and_then(|answer| answer.shares),
            flags: answer.map_or(0, |answer| answer.flags),
            stage: None,
        };
        plant.advance(&tau, self.period_s);
        self.desired = next;
        self.tick += 1;
        Ok(record)
    }
}

/// A motion as the board asks for it.
fn motion_f64<const N: usize>(motion: &JointMotion<N>) -> State<N> {
    State {
        q: motion.q.cast(),
        qd: motion.qd.cast(),
        qdd: motion.qdd.cast(),
    }
}

/// A motion as the board reads it.
pub fn motion_f32<const N: usize>(state: &State<N>) -> JointMotion<N> {
    JointMotion {
        q: state.q.cast(),
        qd: state.qd.cast(),
        qdd: state.qdd.cast(),
    }
}
