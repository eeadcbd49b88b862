//! CAN interfaces of Linux.

use super::Line;
use foretorque_link::drives::Frame;
use socketcan::{
    CanAnyFrame, CanError, CanFdFrame, CanFdSocket, CanFrame, EmbeddedFrame, ExtendedId, Id,
    Socket, SocketOptions, StandardId,
};
use std::io;

/// An interface such as `can0`, with CAN-FD where it has it.
pub(super) struct SocketCan {
    socket: CanFdSocket,
    name: String,
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
        Ok(Self {
            socket,
            name: name.to_owned(),
            off: false,
        })
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
    fn name(&self) -> String {
        format!("socketcan:{}", self.name)
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_pass_a_virtual_interface_where_there_is_one() {
        let (Ok(mut one), Ok(mut other)) = (SocketCan::open("vcan0"), SocketCan::open("vcan0"))
        else {
            println!("skipped: no vcan0 on this machine");
            return;
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
}
