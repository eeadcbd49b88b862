//! Commissioning: what the profile states of the drives, checked on the arm step by step.
//!
//! Every check is one that the drives cannot pass by being wrong in the same way in both directions: positions against
//! turns by hand, torques against the acceleration of the described arm. The torque rises in steps to a tenth of the limit.
//! A joint that does not move by so little is no mistake: its torque is not determined.

mod torque;

use super::{BusError, BusPlayer, Network};
use crate::dynamics::{Joints, ReferenceModel};
use crate::robot::Link;
use foretorque::arm::Arm;
use foretorque_link::bus::{BusFault, FaultCause};
use foretorque_link::drives::{Frames, Order, Protocol};
use serde::{Deserialize, Serialize};

/// Angle by which each joint is turned by hand, rad.
const TURN_RAD: f64 = 0.5;
/// Largest relative error of a turn by hand.
const TURN_ERROR: f64 = 0.3;
/// Largest distance from the pose of rest, rad.
const ZERO_RAD: f64 = 0.1;
/// Largest torque of gravity in the pose of rest, part of the limit.
const RESTING: f64 = 0.03;
/// Last identifier that is tried when a drive does not answer.
const LAST_ID: u16 = 32;

/// Request to whoever stands beside the arm. The drives are off meanwhile.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// Keep clear: the loop moves every joint next.
    Clear,
    /// Put the arm into this pose, rad.
    Pose(Vec<f64>),
    /// Turn a joint, from 0, in its positive direction by this angle, rad.
    Turn {
        /// Joint, from 0.
        joint: usize,
        /// Angle, rad.
        by_rad: f64,
    },
    /// Fix this body to the last link, in whose frame it is given, or take every load off.
    Weight(Option<Link>),
    /// Be warned that sign and scale of the torque of a joint are not determined: the loop moves it next.
    Undetermined {
        /// Joint, from 0.
        joint: usize,
        /// Reason.
        reason: String,
    },
}

/// Step of commissioning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Every drive answers, and reports no fault and the scales of its profile.
    Find,
    /// Each joint turned by hand: identifier, sign, gear.
    Turn,
    /// Pose of rest: zeros.
    Zero,
    /// Torque of each joint, up to a tenth: sign and scale.
    Torque,
    /// Slow sweep of each joint in the loop, both ways: friction. The torque is that of the loop from here on.
    Friction,
    /// Slow sweeps aside of the pose of rest, without and with the known weight: gain of the torque.
    Weight,
}

impl Step {
    /// All steps, in their order.
    pub const ALL: [Self; 6] = [
        Self::Find,
        Self::Turn,
        Self::Zero,
        Self::Torque,
        Self::Friction,
        Self::Weight,
    ];
}

/// Findings of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// Turn that the drive reports over the turn by hand.
    pub turn_ratio: Option<f64>,
    /// Position in the pose of rest beyond the profile's, rad.
    pub zero_error_rad: Option<f64>,
    /// Torque at which the joint moves, N·m.
    pub breakaway_nm: Option<f64>,
    /// Torque that arrives, by the acceleration of the described arm, over the commanded one; `None` where it is not determined.
    pub torque_ratio: Option<f64>,
    /// Friction in a slow sweep, half the difference of both ways, N·m.
    pub friction_nm: Option<f64>,
    /// Torque of the known weight over the reported one, and its standard deviation; none where the weight has no lever.
    pub gain: Option<(f64, f64)>,
}

/// Arm that is being commissioned.
pub struct Commissioning<A: Arm<N, P>, W: Network, const N: usize, const P: usize> {
    /// Loop and bus.
    pub player: BusPlayer<A, W, N, P>,
    /// Findings so far.
    pub found: [Found; N],
    /// Known weight in the frame of the last link, for [`Step::Weight`].
    pub weight: Option<Link>,
    /// Described Coulomb friction, N × N·m; 0 where none is described.
    pub friction_nm: Joints<N>,
    /// Joints whose torque is not determined, with the reason.
    undetermined: Vec<(usize, String)>,
    model: ReferenceModel<N>,
    rest: Joints<N>,
}

fn silent(joint: usize) -> BusError {
    let (joint, cause) = (Some(joint as u8), FaultCause::Silent);
    BusError::Fault(BusFault { joint, cause })
}

