use super::*;
use crate::excitation::{ExcitationCommand, ExcitationState};
use crate::safety::SafetyStatus;
use foretorque::feedforward::{FeedForwardScratch, step};

const ZERO: [f32; N] = [0.0; N];

fn status(torque: &TorqueFrame<N>) -> (SafetyState, SafetyReason) {
    (torque.safety.state, torque.safety.reason)
}

#[test]
fn torque_flows_only_between_arming_and_disarming() {
    let mut board = Board::new();
    let refused = no_torque(SafetyReason::NoSample);
    assert_eq!(board.request(HostMessage::Arm), refused);
    for k in 0..50 {
        let torque = board.sample(k);
        assert_eq!(torque.total, ZERO);
        assert_ne!(torque.shares, [0.0; 3], "the shares are reported");
        assert_eq!(torque.safety, SafetyStatus::default());
    }
    assert!(!board.session.torque_enabled());
    board.acknowledged(HostMessage::Arm);
    board.sample(50);
    assert!(board.session.torque_enabled());
    (51..100).for_each(|k| _ = board.sample(k));
    board.acknowledged(HostMessage::Disarm);
    let mut ramp = Vec::new();
    while board.session.torque_enabled() {
        ramp.push(board.sample(100).total[1].abs());
    }
    assert!(ramp.is_sorted_by(|a, b| a >= b), "{ramp:?}");
    let after = board.sample(100);
    assert_eq!(after.total, ZERO);
    let disarmed = (SafetyState::Disarmed, SafetyReason::Disarmed);
    assert_eq!(status(&after), disarmed);
}

/// A sample of the arm at rest at the position 0.
fn rest() -> HostMessage<N> {
    let mut sample = sample(0);
    sample.desired = JointMotion::zero();
    sample.measured.as_mut().unwrap().q.fill(0.0);
    HostMessage::Sample(SampleFrame::new(&sample))
}

/// A board with an excitation in which no joint moves, at the position 0.
fn resting() -> Board {
    let mut board = Board::new();
    let program = keys::excitation();
    assert_eq!(board.upload_excitation(&program, None), ACK);
    (0..300).for_each(|_| _ = board.send(&rest()));
    board
}

/// That board playing it; `armed` or not.
fn playing(armed: bool) -> (Board, HostMessage<N>) {
    let (mut board, sample) = (resting(), rest());
    if armed {
        board.acknowledged(HostMessage::Arm);
    }
    (0..100).for_each(|_| _ = board.send(&sample));
    board.request(HostMessage::Excitation(ExcitationCommand::Start));
    let mut ticks = 0;
    while board.session.controller.player.state() != ExcitationState::Playing {
        board.send(&sample);
        ticks += 1;
        assert!(ticks < 1000);
    }
    assert_eq!(board.session.torque_enabled(), armed);
    (board, sample)
}

#[test]
fn what_ends_the_torque_lets_a_played_motion_come_to_rest() {
    use ExcitationCommand::{Release, Status};
    use HostMessage::{Arm, Disarm, Hello, Stop};
    let state = |board: &Board| board.session.controller.player.state();
    for (armed, end) in [
        (true, Stop),
        (true, Disarm),
        (true, Hello),
        (false, Stop),
        (false, Hello),
    ] {
        // Orders to the player that change nothing come between.
        for asks in [None, Some(Status), Some(Release)] {
            let (mut board, sample) = playing(armed);
            board.send(&end);
            asks.map(|asks| board.request(HostMessage::Excitation(asks)));
            (0..2).for_each(|_| _ = board.send(&sample));
            assert_eq!(state(&board), ExcitationState::Stopping, "{armed} {end:?}");
            (0..2000).for_each(|_| _ = board.send(&sample));
            assert_eq!(state(&board), ExcitationState::Holding, "{armed} {end:?}");
        }
    }
    // A disarmed board has no torque to end, and a fault of a drive ends that of an armed one.
    let (mut board, sample) = playing(false);
    board.acknowledged(Disarm);
    (0..10).for_each(|_| _ = board.send(&sample));
    assert_eq!(state(&board), ExcitationState::Playing);
    let (mut board, sample) = playing(true);
    board.session.torque_off(SafetyReason::Drive);
    board.request(HostMessage::Excitation(Status));
    (0..2).for_each(|_| _ = board.send(&sample));
    assert_eq!(state(&board), ExcitationState::Stopping);
    // Torque that flowed for one tick has ended, too.
    let (mut board, sample) = playing(false);
    board.acknowledged(Arm);
    board.send(&sample);
    board.acknowledged(Disarm);
    (0..2).for_each(|_| _ = board.send(&sample));
    assert_eq!(state(&board), ExcitationState::Stopping);
}

