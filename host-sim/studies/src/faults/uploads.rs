//! Uploads that fail, between sound ones.

use super::Campaign;
use super::link::{ARM_EVERY, Host};
use super::store::set;
use crate::StudyError;
use foretorque::arm::ur5::JOINTS;
use foretorque_link::bank::ParameterBank;
use foretorque_link::safety::SafetyState;
use foretorque_link::wire::{BankSource, BoardMessage, CHUNK, HostMessage};
use foretorque_workbench::board::{BoardError, Transport};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BadUpload {
    /// It stops before its end, with or without a commit.
    Interrupted,
    /// The board is reset in the middle of it.
    Reset,
    WrongRobot,
    WrongVersion,
    /// Bytes of the bank are damaged, the checksum of the upload is right.
    Damaged,
    /// A number of the bank is none, or infinite.
    StrangeNumber,
}

/// All of them, with their names in a report.
pub(super) const BAD_UPLOADS: [(BadUpload, &str); 6] = [
    (BadUpload::Interrupted, "interrupted uploads"),
    (BadUpload::Reset, "reset in the middle of an upload"),
    (BadUpload::WrongRobot, "banks of another robot"),
    (BadUpload::WrongVersion, "banks of another version"),
    (BadUpload::Damaged, "damaged banks"),
    (
        BadUpload::StrangeNumber,
        "banks with NaN and infinite numbers",
    ),
];

/// `times` uploads that fail, between sound ones. The reference gets the sound ones only: a set is lost when the bank in
/// force is another one afterwards.
pub(super) fn bad_uploads(
    transport: Box<dyn Transport>,
    (bad, name): (BadUpload, &str),
    times: u32,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new(name, &transport.name());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut host = Host::new(transport, false)?;
    for number in 1..=times {
        let good = set(number);
        for message in upload(&good, good.len()) {
            let frame = host.rig.frame(&message);
            host.rig.send_frame(&frame)?;
        }
        let accepted = corrupted_upload(&mut host, bad, number, &mut random)?;
        // A bank that is read back is compared piece by piece with the reference's.
        let wrong = host.rig.wrong_torques;
        for offset in (0..good.len()).step_by(CHUNK) {
            host.rig.ask(&HostMessage::BankRead {
                source: BankSource::Live,
                offset: offset as u16,
            })?;
        }
        let lost = accepted || host.rig.wrong_torques > wrong;
        let mut worked = false;
        for _ in 0..4 * ARM_EVERY {
            host.work()?;
            worked |= host.rig.state == SafetyState::Armed;
        }
        campaign.case(!lost, worked);
        host.rest()?;
    }
    Ok(host.close(campaign, true))
}

/// The messages of an upload of the first `length` bytes of `bank`, with the commit of all of it.
fn upload(bank: &[u8], length: usize) -> Vec<HostMessage<JOINTS>> {
    let pieces = bank.get(..length).unwrap_or(bank).chunks(CHUNK).enumerate();
    let pieces = pieces.map(|(place, piece)| HostMessage::BankWrite {
        offset: (place * CHUNK) as u16,
        bytes: piece.iter().copied().collect(),
    });
    let commit = HostMessage::BankCommit {
        length: bank.len() as u16,
        crc: crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bank),
        mac: None,
    };
    pieces.chain([commit]).collect()
}

/// Uploads what must not be taken over. True when the board took it.
fn corrupted_upload(
    host: &mut Host,
    bad: BadUpload,
    number: u32,
    random: &mut ChaCha8Rng,
) -> Result<bool, BoardError> {
    let bank = corrupted_bank(bad, number, random);
    let cut = matches!(bad, BadUpload::Interrupted | BadUpload::Reset);
    let length = match cut {
        true => random.random_range(0..bank.len()),
        false => bank.len(),
    };
    let mut messages = upload(&bank, length);
    let committed = bad != BadUpload::Interrupted || random.random();
    if !committed {
        messages.pop();
    }
    if bad == BadUpload::Reset {
        messages.insert(messages.len() - 1, HostMessage::Reset);
    }
    let mut answer = None;
    for message in &messages {
        // The reference gets the reset alone.
        let frame = match message {
            HostMessage::Reset => host.rig.frame(message),
            _ => host.rig.unreferenced_frame(message),
        };
        answer = host.rig.send_frame(&frame)?.answers.pop();
    }
    // The answer to the last frame: a commit must not be acknowledged, and without one nothing must be in force.
    Ok(committed && answer == Some(BoardMessage::Ack))
}

/// A bank that no board for this robot may take over; or a good one, where the upload is what fails.
fn corrupted_bank(bad: BadUpload, number: u32, random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = set(1000 + number);
    let Ok(mut bank) = ParameterBank::decode(&bytes) else {
        return bytes;
    };
    match bad {
        BadUpload::WrongRobot => bank.arm_hash ^= 1 << random.random_range(0..32),
        BadUpload::StrangeNumber => {
            let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
            let value = *values.choose(random).unwrap_or(&f32::NAN);
            let column = random.random_range(0..bank.columns.len());
            let weight = random.random_range(0..bank.weights.len());
            match random.random_range(0..4) {
                0 => bank.columns[column].value = value,
                1 => bank.columns[column].deviation = value,
                2 => bank.weights[weight] = value,
                _ => bank.drive_gains_nm_a[random.random_range(0..JOINTS)] = value,
            }
        }
        BadUpload::WrongVersion => {
            bytes[4] = ParameterBank::FORMAT_VERSION.wrapping_add(random.random_range(1..=255));
            return bytes;
        }
        BadUpload::Damaged => {
            let place = random.random_range(0..bytes.len());
            bytes[place] ^= random.random_range(1..=255u8);
            return bytes;
        }
        BadUpload::Interrupted | BadUpload::Reset => return bytes,
    }
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer).map_or(bytes, <[u8]>::to_vec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::{PARAMETERS, Ur5};
    use foretorque_workbench::board::Native;

    #[test]
    fn a_bank_that_is_taken_although_it_must_not_be_is_a_lost_set() {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().unwrap();
        let mut host = Host::new(Box::new(native), false).unwrap();
        let bank = set(5);
        for message in upload(&bank, bank.len()) {
            let frame = host.rig.unreferenced_frame(&message);
            host.rig.send_frame(&frame).unwrap();
        }
        let offset = HostMessage::BankRead {
            source: BankSource::Live,
            offset: 0,
        };
        host.rig.ask(&offset).unwrap();
        // The bank differs from the reference's.
        assert!(host.rig.wrong_torques > 0);
    }
}
