//! Codecs: command and reply there and back, saturation, refusal, unbiased torque.

use super::*;

const RANGES: Ranges = Ranges {
    position: 12.5,
    velocity: 30.0,
    torque: 10.0,
    kp: 500.0,
    kd: 5.0,
};

fn damiao() -> DriveProfile {
    DriveProfile {
        protocol: Protocol::Damiao(RANGES),
        id: 3,
        host_id: 0x13,
        sign: -1.0,
        zero: 0.4,
        gear: 1.0,
        torque_limit: 9.0,
    }
}

#[test]
fn zero_torque_has_no_mean() {
    let (profile, mut carry) = (damiao(), Carry::default());
    let torque = |carry: &mut Carry| {
        let mut frames = Frames::new();
        let _ = profile.command(&JointCommand::default(), carry, &mut frames);
        match profile.accept(&frames[0]) {
            Some(Request::Command(command)) => command.torque,
            other => panic!("{other:?}"),
        }
    };
    let (first, second) = (torque(&mut carry), torque(&mut carry));
    assert!(
        first != 0.0 && (first + second).abs() < 1e-5,
        "{first} {second}"
    );
}

#[test]
fn values_that_are_not_finite_take_the_torque_off() {
    let (profile, mut frames) = (damiao(), Frames::new());
    let command = JointCommand {
        kd: f32::NAN,
        ..JointCommand::default()
    };
    let flags = profile.command(&command, &mut Carry::default(), &mut frames);
    assert_eq!(flags, Saturation::REFUSED);
    assert_eq!(
        profile.accept(&frames[0]),
        Some(Request::Order(Order::Disable))
    );
}