#[test]
fn a_start_after_a_silence_that_ended_the_torque_waits_for_its_sample() {
    let mut board = resting();
    let sample = rest();
    board.acknowledged(HostMessage::Arm);
    (0..100).for_each(|_| _ = board.send(&sample));
    assert!(board.session.torque_enabled());
    (0..4000).for_each(|_| _ = board.timer());
    assert!(!board.session.torque_enabled());
    board.request(HostMessage::Excitation(ExcitationCommand::Start));
    (0..1000).for_each(|_| _ = board.send(&sample));
    let state = board.session.controller.player.state();
    assert!(state.is_active(), "{state:?}");
}

#[test]
fn a_torque_held_back_rises_at_the_slew_limit() {
    for pacing in [Pacing::Link, Pacing::SysTick] {
        let mut board = timed(pacing);
        (0..50).for_each(|_| _ = board.period(Some(sample(0))));
        board.acknowledged(HostMessage::Arm);
        let slew = board.session.feed_forward().config().slew_per_tick;
        for k in 1..4 {
            let torque = board.period(Some(sample(0))).unwrap();
            for (torque, slew) in torque.total.iter().zip(slew) {
                assert!(torque.abs() <= 1.0001 * k as f32 * slew, "{pacing:?}");
            }
        }
    }
}

#[test]
fn an_armed_board_passes_its_feed_forward_bit_for_bit() {
    let mut board = Board::armed();
    let mut bare = *board.session.feed_forward().state();
    let config = *board.session.feed_forward().config();
    let mut scratch = FeedForwardScratch::new();
    for k in 0..400 {
        let received = SampleFrame::new(&sample(k)).sample(&[0.0; N]);
        let wanted = *step::<Ur5, N, P>(&config, &mut bare, &mut scratch, &received);
        let given = board.sample(k);
        let bits = |total: [f32; N]| total.map(f32::to_bits);
        assert_eq!(bits(given.total), bits(wanted.total.into()), "tick {k}");
    }
}

#[test]
fn a_stop_with_an_old_number_acts_before_the_next_reply() {
    let mut board = Board::armed();
    let replies = board.receive(&frame(board.sequence, &HostMessage::Stop));
    assert_eq!(replies, [(board.sequence, ACK)]);
    assert!(!board.session.torque_enabled());
    let after = board.sample(0);
    assert_eq!(after.total, ZERO);
    assert_eq!(status(&after), (SafetyState::Fault, SafetyReason::Stopped));
    let refused = no_torque(SafetyReason::Stopped);
    assert_eq!(board.request(HostMessage::Arm), refused);
    // A reset of the session clears no fault.
    board.acknowledged(HostMessage::Reset);
    assert_eq!(board.request(HostMessage::Arm), refused);
    board.acknowledged(HostMessage::ClearFault);
    board.arm();
}

#[test]
fn nothing_is_written_while_torque_flows_or_learning_is_on() {
    for (armed, reason) in [(true, NackReason::Armed), (false, NackReason::LearningOn)] {
        let mut board = if armed { Board::armed() } else { Board::new() };
        let learning = !armed;
        board.acknowledged(HostMessage::Learning { on: learning });
        board.sample(0);
        let bank = uploaded();
        let before = board.read();
        let refused = nack(reason);
        assert_eq!(board.commit(&bank, None), refused);
        for message in [
            write(&bank, 0),
            HostMessage::Save,
            HostMessage::Restore,
            HostMessage::Configure(Configuration::default()),
        ] {
            assert_eq!(board.request(message), refused);
        }
        if armed {
            assert_eq!(board.request(HostMessage::Reset), refused);
        }
        assert_eq!(board.read(), before);
        assert_eq!(board.session.torque_enabled(), armed);
    }
}

