//! Events on the arm: payloads and external torques.

use crate::dynamics::Joints;
use crate::robot::Link;

/// A body that the hand holds for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// The body, in the frame of the last link.
    pub body: Link,
    /// Pick-up time, s.
    pub from_s: f64,
    /// Release time, s.
    pub to_s: f64,
}

/// An external torque on the joints, for example a contact or a collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push<const N: usize> {
    /// Torque on every joint while it lasts, N·m; positive accelerates +q.
    pub torque: Joints<N>,
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

/// Time in which a push rises, and falls again, s.
const RISE_S: f64 = 0.01;

/// All events of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Events<const N: usize> {
    /// Payloads; the first one whose interval contains the time counts.
    pub payloads: Vec<Payload>,
    /// Pushes; they add up.
    pub pushes: Vec<Push<N>>,
}

impl<const N: usize> Default for Events<N> {
    fn default() -> Self {
        Self {
            payloads: Vec::new(),
            pushes: Vec::new(),
        }
    }
}

impl<const N: usize> Events<N> {
    /// Index of the payload in the hand at `t_s`.
    pub(super) fn payload_at(&self, t_s: f64) -> Option<usize> {
        // Half a nanosecond of slack: the sum of many steps is not exactly the time they make.
        let now = t_s + 5e-10;
        let held = |payload: &Payload| (payload.from_s..payload.to_s).contains(&now);
        self.payloads.iter().position(held)
    }

    /// Torque from outside at `t_s`, N·m.
    pub(super) fn push_at(&self, t_s: f64) -> Joints<N> {
        let mut torque = Joints::zeros();
        for push in &self.pushes {
            let inside = (t_s - push.from_s).min(push.to_s - t_s);
            torque += push.torque * (inside / RISE_S).clamp(0.0, 1.0);
        }
        torque
    }
}

impl Payload {
    /// A cube of `mass_kg` and of steel's third in density (2600 kg/m³), its centre at `com_m` in the last link's frame.
    pub fn cube(mass_kg: f64, com_m: [f64; 3], from_s: f64, to_s: f64) -> Self {
        let side = (mass_kg / 2600.0).cbrt();
        let moment = mass_kg * side * side / 6.0;
        Self {
            body: Link {
                mass: mass_kg,
                com: com_m.into(),
                inertia_com: nalgebra::Matrix3::identity() * moment,
            },
            from_s,
            to_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::State;
    use crate::plant::{Plant, PlantConfig};
    use crate::robot::{Perturbation, Robot};

    fn arm(events: Events<6>) -> Plant<6> {
        let robot = Robot::load("ur5")
            .expect("built in")
            .perturbed(1, &Perturbation::PLANT);
        let plant = Plant::new(&robot, PlantConfig::default(), 1).expect("six joints");
        plant.with_events(events)
    }

    #[test]
    fn a_payload_loads_the_joints_only_while_it_is_held() {
        let body = Payload::cube(3.0, [0.02, -0.01, 0.05], 0.010, 0.020);
        let mut plant = arm(Events {
            payloads: vec![body],
            pushes: Vec::new(),
        });
        let still = State::rest(Joints::<6>::zeros());
        let before = plant.true_torque(&still);
        let mut loads = Vec::new();
        for _ in 0..30 {
            plant.advance(&before, 1e-3);
            loads.push((plant.carried().is_some(), plant.true_torque(&still)));
        }
        for (tick, (carried, torque)) in loads.iter().enumerate() {
            // The payload is looked at when a step begins: after tick 10 its first step has run.
            assert_eq!(*carried, (10..20).contains(&tick), "tick {tick}");
            if *carried {
                // Stretched out, the shoulder carries a lever of 0.82 m and more.
                assert!((torque[1] - before[1]).abs() > 3.0 * 9.81 * 0.75);
            } else {
                assert!((torque - before).amax() < 1e-9);
            }
        }
    }

    #[test]
    fn a_push_moves_the_arm_but_not_the_torque_of_a_motion() {
        let mut torque = Joints::zeros();
        torque[0] = 40.0;
        let push = Push {
            torque,
            from_s: 0.05,
            to_s: 0.15,
        };
        let events = Events {
            payloads: Vec::new(),
            pushes: vec![push],
        };
        assert_eq!(events.push_at(0.04), Joints::<6>::zeros());
        assert!(
            (events.push_at(0.055)[0] - 20.0).abs() < 1e-9,
            "half way up"
        );
        assert_eq!(events.push_at(0.1), torque);
        let (mut pushed, mut left) = (arm(events), arm(Events::default()));
        let hold = left.true_torque(&State::rest(Joints::zeros()));
        for _ in 0..150 {
            pushed.advance(&hold, 1e-3);
            left.advance(&hold, 1e-3);
        }
        assert!((pushed.q() - left.q())[0] > 0.01);
        let motion = State {
            q: Joints::repeat(0.3),
            qd: Joints::repeat(1.0),
            qdd: Joints::repeat(2.0),
        };
        assert_eq!(pushed.true_torque(&motion), left.true_torque(&motion));
    }
}
