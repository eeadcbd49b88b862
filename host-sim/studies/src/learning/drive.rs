//! One arm, one board, one scenario: the one loop that all of them go through.

use super::controller::Controller;
use super::identified::Starts;
use super::scenario::Scenario;
use super::watch::Watch;
use super::world::{N, PERIOD_S, World};
use foretorque::joint::JointSample;
use foretorque::learning::{Decision, LearnerStatistics, PayloadEstimate};
use foretorque_link::safety::SafetyStatus;
use foretorque_workbench::closed_loop::{Answer, ClosedLoop, motion_f32};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::metrics::TrackingError;
use foretorque_workbench::plant::Payload;
use std::convert::Infallible;
use std::error::Error;

/// What is at the other end of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Board {
    /// Nothing: PD control alone.
    None,
    /// A board that never learns.
    Frozen,
    /// A board with the firmware's configuration, everything switched on.
    Learning,
    /// The same, but its networks are not trained.
    NoNetwork,
}

/// Feed-forward error and tracking error of one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Second {
    /// Sums over the moving rows of each joint: squared error and squared torque, (N·m)².
    pub(super) error: [f64; N],
    pub(super) torque: [f64; N],
    pub(super) tracking: TrackingError<N>,
}

/// A look at the active set on the unseen path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) t_s: f64,
    /// NRMSE of moving rows, ratio.
    pub(super) nrmse: f64,
    /// The error, in torque limits, over what the payload in the hand, or last in it, adds.
    pub(super) of_step: Option<f64>,
}

/// All that is kept of one run.
#[derive(Clone, Debug, Default)]
pub(super) struct Trace {
    pub(super) ticks: usize,
    pub(super) seconds: Vec<Second>,
    pub(super) looks: Vec<Look>,
    /// Change of the torque on the unseen path from before each pick to after the release, RMS ratio.
    pub(super) restored: Vec<f64>,
    /// Largest change of any parameter from one second after the stop to the end, in prior standard deviations.
    pub(super) drift: f64,
    pub(super) statistics: LearnerStatistics,
    /// What the guard decided: time, s, and the decision.
    pub(super) decisions: Vec<(f64, Decision)>,
    /// Of every payload, one second after it was picked: what the board believes, and the truth.
    pub(super) weighed: Vec<(PayloadEstimate, Payload)>,
    /// Standard deviations of mass, kg, and centre of mass, m, that the torque noise alone leaves then, and the truth.
    pub(super) weighable: Vec<(f64, f64, Payload)>,
    /// Lowest trust figure.
    pub(super) least_trust: f32,
    /// Ticks with each of these flags.
    pub(super) flags: Vec<(&'static str, u32)>,
    pub(super) late_sets: u32,
    /// Checksum (FNV-1a) of all torques, bit for bit.
    pub(super) checksum: u64,
    /// Whether torque left the board at the end.
    pub(super) safety: SafetyStatus,
    /// The sample that the board was armed with.
    pub(super) arming: Option<JointSample<N>>,
    /// The samples that went in and the torques that came out, where they were asked for.
    pub(super) tape: Vec<(Option<JointSample<N>>, [u32; N])>,
}

/// What to run.
#[derive(Clone, Copy)]
pub(super) struct Run<'w> {
    pub(super) world: &'w World,
    pub(super) starts: &'w Starts,
    pub(super) scenario: &'w Scenario,
    pub(super) bandwidth_hz: f64,
    pub(super) board: Board,
    pub(super) quick: bool,
    /// Keep samples and torques.
    pub(super) tape: bool,
}

impl Run<'_> {
    /// Ticks it takes.
    pub(super) fn ticks(&self) -> usize {
        (self.scenario.length_s(self.quick) / PERIOD_S).round() as usize
    }

    /// Runs it.
    pub(super) fn trace(&self, progress: &dyn Fn(usize)) -> Result<Trace, Box<dyn Error>> {
        let Self {
            world, scenario, ..
        } = *self;
        let pd = world.pd(self.bandwidth_hz);
        let path = scenario.trajectory(world, self.quick);
        let events = scenario.events(world, self.quick);
        let plant = world.plant(scenario.plant, scenario.viscous, scenario.noise_stream())?;
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
        board.arm(&arming).map_err(|reason| format!("{reason:?}"))?;
        let mut watch = Watch::new(self, events, &path, &plant);
        let mut acting = Joints::zeros();
        for tick in 0..self.ticks() {
            watch.look(tick, &board, &plant);
            watch.decisions(tick, &board);
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
            watch.add(record.t_s, &record.desired.qd, &needed, &acting);
            watch.weigh(tick, &motion_f32(&record.desired));
            watch.track(record.t_s, &(record.desired.q - record.q));
            if let Some(torque) = torque {
                watch.count(torque.flags, &torque.total.into());
                if self.tape {
                    let bits = <[f32; N]>::from(torque.total).map(f32::to_bits);
                    watch.trace.tape.push((asked, bits));
                }
            }
            acting = record.feed_forward.cast();
            if tick % 1000 == 999 {
                progress(1000);
            }
        }
        watch.trace.arming = Some(arming);
        watch.trace.safety = board.safety();
        Ok(watch.finish(&board, &plant, self.ticks()))
    }
}
