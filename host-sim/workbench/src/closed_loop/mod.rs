//! The arm under closed-loop control with a board in the loop, beside proportional and derivative action on the position.

use crate::board::{BoardError, BoardShares, Client};
use crate::dynamics::{Joints, ReferenceModel, State};
use crate::plant::{Measurement, Plant};
use crate::trajectory::Trajectory;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::excitation::ExcitationState;
use nalgebra::SMatrix;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

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
    /// Excitation of the board in its last reply.
    excited: Option<(ExcitationState, JointMotion<N>)>,
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
        let mut answer = JointVector::zeros();
        if let Some(board) = board {
            let desired = motion_f32(&desired);
            answer = board.evaluate(&desired)?.total;
            let (q, tau) = (desired.q, answer);
            let measured = Some(JointMeasurement { q, tau });
            board.arm(&JointSample { desired, measured })?;
        }
        Ok(Self {
            pd,
            controller: PdState {
                previous_q: desired.q,
                speed: Joints::zeros(),
            },
            trajectory,
            period_s,
            tick: 0,
            desired,
            answer,
            excited: None,
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
        let mut reply = None;
        let mut record = self.tick_with(plant, |sample| {
            let Some(board) = board else {
                return Ok(None);
            };
            let Some(sample) = sample else {
                board.skip_period();
                return Ok(None);
            };
            reply = Some(board.sample(sample)?);
            Ok(reply.map(|reply| reply.total))
        })?;
        // Without a reply the last motion stands.
        if let Some(reply) = reply {
            self.excited = reply.excited;
            (record.shares, record.flags) = (Some(reply.shares), reply.flags.0);
        }
        if let Some((stage, motion)) = self.excited {
            // The board chose what the arm shall do in the next tick.
            record.stage = Some(stage);
            self.desired = State {
                q: motion.q.cast(),
                qd: motion.qd.cast(),
                qdd: motion.qdd.cast(),
            };
        }
        Ok(record)
    }

    /// Runs one tick with any board. `ask` gets the sample, none if it was lost on the way, and gives the feed-forward, N × N·m;
    /// without one it stays as it is.
    ///
    /// Errors: those of `ask`.
    pub fn tick_with<E>(
        &mut self,
        plant: &mut Plant<N>,
        ask: impl FnOnce(Option<&JointSample<N>>) -> Result<Option<JointVector<N>>, E>,
    ) -> Result<TickRecord<N>, E> {
        let desired = self.desired;
        let measured = plant.measure();
        let reported = plant.report(&measured);
        let feedback = step(self.pd, &mut self.controller, &measured.q, &desired);
        let tau = feedback + self.answer.cast::<f64>();
        let next = self.trajectory.at((self.tick + 1) as f64 * self.period_s);
        let sample = reported.map(|reported| JointSample {
            desired: motion_f32(&next),
            measured: Some(JointMeasurement {
                q: reported.q.cast(),
                tau: reported.tau.cast(),
            }),
        });
        if let Some(torque) = ask(sample.as_ref())? {
            self.answer = torque;
        }
        let record = TickRecord {
            t_s: self.tick as f64 * self.period_s,
            desired,
            q: *plant.q(),
            measured,
            reported,
            tau,
            feed_forward: self.answer,
            shares: None,
            flags: 0,
            stage: None,
        };
        plant.advance(&tau, self.period_s);
        self.desired = next;
        self.tick += 1;
        Ok(record)
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

/// Bandwidth of the speed estimate behind the derivative action, Hz. The difference of two 17-bit positions a
/// millisecond apart is worth 48 mrad/s, which unfiltered would be several N·m of noise.
const SPEED_BANDWIDTH_HZ: f64 = 60.0;

/// Gains of all joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PdConfig<const N: usize> {
    /// Proportional gain, N·m/rad.
    pub kp: Joints<N>,
    /// Derivative gain, N·m·s/rad.
    pub kd: Joints<N>,
    /// Share of a new speed difference that enters the estimate each tick.
    speed_blend: f64,
    inv_period: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct PdState<const N: usize> {
    previous_q: Joints<N>,
    speed: Joints<N>,
}

impl<const N: usize> PdConfig<N> {
    /// Gains for a loop of `bandwidth_hz`: `Kp = Ĩ ω²`, `Kd = 2 ζ Ĩ ω`, ζ = 0.7, with Ĩ the mean diagonal of the mass
    /// matrix over 64 seeded poses of the nominal model.
    pub fn tuned(model: &ReferenceModel<N>, bandwidth_hz: f64, period_s: f64) -> Self {
        const POSES: usize = 64;
        const DAMPING: f64 = 0.7;
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let mass = (0..POSES).fold(SMatrix::<f64, N, N>::zeros(), |sum, _| {
            let q = Joints::from_fn(|_, _| random.random_range(-PI..PI));
            sum + model.mass_matrix(&q) / POSES as f64
        });
        let inertia: Joints<N> = mass.diagonal();
        let omega = TAU * bandwidth_hz;
        let speed_step = TAU * SPEED_BANDWIDTH_HZ * period_s;
        Self {
            kp: inertia * (omega * omega),
            kd: inertia * (2.0 * DAMPING * omega),
            speed_blend: speed_step / (1.0 + speed_step),
            inv_period: 1.0 / period_s,
        }
    }
}

/// Joint torques `Kp (q_d − q) + Kd (qd_d − qd)`, N × N·m, with `qd` from filtered differences of `q`.
fn step<const N: usize>(
    config: &PdConfig<N>,
    state: &mut PdState<N>,
    q: &Joints<N>,
    desired: &State<N>,
) -> Joints<N> {
    let difference = (q - state.previous_q) * config.inv_period;
    state.speed += (difference - state.speed) * config.speed_blend;
    state.previous_q = *q;
    config.kp.component_mul(&(desired.q - q)) + config.kd.component_mul(&(desired.qd - state.speed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn doubling_the_bandwidth_makes_the_spring_four_times_as_stiff() {
        let robot = Robot::load("ur5").expect("built in");
        let model = ReferenceModel::<6>::new(&robot).expect("six joints");
        let [soft, stiff] = [3.0, 6.0].map(|hz| PdConfig::tuned(&model, hz, 1e-3));
        for j in 0..6 {
            assert!((stiff.kp[j] / soft.kp[j] - 4.0).abs() < 1e-12);
            assert!((stiff.kd[j] / soft.kd[j] - 2.0).abs() < 1e-12);
            // The reflected rotor alone is a lower bound of the inertia.
            let rotor = robot.joints[j].drive.rotor_inertia;
            assert!(soft.kp[j] > rotor * (TAU * 3.0).powi(2));
        }
    }
}
