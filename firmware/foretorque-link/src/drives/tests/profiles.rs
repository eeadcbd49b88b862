//! Profiles that contradict themselves.

use super::*;

#[test]
fn profiles_that_contradict_themselves_are_refused() {
    let good = profile(Protocol::Damiao(RANGES));
    assert_eq!(good.check(), Ok(()));
    for (profile, field) in [
        (DriveProfile { sign: 0.5, ..good }, "size of sign"),
        (
            DriveProfile {
                sign: f32::NAN,
                ..good
            },
            "sign",
        ),
        (DriveProfile { gear: 0.0, ..good }, "gear"),
        (
            DriveProfile {
                torque_limit: 10.1,
                ..good
            },
            "torque_limit",
        ),
        (
            DriveProfile {
                torque_limit: f32::NAN,
                ..good
            },
            "torque_limit",
        ),
        (DriveProfile { id: 0, ..good }, "id"),
        (
            DriveProfile {
                id: 63,
                ..profile(odrive(ControlMode::Position))
            },
            "id",
        ),
        (
            profile(Protocol::Damiao(Ranges { kd: 0.0, ..RANGES })),
            "kd",
        ),
    ] {
        assert_eq!(profile.check().map_err(|error| error.field), Err(field));
    }
}
