//! Which bus, and how it is reached.

use super::socketcan::SocketCan;
use super::text::{TextForm, TextLine};
use super::udp::UdpMulticast;
use super::{BusError, Line};
use std::fmt;
use std::str::FromStr;

/// Kinds of buses that a command may name; two names, separated by a comma, are two buses of one arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusChoice {
    /// Simulated drives.
    Sim,
    /// Interfaces of Linux.
    SocketCan(Vec<String>),
    /// Adapters on serial ports.
    Slcan(Vec<String>),
    /// mjbots' adapters on serial ports.
    Fdcanusb(Vec<String>),
    /// Multicast groups.
    Udp(Vec<String>),
}

impl FromStr for BusChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const KINDS: &str =
            "not one of sim, socketcan:IF, slcan:PORT, fdcanusb:PORT, udp:GROUP; two buses: IF,IF";
        if text == "sim" {
            return Ok(Self::Sim);
        }
        let (kind, names) = text.split_once(':').ok_or(KINDS)?;
        let names: Vec<String> = names.split(',').map(str::to_owned).collect();
        if names.len() > 2 || names.iter().any(String::is_empty) {
            return Err(KINDS.to_owned());
        }
        Ok(match kind {
            "socketcan" => Self::SocketCan(names),
            "slcan" => Self::Slcan(names),
            "fdcanusb" => Self::Fdcanusb(names),
            "udp" => Self::Udp(names),
            _ => return Err(KINDS.to_owned()),
        })
    }
}

impl fmt::Display for BusChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, names) = match self {
            Self::Sim => return f.write_str("sim"),
            Self::SocketCan(names) => ("socketcan", names),
            Self::Slcan(names) => ("slcan", names),
            Self::Fdcanusb(names) => ("fdcanusb", names),
            Self::Udp(names) => ("udp", names),
        };
        write!(f, "{kind}:{}", names.join(","))
    }
}

impl BusChoice {
    /// Opens the adapters of `buses` buses; none for the simulated ones.
    ///
    /// Errors: another number of names, the first that cannot be opened.
    pub fn open(&self, buses: usize) -> Result<Vec<Box<dyn Line>>, BusError> {
        let refused = |error| BusError::Open {
            name: self.to_string(),
            error,
        };
        let names = match self {
            Self::Sim => return Ok(Vec::new()),
            Self::SocketCan(names)
            | Self::Slcan(names)
            | Self::Fdcanusb(names)
            | Self::Udp(names) => names,
        };
        if names.len() != buses {
            let count = names.len();
            let text = format!("{count} named, the profile has {buses} buses");
            return Err(refused(std::io::Error::other(text)));
        }
        let open = |name: &String| -> std::io::Result<Box<dyn Line>> {
            Ok(match self {
                Self::Udp(_) => Box::new(UdpMulticast::open(name)?),
                Self::Slcan(_) => Box::new(TextLine::open(name, TextForm::Slcan)?),
                Self::Fdcanusb(_) => Box::new(TextLine::open(name, TextForm::Fdcanusb)?),
                Self::Sim | Self::SocketCan(_) => Box::new(SocketCan::open(name)?),
            })
        };
        names
            .iter()
            .map(|name| open(name).map_err(refused))
            .collect()
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
