//! The arm under closed-loop control with a board in the loop.

use crate::board::{Client, ClientError};
use crate::control::{self, PdConfig, PdState};
use crate::dynamics::{Joints, State};
use crate::metrics::TrackingError;
use crate::plant::{Measurement, Plant};
use crate::trajectory::Trajectory;
use foretorque::arm::Arm;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};

/// What happened in one tick.
#[derive(Clone, Copy, Debug)]
pub struct TickRecord<'t, const N: usize> {
    /// Counter of the loop, from 0.
    pub tick: usize,
    /// Where the arm should be.
    pub desired: &'t State<N>,
    /// Where it is, free of noise, rad.
    pub q: &'t Joints<N>,
    /// What its sensors say.
    pub measured: &'t Measurement<N>,
    /// Torque of the drives in this tick, N·m.
    pub tau: &'t Joints<N>,
    /// Feed-forward answered in this tick, in effect in the next, N·m. Zero without a board.
    pub feed_forward: &'t JointVector<N>,
    /// Flags that came with it.
    pub flags: u16,
}

/// Plays `trajectory` under PD control, with the torque of `board` added where there is one.
///
/// The latency of the feed-forward is one tick: the request of tick k asks for the torque of tick k + 1 and carries the
/// motion desired then; what is answered acts from k + 1 on. The PD torque acts at once. The arm is put down at rest at
/// the start, held by the torque of the first desired motion.
///
/// Errors: the board's.
pub fn play<A: Arm<N, P>, const N: usize, const P: usize>(
    plant: &mut Plant<N>,
    pd: &PdConfig<N>,
    trajectory: &Trajectory<N>,
    period_s: f64,
    ticks: usize,
    mut board: Option<&mut Client<A, N, P>>,
    mut observe: impl FnMut(&TickRecord<'_, N>),
) -> Result<TrackingError<N>, ClientError> {
    let mut desired = trajectory.at(0.0);
    plant.place(&desired.q);
    let mut controller = PdState::new(desired.q);
    let mut answer = match &mut board {
        Some(board) => board.evaluate(&motion_f32(&desired))?.total,
        None => JointVector::zeros(),
    };
    let mut tracking = TrackingError::default();
    for tick in 0..ticks {
        let measured = plant.measure();
        let feed_forward: Joints<N> = answer.cast();
        let feedback = control::step(pd, &mut controller, &measured.q, &desired.q, &desired.qd);
        let tau = feedback + feed_forward;
        let next = trajectory.at((tick + 1) as f64 * period_s);
        let mut flags = 0;
        if let Some(board) = &mut board {
            let reply = board.sample(&JointSample {
                desired: motion_f32(&next),
                measured: Some(JointMeasurement {
                    q: measured.q.cast(),
                    tau: measured.tau.cast(),
                }),
            })?;
            answer = reply.total.into();
            flags = reply.flags;
        }
        tracking.add(&(desired.q - plant.q()));
        observe(&TickRecord {
            tick,
            desired: &desired,
            q: plant.q(),
            measured: &measured,
            tau: &tau,
            feed_forward: &answer,
            flags,
        });
        plant.advance(&tau, period_s);
        desired = next;
    }
    Ok(tracking)
}

/// A motion as the board reads it.
pub fn motion_f32<const N: usize>(state: &State<N>) -> JointMotion<N> {
    JointMotion {
        q: state.q.cast(),
        qd: state.qd.cast(),
        qdd: state.qdd.cast(),
    }
}
