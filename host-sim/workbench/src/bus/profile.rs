//! Profile of an arm: its drives, buses and rate, from a TOML file; and the time of a frame on its bus.

use super::BusError;
use crate::files::{from_toml, read_text};
use foretorque::arm::Arm;
use foretorque_link::bus::{BusConfig, BusJoint, Role, Wires, Wiring};
use foretorque_link::drives::{Carry, DriveProfile, Frame, Frames, JointCommand, JointReply};
use serde::Deserialize;
use std::path::Path;

/// Rates at which the loop may run, Hz.
const RATES_HZ: std::ops::RangeInclusive<f64> = 100.0..=2000.0;

/// Profile of an arm.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// File it was read from.
    #[serde(skip)]
    pub file: String,
    /// Robot: a built-in name or a description file, which may lie beside the profile.
    pub robot: String,
    /// Ticks per second, Hz.
    pub rate_hz: f64,
    /// Pose in which the arm rests without torque, rad; commissioning begins there.
    #[serde(default)]
    pub rest_rad: Vec<f64>,
    /// Bit rates of the buses: one or two.
    #[serde(default = "one_bus")]
    pub bus: Vec<BitRates>,
    /// Joints, base to tool.
    pub joint: Vec<BusJoint>,
}

fn one_bus() -> Vec<BitRates> {
    vec![BitRates::default()]
}

fn refused(file: &str, problem: String) -> BusError {
    BusError::Profile(file.to_owned(), problem)
}

impl Profile {
    /// Reads a profile.
    ///
    /// Errors: the file's, with the place; values that contradict each other.
    pub fn load(path: &Path) -> Result<Self, BusError> {
        let file = path.display().to_string();
        let text = read_text(path).map_err(|error| refused(&file, error.to_string()))?;
        let mut profile = Self::parse(&file, &text)?;
        let beside = path.with_file_name(&profile.robot);
        if beside.is_file() {
            profile.robot = beside.display().to_string();
        }
        Ok(profile)
    }

    /// A profile from the text of `file`.
    ///
    /// Errors: as [`load`](Self::load).
    pub fn parse(file: &str, text: &str) -> Result<Self, BusError> {
        let refused = |problem| refused(file, problem);
        let mut profile: Self = from_toml(text).map_err(refused)?;
        file.clone_into(&mut profile.file);
        let check = |sound: bool, problem| sound.then_some(()).ok_or_else(|| refused(problem));
        let (rate, buses) = (profile.rate_hz, profile.bus.len());
        let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
        let within = format!("rate_hz {rate} is not within {least} and {most}");
        check(RATES_HZ.contains(&rate), within)?;
        let problem = format!("{buses} buses, not 1 or 2");
        check((1..=2).contains(&buses), problem)?;
        for (place, BitRates { nominal, data }) in profile.bus.iter().enumerate() {
            let mut rates = [nominal, data].into_iter();
            let sound = rates.all(|rate| (1e4..=1e7).contains(rate));
            let within = "are not within 1e4 and 1e7";
            let problem = format!("bus {place}: bit_s {nominal} and data_bit_s {data} {within}");
            check(sound, problem)?;
        }
        for (joint, BusJoint { bus, .. }) in (1..).zip(&profile.joint) {
            let problem =
                format!("joint {joint}: bus {bus} contradicts the {buses} buses of the profile");
            check(usize::from(*bus) < buses, problem)?;
        }
        Ok(profile)
    }

    /// The drives for the loop of arm `A`.
    ///
    /// Errors: another number of joints, contradictions with the arm, a bus that cannot carry the frames.
    pub fn config<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> Result<BusConfig<N>, BusError> {
        let (name, count, rests) = (A::name(), self.joint.len(), self.rest_rad.len());
        let refused = |problem| refused(&self.file, problem);
        let other = format!("{count} joints contradict the {N} joints of robot '{name}'");
        let joints = self.joint.as_slice().try_into();
        let joints = joints.map_err(|_| refused(other))?;
        if rests != 0 && rests != N {
            let problem = format!("rest_rad has {rests} positions, robot '{name}' {N} joints");
            return Err(refused(problem));
        }
        let config = BusConfig {
            period_s: (1.0 / self.rate_hz) as f32,
            joints,
        };
        let checked = config.check::<A, P>();
        checked.map_err(|error| refused(error.to_string()))?;
        let alone = |joint: &BusJoint| joint.drive.protocol.is_without_position();
        if let Some(joint) = joints.iter().position(alone) {
            let joint = joint + 1;
            let problem = format!(
                "joint {joint}: without a position loop the arm drifts: mode = \"position\""
            );
            return Err(refused(problem));
        }
        for bus in 0..self.bus.len() {
            let (rate, busy_s) = (self.rate_hz, self.busy_s(bus));
            if busy_s * rate > 1.0 {
                let (busy_ms, left_ms) = (busy_s * 1e3, 1e3 / rate);
                return Err(refused(format!(
                    "bus {bus}: commands and replies take {busy_ms:.2} ms, rate_hz {rate} leaves {left_ms:.2} ms"
                )));
            }
        }
        Ok(config)
    }

    /// Bit rates of every bus.
    ///
    /// Errors: two buses with different ones, which neither the board nor the simulated buses have.
    pub fn common_rates(&self) -> Result<BitRates, BusError> {
        match self.bus[..] {
            [one, ref more @ ..] if more.iter().all(|other| *other == one) => Ok(one),
            _ => Err(refused(
                &self.file,
                "bus: a board and simulated buses have one bit_s and data_bit_s for both buses"
                    .to_owned(),
            )),
        }
    }