#[test]
fn a_hot_motor_ends_the_torque_of_all_whoever_measures_it() {
    for of_host in [true, false] {
        let mut board = Board::armed();
        let mut frame = SampleFrame::new(&sample(0));
        if of_host {
            frame.temperature_c = 101;
        } else {
            board.session.note_temperature(2, 100);
        }
        (0..20).for_each(|_| _ = board.send(&HostMessage::Sample(frame)));
        let hot = (SafetyState::Fault, SafetyReason::MotorHot);
        assert_eq!(status(&board.sample(0)), hot);
    }
}

#[test]
fn requests_reach_the_learner_one_at_a_time() {
    let mut board = Board::new();
    let request = |code| HostMessage::Request { code };
    for unknown in [0, 5, 6, 200] {
        let reply = board.request(request(unknown));
        assert_eq!(reply, nack(NackReason::NotCapable));
    }
    board.acknowledged(request(1));
    assert_eq!(board.request(request(3)), nack(NackReason::Busy));
    let waits = board.mailboxes.learner.exchange.request;
    assert_eq!(waits, Some((1, foretorque::learning::Request::Snapshot)));
    board.sample(0);
    board.learn();
    board.acknowledged(request(3));
}

/// A board with a timer beside the samples, ready to be armed.
fn timed(pacing: Pacing) -> Board {
    let mut board = Board::new();
    board.pace(pacing);
    for _ in 0..ARM_SAMPLES {
        assert_eq!(board.period(Some(sample(0))).unwrap().total, ZERO);
    }
    board
}

#[test]
fn c2_samples_older_than_the_time_out_arm_no_board() {
    let refused = no_torque(SafetyReason::NoSample);
    for pacing in [Pacing::Link, Pacing::SysTick] {
        for (silent, armed) in [(49, true), (51, false), (1000, false), (100_000, false)] {
            let mut board = timed(pacing);
            (0..silent).for_each(|_| _ = board.period(None));
            let reply = if armed { &ACK } else { &refused };
            let context = format!("{pacing:?}, {silent} periods");
            assert_eq!(board.request(HostMessage::Arm), *reply, "{context}");
            assert_eq!(board.session.torque_enabled(), armed);
            if !armed {
                // One sample does not make the earlier ones fresh.
                board.period(Some(sample(0)));
                assert_eq!(board.request(HostMessage::Arm), refused, "{context}");
                (0..2).for_each(|_| _ = board.period(Some(sample(0))));
                board.acknowledged(HostMessage::Arm);
            }
        }
    }
}

#[test]
fn c2_an_arm_that_moved_since_arming_gets_no_torque() {
    use SafetyReason::{DesiredJump, DesiredNotFinite, EffortRange, None, PositionJump, TooFar};
    type Change = fn(&mut JointSample<N>);
    let cases: [(Change, SafetyReason); 6] = [
        (|s| s.measured.as_mut().unwrap().q[1] += 0.8, PositionJump),
        (|s| s.desired.q[1] += 0.8, DesiredJump),
        (|s| s.desired.qd[0] = f32::NAN, DesiredNotFinite),
        (|s| s.measured.as_mut().unwrap().tau[5] = 90.0, EffortRange),
        // In 40 periods a joint can move so far.
        (|s| s.measured.as_mut().unwrap().q[5] += 0.21, TooFar),
        // Near enough to the last measurement.
        (|s| s.measured = Option::None, None),
    ];
    for pacing in [Pacing::Link, Pacing::SysTick] {
        for (change, reason) in cases {
            let mut board = timed(pacing);
            board.acknowledged(HostMessage::Arm);
            if reason == TooFar {
                for _ in 0..40 {
                    let torque = board.period(Option::None);
                    assert!(torque.is_none_or(|torque| torque.total == ZERO));
                }
                assert!(board.session.torque_enabled());
            }
            let mut changed = sample(0);
            change(&mut changed);
            let flows = reason == None;
            let state = if flows {
                SafetyState::Armed
            } else {
                SafetyState::Disarmed
            };
            for k in 0..21 {
                let torque = board.period(Some(changed)).unwrap();
                let context = format!("{pacing:?}, {reason:?}");
                assert_eq!(torque.total != ZERO, flows, "{context}");
                if k == 0 {
                    assert_eq!(status(&torque), (state, reason), "{context}");
                    assert_eq!(board.session.torque_enabled(), flows);
                }
            }
        }
    }
}

