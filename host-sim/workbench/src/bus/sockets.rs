//! CAN frames over sockets: interfaces of Linux, and multicast groups as python-can's interface `udp_multicast` uses them.

use super::{Line, frame_of};
use foretorque_link::drives::Frame;
use rmpv::Value;
use socket2::{Domain, Protocol, Socket, Type};
use socketcan::{
    CanAnyFrame, CanError, CanFdFrame, CanFdSocket, CanFrame, EmbeddedFrame, ExtendedId, Id,
    Socket as _, SocketOptions, StandardId,
};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

/// An interface such as `can0`, with CAN-FD where it has it.
pub(super) struct SocketCan {
    socket: CanFdSocket,
    off: bool,
}

impl SocketCan {
    /// Opens interface `name`.
    ///
    /// Errors: no such interface, one that is down, a kernel without CAN.
    pub(super) fn open(name: &str) -> io::Result<Self> {
        let socket = CanFdSocket::open(name)?;
        socket.set_nonblocking(true)?;
        // Without error frames the end of the bus shows as silence.
        let _ = socket.set_error_filter_accept_all();
        Ok(Self { socket, off: false })
    }
}

fn identifier(frame: &Frame) -> Option<Id> {
    if frame.extended {
        ExtendedId::new(frame.id).map(Id::Extended)
    } else {
        StandardId::new(frame.id as u16).map(Id::Standard)
    }
}

fn taken(id: Id, bytes: &[u8]) -> Frame {
    match id {
        Id::Standard(id) => Frame::standard(id.as_raw().into(), bytes),
        Id::Extended(id) => Frame::extended(id.as_raw(), bytes),
    }
}

impl Line for SocketCan {
    fn send(&mut self, frame: &Frame) -> io::Result<()> {
        let made = identifier(frame).and_then(|id| {
            if frame.fd {
                let mut made = CanFdFrame::new(id, frame.bytes())?;
                made.set_brs(true);
                Some(CanAnyFrame::Fd(made))
            } else if frame.remote {
                CanFrame::new_remote(id, 0).map(CanAnyFrame::from)
            } else {
                CanFrame::new(id, frame.bytes()).map(CanAnyFrame::from)
            }
        });
        let made = made.ok_or_else(|| io::Error::other("a frame that CAN cannot carry"))?;
        match self.socket.write_frame(&made) {
            // The queue of the interface is full: the frame is lost.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            Err(error) if error.raw_os_error() == Some(nix::errno::Errno::ENOBUFS as i32) => Ok(()),
            outcome => outcome,
        }
    }

    fn receive(&mut self) -> io::Result<Option<Frame>> {
        loop {
            return match self.socket.read_frame() {
                Ok(CanAnyFrame::Normal(frame)) => Ok(Some(taken(frame.id(), frame.data()))),
                Ok(CanAnyFrame::Fd(frame)) => {
                    let mut made = taken(frame.id(), frame.data());
                    made.fd = true;
                    Ok(Some(made))
                }
                Ok(CanAnyFrame::Remote(_)) => continue,
                Ok(CanAnyFrame::Error(frame)) => {
                    self.off |= CanError::from(frame).is_bus_off();
                    continue;
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
                Err(error) => Err(error),
            };
        }
    }

    fn is_off(&self) -> bool {
        self.off
    }
}

/// Port of python-can.
const PORT: u16 = 43_113;

/// A multicast group in the place of a bus.
pub(super) struct UdpMulticast {
    receiver: UdpSocket,
    sender: UdpSocket,
    group: SocketAddr,
    own_port: u16,
}

impl UdpMulticast {
    /// Joins a group of IPv4 or IPv6, with `:PORT` behind it or python-can's.
    ///
    /// Errors: no address of a group, the system's.
    pub(super) fn open(group: &str) -> io::Result<Self> {
        let wrong = || io::Error::new(io::ErrorKind::InvalidInput, "no multicast address");
        let group = group.parse::<SocketAddr>().or_else(|_| {
            let address: IpAddr = group.parse().map_err(|_| wrong())?;
            Ok::<_, io::Error>(SocketAddr::new(address, PORT))
        })?;
        if !group.ip().is_multicast() {
            return Err(wrong());
        }
        let socket = || Socket::new(Domain::for_address(group), Type::DGRAM, Some(Protocol::UDP));
        let receiver = socket()?;
        receiver.set_reuse_address(true)?;
        receiver.set_reuse_port(true)?;
        receiver.bind(&group.into())?;
        match group.ip() {
            IpAddr::V4(address) => receiver.join_multicast_v4(&address, &Ipv4Addr::UNSPECIFIED)?,
            IpAddr::V6(address) => receiver.join_multicast_v6(&address, 0)?,
        }
        receiver.set_nonblocking(true)?;
        // A socket of its own to send from, by whose port the own frames are known: a bus does not give them back.
        let sender = socket()?;
        let any: SocketAddr = match group {
            SocketAddr::V4(_) => ([0, 0, 0, 0], 0).into(),
            SocketAddr::V6(_) => ([0_u16; 8], 0).into(),
        };
        sender.bind(&any.into())?;
        let sender: UdpSocket = sender.into();
        Ok(Self {
            own_port: sender.local_addr()?.port(),
            receiver: receiver.into(),
            sender,
            group,
        })
    }
}

/// A frame as a datagram: one MessagePack map.
fn packed(frame: &Frame) -> io::Result<Vec<u8>> {
    let data = frame.bytes();
    let entry = |name: &str, value: Value| (Value::from(name), value);
    let map = Value::Map(vec![
        entry("timestamp", 0.0.into()),
        entry("arbitration_id", frame.id.into()),
        entry("is_extended_id", frame.extended.into()),
        entry("is_remote_frame", frame.remote.into()),
        entry("is_error_frame", false.into()),
        entry("channel", Value::Nil),
        entry("dlc", data.len().into()),
        entry("data", data.into()),
        entry("is_fd", frame.fd.into()),
        entry("bitrate_switch", frame.fd.into()),
        entry("error_state_indicator", false.into()),
    ]);
    let mut bytes = Vec::new();
    rmpv::encode::write_value(&mut bytes, &map).map_err(io::Error::other)?;
    Ok(bytes)
}

/// Frame of a datagram; `None` for any other.
fn unpacked(mut bytes: &[u8]) -> Option<Frame> {
    let map = rmpv::decode::read_value(&mut bytes).ok()?;
    let map = map.as_map()?;
    let field = |name: &str| {
        let entry = map.iter().find(|(key, _)| key.as_str() == Some(name));
        entry.map(|(_, value)| value)
    };
    let flag = |name: &str| field(name).and_then(Value::as_bool).unwrap_or(false);
    let id = u32::try_from(field("arbitration_id")?.as_u64()?).ok()?;
    let data = field("data").and_then(Value::as_slice).unwrap_or_default();
    if flag("is_error_frame") {
        return None;
    }
    let mut frame = frame_of(id, flag("is_extended_id"), data)?;
    frame.remote = flag("is_remote_frame");
    frame.fd = flag("is_fd");
    Some(frame)
}

impl Line for UdpMulticast {
    fn send(&mut self, frame: &Frame) -> io::Result<()> {
        self.sender.send_to(&packed(frame)?, self.group).map(drop)
    }