    /// Drives and role of a board on this bus, as its flash holds them: all drives, or that of joint `only`, from 1.
    ///
    /// Errors: as [`config`](Self::config) and, for all drives, [`common_rates`](Self::common_rates).
    pub fn wiring<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        role: Role,
        wires: Wires,
        only: Option<usize>,
    ) -> Result<Wiring<N>, BusError> {
        let mut joints = self.config::<A, N, P>()?.joints.map(Some);
        if let Some(only) = only {
            let others = (1..).zip(&mut joints).filter(|(joint, _)| *joint != only);
            others.for_each(|(_, slot)| *slot = None);
        }
        let rates = match only.and_then(|only| self.joint.get(only - 1)) {
            Some(own) => self.bus[usize::from(own.bus)],
            None => self.common_rates()?,
        };
        let mut busy_s = [0.0; 2];
        for joint in joints.iter().flatten() {
            busy_s[usize::from(joint.bus)] += frames_s(&joint.drive, &rates);
        }
        Ok(Wiring {
            arm_hash: A::hash(),
            role,
            wires,
            bit_s: rates.nominal as u32,
            shortest_period_us: match role {
                Role::Master => (1e6 * busy_s.into_iter().fold(0.0, f64::max)).round() as u32,
                Role::InLine => 0,
            },
            joints: joints.into_iter().collect(),
        })
    }

    /// Time that the commands and replies of one tick take on a bus, s.
    pub fn busy_s(&self, bus: usize) -> f64 {
        let rates = self.bus[bus];
        let is_there = |joint: &&BusJoint| usize::from(joint.bus) == bus;
        let joints = self.joint.iter().filter(is_there);
        joints.map(|joint| frames_s(&joint.drive, &rates)).sum()
    }

    /// Time from the begin of a tick to the middle of the time in which its commands hold, s: half a period, and the mean
    /// delay of the commands on the fuller bus.
    pub fn lead_s(&self) -> f64 {
        let busy = (0..self.bus.len()).map(|bus| self.busy_s(bus));
        0.5 / self.rate_hz + 0.5 * busy.fold(0.0, f64::max)
    }
}

/// Time of a command and its reply on the bus, s.
fn frames_s(drive: &DriveProfile, rates: &BitRates) -> f64 {
    let (mut frames, mut replies) = (Frames::new(), Frames::new());
    drive.command(&JointCommand::default(), &mut Carry::default(), &mut frames);
    drive.reply(&JointReply::default(), &mut replies);
    let both = frames.iter().chain(&replies);
    both.map(|frame| frame_time_s(frame, rates)).sum()
}

/// Bit rates of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BitRates {
    /// Of classic frames and of the arbitration phase, bit/s.
    #[serde(rename = "bit_s")]
    pub nominal: f64,
    /// Of the data phase of CAN-FD, bit/s.
    #[serde(rename = "data_bit_s", default = "fast")]
    pub data: f64,
}

impl Default for BitRates {
    fn default() -> Self {
        Self {
            nominal: 1e6,
            data: fast(),
        }
    }
}

fn fast() -> f64 {
    5e6
}

/// Longest time of a frame on the bus, with worst-case bit stuffing and the gap behind it, s. Source: ISO 11898-1.
pub fn frame_time_s(frame: &Frame, rates: &BitRates) -> f64 {
    let bytes = frame.bytes().len() as f64;
    let stuffed = |bits: f64| bits + ((bits - 1.0) / 4.0).floor();
    // Start, identifier and control, up to the length code; delimiters, acknowledgement, end and gap are not stuffed.
    let head = if frame.extended { 39.0 } else { 19.0 };
    if frame.fd {
        // CRC of 17 or 21 bits with its own fixed stuff bits and the stuff count.
        let crc = if bytes <= 16.0 { 17.0 } else { 21.0 };
        let slow = stuffed(head - 2.0) + 13.0;
        let quick = stuffed(6.0 + 8.0 * bytes) + crc + (crc / 4.0).ceil() + 4.0;
        return slow / rates.nominal + quick / rates.data;
    }
    (stuffed(head + 8.0 * bytes + 15.0) + 13.0) / rates.nominal
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classic_frames_of_eight_bytes_take_135_and_160_bits_at_most() {
        let rates = BitRates::default();
        let bits = |frame: Frame| (frame_time_s(&frame, &rates) * 1e6).round();
        assert_eq!(bits(Frame::standard(1, &[0; 8])), 135.0);
        assert_eq!(bits(Frame::extended(1, &[0; 8])), 160.0);
        let moteus = bits(Frame::extended(0x8001, &[0; 13]).into_fd(0x50));
        assert!((60.0..120.0).contains(&moteus), "{moteus}");
    }

    #[test]
    fn the_drives_of_the_pages_are_read() {
        #[derive(Deserialize)]
        struct Line {
            drive: DriveProfile,
        }
        let pages = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs");
        let pages = std::fs::read_dir(pages).expect("a directory");
        let mut count = 0;
        let pages = pages.map(|page| page.expect("an entry").path());
        for page in pages.filter(|page| page.extension().is_some_and(|end| end == "md")) {
            let text = std::fs::read_to_string(&page).expect("a page");
            for line in text
                .lines()
                .filter(|line| line.starts_with("drive = { protocol"))
            {
                let read = toml::from_str::<Line>(line);
                let read = read.unwrap_or_else(|error| panic!("{}: {error}", page.display()));
                assert_eq!(read.drive.check(), Ok(()), "{}", page.display());
                count += 1;
            }
        }
        assert!(count >= 6, "{count}");
    }
}
