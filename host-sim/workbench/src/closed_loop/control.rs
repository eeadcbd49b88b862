//! The joint controller beside the feed-forward: proportional and derivative action on the measured position.

use crate::dynamics::Joints;
use crate::dynamics::ReferenceModel;
use nalgebra::SMatrix;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

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

/// State of the controller: the position before and the speed estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PdState<const N: usize> {
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

impl<const N: usize> PdState<N> {
    /// At rest at `q`, rad.
    pub fn new(q: Joints<N>) -> Self {
        Self {
            previous_q: q,
            speed: Joints::zeros(),
        }
    }
}

/// Joint torques `Kp (q_d − q) + Kd (qd_d − qd)`, N × N·m, with `qd` from filtered differences of `q`.
pub fn step<const N: usize>(
    config: &PdConfig<N>,
    state: &mut PdState<N>,
    q: &Joints<N>,
    desired_q: &Joints<N>,
    desired_qd: &Joints<N>,
) -> Joints<N> {
    let difference = (q - state.previous_q) * config.inv_period;
    state.speed += (difference - state.speed) * config.speed_blend;
    state.previous_q = *q;
    config.kp.component_mul(&(desired_q - q)) + config.kd.component_mul(&(desired_qd - state.speed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn doubling_the_bandwidth_makes_the_spring_four_times_as_stiff() {
        let robot = Robot::load("ur5").expect("built in");
        let model = ReferenceModel::<6>::new(&robot).expect("six joints");
        let (soft, stiff) = (
            PdConfig::tuned(&model, 3.0, 1e-3),
            PdConfig::tuned(&model, 6.0, 1e-3),
        );
        for j in 0..6 {
            assert!((stiff.kp[j] / soft.kp[j] - 4.0).abs() < 1e-12);
            assert!((stiff.kd[j] / soft.kd[j] - 2.0).abs() < 1e-12);
            // The reflected rotor alone is a lower bound of the inertia.
            let rotor = robot.joints[j].drive.rotor_inertia;
            assert!(soft.kp[j] > rotor * (TAU * 3.0).powi(2));
        }
    }

    #[test]
    fn no_error_asks_for_no_torque() {
        let robot = Robot::load("ur5").expect("built in");
        let model = ReferenceModel::<6>::new(&robot).expect("six joints");
        let config = PdConfig::tuned(&model, 6.0, 1e-3);
        let q = Joints::repeat(0.3);
        let mut state = PdState::new(q);
        assert_eq!(
            step(&config, &mut state, &q, &q, &Joints::zeros()),
            Joints::<6>::zeros()
        );
    }
}
