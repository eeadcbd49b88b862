//! Boards and buses together: here the client and the board in this process, through real frames. One test crate: the
//! workbench is linked once.

mod bus_commission;
mod bus_loop;
mod emulated_board;
mod emulated_bus;
mod emulated_drive;
mod emulated_safety;
#[path = "../../../tests/python.rs"]
mod python;
mod trial;

use crate::trial::{connected, credible as sample, native, paced};
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::FrictionColumn;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, evaluate};
use foretorque::joint::JointVector;
use foretorque::learning::{Learner, LearnerConfig, ParameterSet};
use foretorque_link::bank::{ColumnId, ColumnKind, NETWORK_SEED, ParameterBank};
use foretorque_link::safety::ARM_SAMPLES;
use foretorque_link::wire::{Configuration, NackReason, PROTOCOL_VERSION, Pacing, ReplyMode};
use foretorque_workbench::board::{BoardError, Client, TickReply, Transport};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;

const N: usize = 6;
const P: usize = 40;
const BOOT: Duration = Duration::from_millis(10);

fn client() -> Client<N> {
    connected(native())
}

fn bits(reply: &TickReply<N>) -> (u32, u16, Vec<u32>) {
    let total = reply.total.iter().map(|tau| tau.to_bits()).collect();
    (reply.tick, reply.flags.0, total)
}

/// A board that answers everything with the same bytes, or is dead.
struct FixedAnswer(Option<Vec<u8>>, VecDeque<u8>);

impl Transport for FixedAnswer {
    fn name(&self) -> String {
        "answer".into()
    }

    fn send(&mut self, _: &[u8]) -> io::Result<()> {
        match &self.0 {
            Some(bytes) => {
                self.1.extend(bytes);
                Ok(())
            }
            None => Err(io::Error::other("it is dead")),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], _: Duration) -> io::Result<usize> {
        let count = buffer.len().min(self.1.len());
        let bytes = self.1.drain(..count).zip(buffer);
        bytes.for_each(|(byte, slot)| *slot = byte);
        Ok(count)
    }
}

#[test]
fn foreign_silent_and_dead_boards_are_told_apart() {
    // Version 9, sequence 0, tag 0, CRC-32 of these four bytes, in COBS by hand.
    let content = [9, 1, 1, 1];
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&content);
    let mut frame = vec![9];
    frame.extend(content);
    frame.extend(crc.to_le_bytes());
    frame.push(0);
    assert!(!crc.to_le_bytes().contains(&0), "made by hand");
    let connect = |bytes| {
        let answer = Box::new(FixedAnswer(bytes, VecDeque::new()));
        Client::<N>::connect::<Ur5, P>(answer, BOOT).err().unwrap()
    };
    let foreign = connect(Some(frame)).to_string();
    let versions = format!("protocol version 9, this program version {PROTOCOL_VERSION}");
    assert!(foreign.contains(&versions), "{foreign}");
    assert!(matches!(connect(Some(vec![])), BoardError::Timeout(_)));
    assert!(matches!(connect(None), BoardError::Closed(..)));
}

#[test]
fn samples_through_frames_give_the_bits_of_the_bare_tick_with_learning_on() {
    let mut client = client();
    client.arm(&sample(0)).unwrap();
    client.learning(true).unwrap();
    let set = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    let config = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    let mut bare = FeedForward::<Ur5, N, P>::new(config, set).unwrap();
    let mut learner = Learner::<Ur5, N, P>::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap();
    let mut exchange = foretorque::learning::Exchange::new();
    for _ in 0..ARM_SAMPLES {
        let received = foretorque_link::wire::SampleFrame::new(&sample(0)).sample(&[0.0; N]);
        bare.adopt(&mut exchange);
        bare.step(&received);
        // A disarmed board holds the torque back.
        bare.applied(&JointVector::zeros());
        learner.learn(&bare.learning_sample(received.measured), &mut exchange);
    }
    bare.set_learning(true);
    for k in 0..4000 {
        // What the scaled integers make of the sample is what both see.
        let frame = foretorque_link::wire::SampleFrame::new(&sample(k));
        let received = frame.sample(&[0.0; N]);
        bare.adopt(&mut exchange);
        let torque = bare.step(&received);
        learner.learn(&bare.learning_sample(received.measured), &mut exchange);
        let reply = client.sample_frame(&frame).unwrap();
        let [answered, bare] = [reply.total, torque.total].map(|tau| tau.map(f32::to_bits));
        assert_eq!(
            (reply.tick, reply.flags, answered),
            (torque.tick, torque.flags, bare)
        );
    }
    let learnt = client.read_bank().unwrap().set::<Ur5, N, P>().unwrap();
    assert_eq!(learnt, bare.state().active);
    assert_ne!(learnt, set, "nothing was learnt");
}