#[test]
fn m6_a_clock_too_slow_for_the_period_is_reported_and_refuses_to_arm() {
    let chip = ChipStatus {
        clock: ClockSource::Bare,
        shortest_period_us: 10_500,
        ..ChipStatus::VIRTUAL
    };
    let mut board = Board::with(|board| board.chip = chip);
    assert_eq!(board.hello().chip, chip);
    let refused = nack(NackReason::Period);
    board.samples_to_arm();
    assert_eq!(board.request(HostMessage::Arm), refused);
    for (period_us, reply) in [
        (1000, &refused),
        (10_499, &refused),
        (10_500, &ACK),
        (20_001, &refused),
    ] {
        let configured = board.request(configure(|wanted| wanted.period_us = period_us));
        assert_eq!(configured, *reply, "{period_us}");
    }
    board.arm();
}

#[test]
fn m7_what_was_latched_or_damaged_at_the_start_refuses_to_arm() {
    use ImageStatus::{Damaged, Sound, Unsealed};
    use ResetReason::{Fault, Panic, PowerOn, Software, Watchdog};
    use SafetyReason::{Image, MotorHot, None, Restarted, Stopped};
    // Program, cause of the start and fault of before; fault that is latched, and that is kept for the next start.
    for (image, reset_reason, kept_fault, latched, kept_on) in [
        (Unsealed, Watchdog, None, Restarted, Restarted),
        (Unsealed, Panic, None, Restarted, Restarted),
        (Unsealed, Fault, MotorHot, MotorHot, MotorHot),
        (Unsealed, Software, Stopped, Stopped, Stopped),
        (Sound, Software, Stopped, Stopped, Stopped),
        (Unsealed, PowerOn, None, None, None),
        (Sound, PowerOn, None, None, None),
        (Damaged, PowerOn, Stopped, Image, Stopped),
        (Damaged, PowerOn, None, Image, None),
    ] {
        let mut board = Board::with(|board| {
            (board.chip.image, board.reset_reason) = (image, reset_reason);
            board.kept_fault = kept_fault;
        });
        let reply = |reason| {
            if reason == None {
                ACK
            } else {
                no_torque(reason)
            }
        };
        assert_eq!(board.session.latched_fault(), latched);
        assert_eq!(board.session.safety().reason, latched);
        assert_eq!(board.session.kept_fault(), kept_on);
        board.samples_to_arm();
        assert_eq!(board.request(HostMessage::Arm), reply(latched));
        // Only another program mends a damaged one.
        let left = if image == Damaged { Image } else { None };
        assert_eq!(board.request(HostMessage::ClearFault), reply(left));
        assert_eq!(board.request(HostMessage::Arm), reply(left));
        assert_eq!(board.session.latched_fault(), left);
        assert_eq!(board.session.torque_enabled(), left == None);
    }
}

/// Sensor of drives that are off until `0` is false.
struct Waiting(bool);

impl LocalSensor<N> for Waiting {
    fn measure(&mut self, _: &mut Option<JointSample<N>>, _: bool) -> SafetyReason {
        SafetyReason::None
    }

    fn holds(&self) -> bool {
        self.0
    }
}

#[test]
fn an_excitation_begins_with_the_drives_of_its_arming_or_not_at_all() {
    let order = HostMessage::Excitation;
    let ready = BoardMessage::Excitation(ExcitationState::Ready);
    for disarmed in [true, false] {
        let mut board = Board::measuring(Waiting(true));
        let uploaded = board.upload_excitation(&keys::excitation(), None);
        assert_eq!(uploaded, ACK);
        (0..300).for_each(|_| _ = board.sample(0));
        board.acknowledged(HostMessage::Arm);
        assert_eq!(board.request(order(ExcitationCommand::Start)), ready);
        if disarmed {
            board.acknowledged(HostMessage::Disarm);
        }
        board.sample(0);
        board.sensor.0 = false;
        if disarmed {
            board.arm();
        }
        let replies = board.send(&sample_message(0));
        let excited = matches!(replies[..], [(_, BoardMessage::Excited(_))]);
        assert_eq!(excited, !disarmed, "{replies:?}");
    }
}
