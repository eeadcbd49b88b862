//! The loop with its network, its learner and its clock.

use super::{BusError, Network};
use crate::dynamics::Joints;
use crate::trajectory::via::ViaPath;
use foretorque::arm::Arm;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::learning::Learner;
use foretorque_link::bank::Parameters;
use foretorque_link::bus::{BusConfig, BusController, BusFault, BusPhase, BusTick, FaultCause};
use foretorque_link::drives::Contradiction;
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::session::{LearnerMailbox, NoClock};

/// Longest time for drives to answer at the start, s.
const LISTENING_S: f64 = 0.5;
/// Longest time for drives to switch on, s.
const ARMING_S: f64 = 1.0;
/// Longest time for drives to switch off, s.
const SWITCH_OFF_S: f64 = 0.5;
/// Fastest joint of the approach, rad/s.
const APPROACH_RAD_S: f64 = 0.4;

/// Controller of an arm on a bus of whatever kind.
pub struct BusPlayer<A: Arm<N, P>, W: Network, const N: usize, const P: usize> {
    /// The loop.
    pub controller: BusController<A, N, P>,
    /// The bus.
    pub network: W,
    /// The learner.
    pub learner: Learner<A, N, P>,
    /// Faults that the drives report before they are switched on are cleared.
    pub clears_faults: bool,
    mailbox: LearnerMailbox<N, P>,
    /// Delays of the ticks so far behind their time, µs.
    delays_us: Vec<f32>,
    /// Time of the periods that were left out, s.
    left_out_s: f64,
    /// Desired position of the last tick, rad.
    desired: Option<JointVector<N>>,
}

impl<A: Arm<N, P>, W: Network, const N: usize, const P: usize> BusPlayer<A, W, N, P> {
    /// A loop with its drives off. Learning starts from `parameters` and their standard deviations.
    ///
    /// Errors: a profile that contradicts itself or the arm.
    pub fn new(
        config: BusConfig<N>,
        parameters: &Parameters<N, P>,
        network: W,
    ) -> Result<Self, Contradiction> {
        let controller = BusController::new(config, parameters)?;
        let (period, against) = (config.period_s, "the limits of the learner at a period of");
        let limits = config.learner::<A, P>();
        let mut learner = Learner::EMPTY;
        learner
            .restart_with(limits, &parameters.set, &parameters.start)
            .map_err(|_| Contradiction::new("period_s", period, against, period))?;
        Ok(Self {
            controller,
            network,
            learner,
            clears_faults: false,
            mailbox: LearnerMailbox::default(),
            delays_us: Vec::new(),
            left_out_s: 0.0,
            desired: None,
        })
    }

    /// Period, s.
    pub fn period_s(&self) -> f64 {
        f64::from(self.controller.config().period_s)
    }

    /// Waits for the next period. One that comes later than its end shifts those after it.
    pub(super) fn wait(&mut self) {
        let delay = self.network.wait();
        self.delays_us.push(delay.as_secs_f32() * 1e6);
        if delay.as_secs_f64() >= self.period_s() {
            self.left_out_s += delay.as_secs_f64();
        }
    }

    /// Time of the periods that were left out so far, because a tick came too late, s.
    pub fn left_out_s(&self) -> f64 {
        self.left_out_s
    }

    /// One period: waits for its begin, takes the replies, sends the commands, learns.
    ///
    /// Errors: a bus that has gone; the drives are then out of reach, and their watchdogs end the torque.
    pub fn tick(&mut self, desired: Option<&JointMotion<N>>) -> Result<BusTick<N>, BusError> {
        self.wait();
        self.desired = desired.map(|desired| desired.q);
        while let Some((bus, frame)) = self.network.receive()? {
            self.controller.receive(bus, &frame);
        }
        if self.network.is_off() {
            self.controller.bus_off();
        }
        let (network, mut sent) = (&mut self.network, Ok(()));
        let tick = self
            .controller
            .tick(desired, &mut self.mailbox, |bus, frame| {
                let outcome = network.send(bus, frame);
                if sent.is_ok() {
                    sent = outcome;
                }
            });
        sent?;
        self.mailbox.work(&mut self.learner, &NoClock);
        Ok(tick)
    }

    /// Waits for every drive, and switches them on where the arm stands: the positions there, rad.
    ///
    /// Errors: a bus without an answer, the reason against arming; every drive that was reached is off again.
    pub fn arm(&mut self) -> Result<JointVector<N>, BusError> {
        let outcome = self.switch_on();
        if outcome.is_err() {
            // The error is the one that stopped the arming, not one that hinders its end.
            let _ = self.park();
        }
        outcome
    }

