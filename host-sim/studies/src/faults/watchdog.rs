//! Simulated watchdog, fed through the task check-in of the firmware.

use super::Campaign;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::ConfigError;
use foretorque_link::safety::{SafetyReason, SafetyState, Task, TaskCheckIn};
use foretorque_link::session::{BoardDescription, Mailboxes, NoClock, NoLocalSensor, Session};
use foretorque_link::wire::{
    BoardMessage, Decoder, FrameBuffer, HostMessage, ResetReason, SampleFrame,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Periods without food after which the watchdog bites.
const HUNGER: u32 = 100;

/// Counts down, and is fed.
struct SimulatedWatchdog {
    left: u32,
}

impl SimulatedWatchdog {
    /// One period goes by. True when it bites.
    fn period(&mut self, fed: bool) -> bool {
        self.left = if fed { HUNGER } else { self.left - 1 };
        self.left == 0
    }
}

/// `times` lives of a board in which one task, any of them, stops answering at some moment. The watchdog must bite, the
/// board must come back disarmed with the reason, refuse to be armed until that was taken note of, and then work.
pub fn watchdog_bites(times: u32, seed: u64) -> Result<Campaign, ConfigError> {
    let mut campaign = Campaign::new("watchdog bite", "native");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..times {
        let silent = Task::ALL[random.random_range(0..Task::ALL.len())];
        let end = random.random_range(0..1000);
        let tasks = TaskCheckIn::new();
        let mut watchdog = SimulatedWatchdog { left: HUNGER };
        let bite = (0..end + 2 * HUNGER).find(|&period| {
            for task in Task::ALL {
                if task != silent || period < end {
                    tasks.check_in(task);
                }
            }
            watchdog.period(tasks.complete())
        });
        campaign.injected += 1;
        // Not before the task stopped, and at once when the hunger is over.
        let in_time = bite.is_some_and(|bite| (end..end + HUNGER).contains(&bite));
        let (quiet, back) = restarted()?;
        campaign.wrong_torques += u64::from(!quiet);
        campaign.recovered += u64::from(in_time && back);
    }
    Ok(campaign)
}

/// A session after a bite: no torque before it was armed anew, and it can be.
fn restarted() -> Result<(bool, bool), ConfigError> {
    let board = BoardDescription {
        reset_reason: ResetReason::Watchdog,
        ..BoardDescription::plain(NoClock)
    };
    let mut session = Session::<Ur5, JOINTS, PARAMETERS>::new(board)?;
    let mut mailboxes = Mailboxes::new();
    let still = JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q: JointVector::zeros(),
            tau: JointVector::zeros(),
        }),
    };
    let sample = HostMessage::Sample(SampleFrame::new(&still));
    let mut sequence = 0;
    let mut ask = |message: &HostMessage<JOINTS>,
                   session: &mut Session<Ur5, JOINTS, PARAMETERS>| {
        let (mut question, mut answer) = (FrameBuffer::new(), FrameBuffer::new());
        sequence += 1;
        // A frame always fits an empty buffer.
        let _ = question.push(sequence, message);
        session.receive(
            question.as_bytes(),
            &mut mailboxes,
            &mut answer,
            &mut NoLocalSensor,
        );
        received(answer.as_bytes())
    };
    let mut quiet = true;
    for message in [
        &sample,
        &sample,
        &sample,
        &sample,
        &HostMessage::Arm,
        &sample,
    ] {
        if let Some(BoardMessage::Torque(torque)) = ask(message, &mut session) {
            quiet &= torque.total.iter().all(|&torque| torque == 0.0);
        }
    }
    let reported = session.safety().state == SafetyState::Fault
        && session.safety().reason == SafetyReason::Restarted;
    let cleared = ask(&HostMessage::ClearFault, &mut session) == Some(BoardMessage::Ack);
    let armed = ask(&HostMessage::Arm, &mut session) == Some(BoardMessage::Ack);
    Ok((
        quiet,
        reported && cleared && armed && session.torque_enabled(),
    ))
}

fn received(bytes: &[u8]) -> Option<BoardMessage<JOINTS>> {
    let mut decoder = Decoder::new();
    let mut message = None;
    for &byte in bytes {
        if let Some(Ok(frame)) = decoder.push(byte) {
            message = frame.message().ok();
        }
    }
    message
}