    fn receive(&mut self) -> io::Result<Option<Frame>> {
        let mut buffer = [0; 1024];
        loop {
            match self.receiver.recv_from(&mut buffer) {
                Ok((_, from)) if from.port() == self.own_port => {}
                Ok((count, _)) => {
                    if let Some(frame) = unpacked(&buffer[..count]) {
                        return Ok(Some(frame));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                Err(error) => return Err(error),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::time::{Duration, Instant};

    /// `println!` shows nothing of a test that passes.
    fn skipped(reason: &str) {
        let _ = writeln!(std::io::stdout(), "skipped: {reason}");
    }

    #[test]
    fn frames_pass_a_virtual_interface_where_there_is_one() {
        let (Ok(mut one), Ok(mut other)) = (SocketCan::open("vcan0"), SocketCan::open("vcan0"))
        else {
            return skipped("no vcan0 on this machine");
        };
        for frame in [
            Frame::standard(1, &[1, 2]),
            Frame::extended(0x8001, &[7; 8]),
        ] {
            one.send(&frame).expect("it is up");
            let frames = std::iter::from_fn(|| other.receive().expect("it is up"));
            assert_eq!(frames.last(), Some(frame));
        }
    }

    #[test]
    fn datagrams_bring_back_every_frame() {
        let mut remote = Frame::remote(0x49);
        for frame in [
            Frame::standard(0x7ff, &[1, 2, 3]),
            Frame::extended(0x1fff_ffff, &[9; 8]),
            Frame::extended(0x8001, &[7; 13]).into_fd(0x50),
            remote,
        ] {
            assert_eq!(unpacked(&packed(&frame).expect("it packs")), Some(frame));
        }
        remote.id = 0x800;
        assert_eq!(unpacked(&packed(&remote).expect("it packs")), None);
        for bytes in [&[][..], &[0xc0], &[0x81, 0xa1, 0x61], &[0xff; 40]] {
            assert_eq!(unpacked(bytes), None);
        }
    }

    #[test]
    fn two_ends_of_a_group_exchange_frames_and_get_none_of_their_own() {
        let group = "239.74.163.77:43177";
        let (Ok(mut one), Ok(mut other)) = (UdpMulticast::open(group), UdpMulticast::open(group))
        else {
            return skipped("no multicast on this machine");
        };
        let frame = Frame::standard(5, &[1, 2]);
        if one.send(&frame).is_err() {
            return skipped("no route for multicast on this machine");
        }
        let deadline = Instant::now() + Duration::from_secs(5);
        let mut received = None;
        while received.is_none() && Instant::now() < deadline {
            received = other.receive().expect("it is there");
        }
        assert_eq!(received, Some(frame));
        assert_eq!(one.receive().expect("it is there"), None);
    }
}