/// Errors: the mistake of a joint that is not as it should be.
fn check(joint: usize, sound: bool, wrong: impl FnOnce() -> String) -> Result<(), BusError> {
    let sound = sound.then_some(());
    sound.ok_or_else(|| BusError::Mistake(joint, wrong()))
}

impl<A: Arm<N, P>, W: Network, const N: usize, const P: usize> Commissioning<A, W, N, P> {
    /// An arm whose drives are off.
    ///
    /// * `rest` pose in which it rests without torque, rad
    pub fn new(player: BusPlayer<A, W, N, P>, model: ReferenceModel<N>, rest: Joints<N>) -> Self {
        Self {
            player,
            found: [Found::default(); N],
            weight: None,
            friction_nm: Joints::zeros(),
            undetermined: Vec::new(),
            model,
            rest,
        }
    }

    /// Executes a step; it may be repeated. Without a weight there is nothing to weigh.
    ///
    /// Errors: the mistake that it finds, with joint, field and both values; a bus that has gone.
    pub fn step(&mut self, step: Step) -> Result<(), BusError> {
        match step {
            Step::Find => self.find(),
            Step::Turn => (0..N).try_for_each(|joint| self.turn(joint)),
            Step::Zero => self.zero(),
            Step::Torque => {
                self.zero()?;
                let outcome = (0..N).try_for_each(|joint| self.torque(joint));
                outcome.and(self.player.switch_off())?;
                for (joint, reason) in std::mem::take(&mut self.undetermined) {
                    let ask = Ask::Undetermined { joint, reason };
                    self.player.network.ask(&ask)?;
                }
                Ok(())
            }
            Step::Friction => {
                self.player.network.ask(&Ask::Clear)?;
                self.friction()
            }
            Step::Weight => match self.weight {
                Some(body) => self.weigh(&body),
                None => Ok(()),
            },
        }
    }

    /// Lets the drives answer for a while.
    fn listen(&mut self) -> Result<(), BusError> {
        let ticks = (0.1 / self.player.period_s()) as usize;
        for _ in 0..ticks {
            self.player.tick(None)?;
        }
        Ok(())
    }

    /// Positions that the drives report now, rad.
    ///
    /// Errors: the first drive that does not.
    fn reported_positions(&mut self) -> Result<Joints<N>, BusError> {
        let replies = |own: &Self| -> [u32; N] {
            let drives = own.player.controller.drives();
            std::array::from_fn(|joint| drives.counters(joint).replies)
        };
        // Replies from during a request are old.
        self.player.tick(None)?;
        let before = replies(self);
        self.listen()?;
        let after = replies(self);
        match (0..N).find(|&joint| after[joint] == before[joint]) {
            Some(joint) => Err(silent(joint)),
            None => Ok(self.player.positions().cast()),
        }
    }

    /// Largest torque of a joint, N·m: that of the arm or of its drive.
    fn limit(&self, joint: usize) -> f64 {
        let drive = self.player.controller.config().joints[joint].drive;
        f64::from(drive.torque_limit.min(A::limits()[joint].torque))
    }

    fn find(&mut self) -> Result<(), BusError> {
        let gravity = self.model.gravity_torques(&self.rest);
        for joint in 0..N {
            let most = RESTING * self.limit(joint);
            let (rest, gravity) = (self.rest[joint], gravity[joint]);
            check(joint, gravity.abs() <= most, || {
                format!(
                    "rest_rad {rest}: gravity is {gravity:.2} N·m there, more than {most:.2} N·m"
                )
            })?;
        }
        self.listen()?;
        for joint in 0..N {
            let counters = self.player.controller.drives().counters(joint);
            let config = self.player.controller.config().joints[joint];
            let (id, bus) = (config.drive.id, config.bus);
            if counters.replies == 0 {
                let answering = self.scan(joint)?.into_iter();
                let list = answering.map(|(bus, id)| format!("{id} on bus {bus}"));
                let list = match list.collect::<Vec<_>>().join(", ") {
                    none if none.is_empty() => "none".to_owned(),
                    list => list,
                };
                let problem =
                    format!("no drive answers at id {id} on bus {bus}; ids that answer: {list}");
                return Err(BusError::Mistake(joint, problem));
            }
            check(joint, counters.doubled <= counters.replies / 4, || {
                format!("two drives answer at id {id}")
            })?;
        }
        let ready = self.player.controller.drives().ready();
        ready.map_err(BusError::Fault)
    }

