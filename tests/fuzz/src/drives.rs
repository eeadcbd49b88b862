//! Decoders of CAN drives: any frame gives finite values, and what a drive would read can be sent again.

use foretorque_link::drives::{text, *};

const RANGES: Ranges = Ranges {
    position: 12.5,
    velocity: 30.0,
    torque: 10.0,
    kp: 500.0,
    kd: 5.0,
};

/// A profile of every protocol; the number chooses modes and resolutions.
fn profiles(choice: u8) -> [DriveProfile; 7] {
    let mode = match choice & 3 {
        0 => ControlMode::Torque,
        1 => ControlMode::Velocity,
        _ => ControlMode::Position,
    };
    let resolution = match choice >> 2 & 3 {
        0 => Resolution::Int16,
        1 => Resolution::Int32,
        _ => Resolution::F32,
    };
    [
        Protocol::MiniCheetah(RANGES),
        Protocol::Damiao(RANGES),
        Protocol::CyberGear(RANGES),
        Protocol::RobStride(RANGES),
        Protocol::Moteus(Moteus {
            kp: 4000.0,
            kd: 40.0,
            watchdog_s: 0.02,
            resolution,
        }),
        Protocol::Odrive(Odrive {
            mode,
            velocity_scale: 1000.0,
            torque_scale: 1000.0,
            torque_scale_endpoint: 300,
            polled: choice & 16 != 0,
        }),
        Protocol::Cia402(Cia402 {
            mode,
            counts_per_turn: 65536.0,
            rated_torque: 12.0,
        }),
    ]
    .map(|protocol| DriveProfile {
        protocol,
        id: 3,
        host_id: 0x13,
        sign: if choice & 32 == 0 { 1.0 } else { -1.0 },
        zero: 0.4,
        gear: if choice & 64 == 0 { 1.0 } else { 8.0 },
        torque_limit: 9.0,
    })
}

/// One choice, four bytes of identifier (bit 31: extended, 30: FD, 29: remote), and the data.
pub fn drives(input: &[u8]) {
    let Some((&[choice, i0, i1, i2, i3], data)) = input.split_first_chunk() else {
        return;
    };
    let word = u32::from_le_bytes([i0, i1, i2, i3]);
    let mut frame = Frame::new(word, word >> 31 == 1, data);
    frame.remote = word >> 29 & 1 == 1;
    if word >> 30 & 1 == 1 {
        frame = frame.into_fd(0x50);
    }
    for profile in profiles(choice) {
        match profile.decode(&frame) {
            Some(Event::Reply(reply)) => {
                let motion = [reply.position, reply.velocity, reply.torque];
                let mut values = motion.into_iter().chain([reply.temperature]).flatten();
                assert!(values.all(f32::is_finite), "{frame:?} {reply:?}");
                profile.reply(&reply, &mut Frames::new());
            }
            Some(Event::Scale(_, value)) => assert!(value.is_finite(), "{frame:?}"),
            None => {}
        }
        if let Some(Request::Command(command)) = profile.accept(&frame) {
            assert!(command.is_finite(), "{frame:?} {command:?}");
            let mut frames = Frames::new();
            profile.command(&command, &mut Carry::default(), &mut frames);
            let read = profile.accept(&frames[0]);
            let torque = match read {
                Some(Request::Command(command)) => command.torque,
                _ => 0.0,
            };
            let most = 9.0 + profile.torque_resolution().max(0.01);
            assert!(torque.abs() <= most, "{frame:?} {command:?} {read:?}");
        }
    }
    if let Some(read) = text::read_line(data) {
        let line = text::write_line(&read, text::Direction::Receive);
        assert_eq!(text::read_line(&line), Some(read));
    }
}

/// A command, a reply and every order of every protocol, and lines of text.
pub(crate) fn frames() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for choice in [0, 1, 2, 4, 8] {
        for profile in profiles(choice) {
            let mut frames = Frames::new();
            let command = JointCommand {
                position: 0.5,
                torque: 1.0,
                kp: 20.0,
                ..JointCommand::default()
            };
            profile.command(&command, &mut Carry::default(), &mut frames);
            let mut replies = Frames::new();
            profile.reply(&JointReply::default(), &mut replies);
            let mut orders = Frames::new();
            profile.order(Order::ReadScale(Scale::Torque), &mut orders);
            for frame in frames.iter().chain(&replies).chain(&orders) {
                let flags = u32::from(frame.extended) << 31 | u32::from(frame.remote) << 29;
                let id = (frame.id | flags).to_le_bytes();
                seeds.push([&[choice], &id[..], frame.bytes()].concat());
                let line = text::write_line(frame, text::Direction::Send);
                seeds.push([&[choice, 0, 0, 0, 0], &line[..]].concat());
            }
        }
    }
    seeds
}