    fn switch_on(&mut self) -> Result<JointVector<N>, BusError> {
        let ticks = |time_s: f64| (time_s / self.period_s()) as usize + 1;
        let (listening, arming) = (ticks(LISTENING_S), ticks(ARMING_S));
        let mut refusal = None;
        for _ in 0..listening {
            self.rest_tick()?;
            refusal = self.controller.arm().err();
            match refusal {
                None => break,
                Some(BusFault {
                    cause: FaultCause::Drive(_),
                    ..
                }) if self.clears_faults => {
                    // What hinders it is the next refusal.
                    let _ = self.controller.clear();
                }
                Some(_) => {}
            }
        }
        if let Some(fault) = refusal {
            let answered = (0..N).any(|joint| self.controller.drives().counters(joint).replies > 0);
            return Err(match answered {
                true => BusError::Fault(fault),
                false => BusError::Quiet(self.network.name()),
            });
        }
        for _ in 0..arming {
            self.rest_tick()?;
            if let BusPhase::Running(_) = self.controller.drives().phase() {
                return Ok(self.positions());
            }
            if let Some(fault) = self.controller.drives().fault() {
                return Err(BusError::Fault(fault));
            }
        }
        Err(BusError::Stopped(self.controller.status().reason))
    }

    /// Moves from where the arm stands to `target`, and waits there until the arm has settled.
    ///
    /// Errors: as [`check`](Self::check).
    pub fn approach(&mut self, target: &Joints<N>) -> Result<(), BusError> {
        let start = self.desired.unwrap_or_else(|| self.positions());
        let start: Joints<N> = start.cast();
        let duration_s = (1.875 * (target - start).amax() / APPROACH_RAD_S).max(0.5);
        let path = ViaPath::through(&[start, *target], duration_s);
        let ticks = ((duration_s + 0.5) / self.period_s()) as usize;
        for tick in 0..ticks {
            let t_s = (tick as f64 + 0.5) * self.period_s();
            self.tick(Some(&crate::closed_loop::motion_f32(&path.at(t_s))))?;
            self.check()?;
        }
        Ok(())
    }

    /// Errors: the reason that has ended the torque.
    pub fn check(&self) -> Result<(), BusError> {
        if let Some(fault) = self.controller.drives().fault() {
            return Err(BusError::Fault(fault));
        }
        let status = self.controller.status();
        let armed = (status.state == SafetyState::Armed).then_some(());
        armed.ok_or(BusError::Stopped(status.reason))
    }

    /// Ramps the torque to zero, lets the drives damp, and switches them off, whatever happens meanwhile.
    ///
    /// Errors: the first of a bus that has gone and an interrupt; a drive that stays on.
    pub fn park(&mut self) -> Result<SafetyReason, BusError> {
        self.controller.disarm();
        let mut outcome = Ok(());
        let most = (2.0 / self.period_s()) as usize;
        for _ in 0..most {
            outcome = outcome.and(self.tick(None).map(drop));
            if self.controller.drives().phase() == BusPhase::Off {
                break;
            }
        }
        outcome.and(self.switch_off())?;
        Ok(self.controller.status().reason)
    }

    /// Sends the drives of a loop that is off the order to switch off, until all report so.
    ///
    /// Errors: as [`park`](Self::park).
    pub(super) fn switch_off(&mut self) -> Result<(), BusError> {
        let most = (SWITCH_OFF_S / self.period_s()) as usize;
        let mut outcome = Ok(());
        // The order may be lost once.
        for tick in 0..most.max(16) {
            if tick >= 16 && self.controller.drives().still_on().is_none() {
                break;
            }
            outcome = outcome.and(self.tick(None).map(drop));
        }
        outcome?;
        match self.controller.drives().still_on() {
            None => Ok(()),
            joint => {
                let cause = FaultCause::StillOn;
                Err(BusError::Fault(BusFault { joint, cause }))
            }
        }
    }

    /// Median, 99.9th percentile and largest delay of the ticks behind their time, µs.
    pub fn jitter_us(&self) -> [f32; 3] {
        let mut sorted = self.delays_us.clone();
        sorted.sort_by(f32::total_cmp);
        [0.5, 0.999, 1.0].map(|share| {
            let place = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
            sorted.get(place).copied().unwrap_or_default()
        })
    }

    /// Last known positions, rad.
    pub fn positions(&self) -> JointVector<N> {
        let known = self.controller.drives().positions();
        known.unwrap_or_else(JointVector::zeros)
    }

    /// A period in which the arm is to stay where it is.
    fn rest_tick(&mut self) -> Result<(), BusError> {
        let here = self.controller.drives().positions().map(|q| JointMotion {
            q,
            ..JointMotion::zero()
        });
        self.tick(here.as_ref()).map(drop)
    }
}