    /// Identifiers of the drives of a joint's kind that answer, with their buses.
    fn scan(&mut self, joint: usize) -> Result<Vec<(u8, u16)>, BusError> {
        let config = self.player.controller.config().joints;
        let mut found = Vec::new();
        let last = config.iter().map(|joint| joint.bus).max();
        // Nodes of an ODrive begin at 0, which is for all nodes elsewhere.
        let first = match config[joint].drive.protocol {
            Protocol::Odrive(_) => 0,
            _ => 1,
        };
        for bus in 0..=last.unwrap_or_default() {
            for id in first..=LAST_ID {
                let mut drive = config[joint].drive;
                drive.id = id;
                // Replies go to the host's identifier, which may be configured with the drive's own.
                let hosts = config.iter().map(|joint| joint.drive.host_id);
                let hosts: Vec<u16> = hosts.chain([0, id | 0x10]).collect();
                let mut frames = Frames::new();
                drive.order(Order::Disable, &mut frames);
                for frame in &frames {
                    self.player.network.send(bus, frame)?;
                }
                self.player.network.wait();
                self.player.network.wait();
                while let Some((from, frame)) = self.player.network.receive()? {
                    let answers = hosts.iter().any(|host| {
                        drive.host_id = *host;
                        drive.decode(&frame).is_some()
                    });
                    if answers && !found.contains(&(from, id)) {
                        found.push((from, id));
                    }
                }
            }
        }
        Ok(found)
    }

    fn turn(&mut self, joint: usize) -> Result<(), BusError> {
        let before = self.reported_positions()?;
        let turn = |by_rad| Ask::Turn { joint, by_rad };
        self.player.network.ask(&turn(TURN_RAD))?;
        let change = self.reported_positions()? - before;
        self.player.network.ask(&turn(-TURN_RAD))?;
        let ratio = change[joint] / TURN_RAD;
        let moved = (0..N).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs()));
        let moved = moved.unwrap_or(joint);
        let drive = self.player.controller.config().joints[joint].drive;
        check(joint, change[moved].abs() >= 0.02, || {
            format!("its position stays when it is turned by {TURN_RAD} rad")
        })?;
        let (id, other) = (drive.id, moved + 1);
        check(joint, moved == joint, || {
            format!(
                "id {id} is not its drive: turning it moves the position of joint {other}; are ids swapped?"
            )
        })?;
        let reversed = ratio < 0.0 && (-ratio - 1.0).abs() < TURN_ERROR;
        check(joint, !reversed, || {
            let (sign, other) = (drive.sign, -drive.sign);
            format!("sign {sign}: a positive turn is reported as negative, sign must be {other}")
        })?;
        check(joint, (ratio - 1.0).abs() <= TURN_ERROR, || {
            let (gear, is) = (f64::from(drive.gear), f64::from(drive.gear) * ratio.abs());
            format!(
                "gear {gear}: a turn of {TURN_RAD} rad is reported as {:.3} rad, gear is about {is:.3}",
                change[joint]
            )
        })?;
        self.found[joint].turn_ratio = Some(ratio);
        Ok(())
    }

    fn zero(&mut self) -> Result<(), BusError> {
        let pose = self.rest.iter().copied().collect();
        self.player.network.ask(&Ask::Pose(pose))?;
        let here = self.reported_positions()?;
        for joint in 0..N {
            let (here, rest) = (here[joint], self.rest[joint]);
            let error = here - rest;
            check(joint, error.abs() <= ZERO_RAD, || {
                let zero = f64::from(self.player.controller.config().joints[joint].drive.zero);
                let is = zero - error;
                format!(
                    "zero {zero}: {here:.3} rad are reported in the pose of rest of {rest:.3} rad, zero is about {is:.3}"
                )
            })?;
            self.found[joint].zero_error_rad = Some(error);
        }
        Ok(())
    }
}
