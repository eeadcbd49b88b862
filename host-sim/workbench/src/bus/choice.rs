//! Which bus, and how it is reached.

use super::socketcan::SocketCan;
use super::text::{TextForm, TextLine};
use super::udp::UdpMulticast;
use super::{BusError, Line};
use std::fmt;
use std::str::FromStr;

/// A bus that a command may name; two names, separated by a comma, are two buses of one arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusChoice {
    /// One of [`KINDS`].
    kind: &'static str,
    /// Interfaces, ports or groups; none of simulated drives.
    names: Vec<String>,
}

/// Simulated drives; interfaces of Linux; adapters on serial ports, those of mjbots; multicast groups.
const KINDS: [&str; 5] = ["sim", "socketcan", "slcan", "fdcanusb", "udp"];

impl FromStr for BusChoice {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const WRONG: &str =
            "not one of sim, socketcan:IF, slcan:PORT, fdcanusb:PORT, udp:GROUP; two buses: IF,IF";
        let (kind, names) = match text.split_once(':') {
            Some((kind, names)) => (kind, names.split(',').map(str::to_owned).collect()),
            None => (text, Vec::new()),
        };
        let kind = KINDS
            .into_iter()
            .find(|known| *known == kind)
            .ok_or(WRONG)?;
        let counts = if kind == "sim" { 0..=0 } else { 1..=2 };
        match counts.contains(&names.len()) && !names.iter().any(String::is_empty) {
            true => Ok(Self { kind, names }),
            false => Err(WRONG),
        }
    }
}

impl fmt::Display for BusChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_simulated() {
            true => f.write_str(self.kind),
            false => write!(f, "{}:{}", self.kind, self.names.join(",")),
        }
    }
}

impl BusChoice {
    /// The drives are simulated.
    pub fn is_simulated(&self) -> bool {
        self.kind == "sim"
    }

    /// Opens the adapters of `buses` buses; none for the simulated ones.
    ///
    /// Errors: another number of names, the first that cannot be opened.
    pub fn open(&self, buses: usize) -> Result<Vec<Box<dyn Line>>, BusError> {
        let refused = |error| BusError::Open(self.to_string(), error);
        let count = self.names.len();
        if count != buses && !self.is_simulated() {
            let text = format!("{count} named, the profile has {buses} buses");
            return Err(refused(std::io::Error::other(text)));
        }
        let open = |name: &String| -> std::io::Result<Box<dyn Line>> {
            Ok(match self.kind {
                "udp" => Box::new(UdpMulticast::open(name)?),
                "slcan" => Box::new(TextLine::open(name, TextForm::Slcan)?),
                "fdcanusb" => Box::new(TextLine::open(name, TextForm::Fdcanusb)?),
                _ => Box::new(SocketCan::open(name)?),
            })
        };
        let names = self.names.iter();
        names.map(|name| open(name).map_err(refused)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buses_are_named_as_they_are_written() {
        for name in [
            "sim",
            "socketcan:can0",
            "socketcan:can0,can1",
            "slcan:/dev/ttyACM0",
            "fdcanusb:/dev/ttyACM1",
            "udp:239.74.163.2",
        ] {
            assert_eq!(name.parse::<BusChoice>().expect(name).to_string(), name);
        }
        for name in [
            "",
            "can0",
            "socketcan:",
            "socketcan:a,b,c",
            "serial:x",
            "udp:,",
        ] {
            assert!(name.parse::<BusChoice>().is_err(), "{name}");
        }
    }

    #[test]
    fn a_bus_that_is_not_there_is_one_line_with_its_name() {
        for name in [
            "socketcan:nowhere7",
            "slcan:/dev/ttyNOWHERE7",
            "fdcanusb:/dev/ttyNOWHERE7",
            "udp:10.0.0.1",
            "udp:here",
        ] {
            let refused = name.parse::<BusChoice>().expect(name).open(1);
            let message = refused.err().expect(name).to_string();
            assert!(message.starts_with(&format!("bus {name}: ")), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
        let two = "socketcan:a,b".parse::<BusChoice>().expect("two").open(1);
        assert!(two.err().expect("one bus").to_string().contains("2 named"));
    }
}