#[test]
fn decimated_shares_are_those_of_joint_tick_modulo_n() {
    let (mut one, mut all) = (client(), client());
    let full = Configuration {
        reply: ReplyMode::Full,
        ..Configuration::default()
    };
    all.configure(full).unwrap();
    for k in 0..20 {
        let [one, all] = [&mut one, &mut all].map(|board| board.sample(&sample(k)).unwrap());
        assert_eq!(bits(&one), bits(&all));
        for joint in 0..N {
            let (shares, whole) = (one.shares.of(joint), all.shares.of(joint));
            let answered = joint == k as usize % N;
            assert_eq!(shares, whole.filter(|_| answered), "joint {joint} of {k}");
            assert!(whole.is_some(), "joint {joint} of {k}");
        }
    }
}

#[test]
fn a_bank_goes_up_is_in_force_and_comes_back() {
    let mut client = client();
    let mut bank = ParameterBank::nominal::<Ur5, N, P>();
    bank.columns[0].value += 0.5;
    bank.columns[0].deviation = 0.25;
    bank.drive_gains_nm_a.fill(12.5);
    let id = ColumnId {
        kind: ColumnKind::friction(FrictionColumn::Coulomb),
        joint: 2,
    };
    bank.columns.iter_mut().find(|c| c.id == id).unwrap().value = 5.5;
    client.upload_bank(&bank).unwrap();
    assert_eq!(client.read_bank().unwrap(), bank);
    let motion = sample(100).desired;
    let expected = evaluate::<Ur5, N, P>(&bank.set::<Ur5, N, P>().unwrap(), &motion);
    assert_eq!(client.evaluate(&motion).unwrap(), expected);
}

#[test]
fn configuration_is_judged_and_restarts_the_tick() {
    let mut client = client();
    client.sample(&sample(0)).unwrap();
    assert_eq!(client.sample(&sample(1)).unwrap().tick, 1);
    paced(&mut client, 2000, Pacing::Link);
    assert_eq!(client.sample(&sample(2)).unwrap().tick, 0);
    for (learning, period_us, pacing, wanted) in [
        (false, 99, Pacing::Link, NackReason::Period),
        (false, 1000, Pacing::SysTick, NackReason::NotCapable),
        (true, 1000, Pacing::Link, NackReason::LearningOn),
    ] {
        client.learning(learning).unwrap();
        let refused = client.configure(Configuration {
            period_us,
            pacing,
            ..Configuration::default()
        });
        let error = refused.expect_err("it is judged");
        assert!(
            matches!(error, BoardError::Refused(reason) if reason == wanted),
            "{error}"
        );
    }
}

#[test]
fn reset_makes_a_used_board_answer_like_a_new_one() {
    let (mut used, mut fresh) = (client(), client());
    used.learning(true).unwrap();
    for k in 0..200 {
        used.sample(&sample(k)).unwrap();
    }
    used.reset().unwrap();
    for client in [&mut used, &mut fresh] {
        client.learning(true).unwrap();
    }
    for k in 0..100 {
        let [a, b] = [&mut used, &mut fresh].map(|board| bits(&board.sample(&sample(k)).unwrap()));
        assert_eq!(a, b);
    }
    assert_eq!(used.statistics().unwrap().ticks, 100);
}
