//! The frames of the clients, as formulas.

use super::{HOST, ID};
use foretorque_link::drives::*;
use std::f32::consts::TAU;

/// Client of one table.
pub(crate) struct Client {
    pub(crate) table: &'static str,
    pub(crate) protocol: Protocol,
    /// Full scales of the random commands.
    pub(crate) scales: [f64; 5],
    /// Radians of a unit of position and velocity.
    pub(crate) unit: f32,
    /// Steps of the fields; negative where the frame has no such field.
    pub(crate) steps: [f64; 5],
    /// Its frame of a command.
    pub(crate) frame: fn([f64; 5]) -> (u32, Vec<u8>),
    /// Largest distance of its codes from ours, in steps; 0 for equal bytes.
    pub(crate) apart: f64,
}

fn damiao([p, v, t, kp, kd]: [f64; 5]) -> (u32, Vec<u8>) {
    let code = |x: f64, low: f64, high: f64, steps: f64| {
        ((x.clamp(low, high) - low) * steps / (high - low)) as u64
    };
    let bits = code(p, -12.5, 12.5, 65535.0) << 48
        | code(v, -30.0, 30.0, 4095.0) << 36
        | code(kp, 0.0, 500.0, 4095.0) << 24
        | code(kd, 0.0, 5.0, 4095.0) << 12
        | code(t, -10.0, 10.0, 4095.0);
    (ID.into(), bits.to_be_bytes().into())
}

fn robstride([p, v, t, kp, kd]: [f64; 5]) -> (u32, Vec<u8>) {
    let range = 4.0 * std::f64::consts::PI;
    let code = |x: f64, scale: f64| ((x.clamp(-scale, scale) / scale + 1.0) * 32767.0) as u16;
    // The torque is clamped as a code, not as a torque.
    let torque = ((t / 17.0 + 1.0) * 32767.0).clamp(0.0, 65535.0) as u32;
    let gain = |x: f64, scale: f64| (x.clamp(0.0, scale) / scale * 65535.0) as u16;
    let data = [
        code(p, range),
        code(v, 44.0),
        gain(kp, 500.0),
        gain(kd, 5.0),
    ];
    (
        1 << 24 | torque << 8 | u32::from(ID),
        data.iter().flat_map(|code| code.to_be_bytes()).collect(),
    )
}

fn moteus<const N: usize>(
    scales: [f64; 5],
    [p, v, t, kp, kd]: [f64; 5],
    first: u8,
) -> (u32, Vec<u8>) {
    let most = if N == 2 { 32767.0 } else { 2_147_483_647.0 };
    let mut data = vec![1, 0, 10, first, 5, 0x20];
    for (value, scale) in [p, v, t, kp, kd].into_iter().zip(scales) {
        match first {
            0x0c => data.extend((value as f32).to_le_bytes()),
            _ => data.extend(&((value / scale).clamp(-most, most) as i32).to_le_bytes()[..N]),
        }
    }
    data.extend([0x0d, 0x27]);
    data.extend(0.0625_f32.to_le_bytes());
    data.extend([0x11, 0, 0x10 | first | 3, 1, 0x12, 0x0e]);
    let length = [16, 20, 24, 32, 48]
        .into_iter()
        .find(|length| *length >= data.len())
        .unwrap();
    data.resize(length, 0x50);
    (0x8000 | u32::from(HOST) << 8 | u32::from(ID), data)
}

fn odrive(command: u32, fields: &[&[u8]]) -> (u32, Vec<u8>) {
    (u32::from(ID) << 5 | command, fields.concat())
}

fn cia402([p, _, t, _, _]: [f64; 5]) -> (u32, Vec<u8>) {
    // Halves away from zero.
    let position = (p * 65536.0).round() as i32;
    let torque = (t * 1000.0 / 12.0).round().clamp(-32767.0, 32767.0) as i16;
    (
        0x200 + u32::from(ID),
        [&[15, 0], &position.to_le_bytes()[..], &torque.to_le_bytes()].concat(),
    )
}

const fn with(resolution: Resolution) -> Protocol {
    Protocol::Moteus(Moteus {
        kp: TAU,
        kd: TAU,
        watchdog_s: 0.0625,
        resolution,
    })
}

const fn axis(mode: ControlMode) -> Protocol {
    Protocol::Odrive(Odrive {
        mode,
        velocity_scale: 1000.0,
        torque_scale: 1000.0,
        torque_scale_endpoint: 0,
        polled: false,
    })
}

const INT16: [f64; 5] = [1e-4, 2.5e-4, 0.01, 1.0 / 32767.0, 1.0 / 32767.0];
const INT32: [f64; 5] = [
    1e-5,
    1e-5,
    1e-3,
    1.0 / 2_147_483_647.0,
    1.0 / 2_147_483_647.0,
];

/// Every client.
pub(crate) fn clients() -> Vec<Client> {
    let ranges = |position, velocity, torque| Ranges {
        position,
        velocity,
        torque,
        kp: 500.0,
        kd: 5.0,
    };
    let moteus_scales = [3.0, 10.0, 20.0, 0.8, 0.8];
    let turns = |table, protocol, scales, steps, apart, frame| Client {
        table,
        protocol,
        scales,
        unit: TAU,
        steps,
        frame,
        apart,
    };
    let axis_scales = [50.0, 40.0, 40.0, 1.0, 1.0];
    let counts = Cia402 {
        mode: ControlMode::Position,
        counts_per_turn: 65536.0,
        rated_torque: 12.0,
    };
    vec![
        Client {
            table: "damiao",
            protocol: Protocol::Damiao(ranges(12.5, 30.0, 10.0)),
            scales: [12.5, 30.0, 10.0, 500.0, 5.0],
            unit: 1.0,
            steps: [
                25.0 / 65535.0,
                60.0 / 4095.0,
                20.0 / 4095.0,
                500.0 / 4095.0,
                5.0 / 4095.0,
            ],
            frame: damiao,
            apart: 1.0,
        },
        Client {
            table: "robstride",
            protocol: Protocol::RobStride(ranges(2.0 * TAU, 44.0, 17.0)),
            scales: [12.566370964050293, 44.0, 17.0, 500.0, 5.0],
            unit: 1.0,
            steps: [8.0 * std::f64::consts::PI, 88.0, 34.0, 500.0, 5.0].map(|span| span / 65535.0),
            frame: robstride,
            apart: 2.0,
        },
        turns(
            "moteus_f32",
            with(Resolution::F32),
            moteus_scales,
            [0.0; 5],
            0.0,
            |c| moteus::<4>(INT32, c, 0x0c),
        ),
        turns(
            "moteus_int32",
            with(Resolution::Int32),
            moteus_scales,
            INT32,
            1.0,
            |c| moteus::<4>(INT32, c, 0x08),
        ),
        turns(
            "moteus_int16",
            with(Resolution::Int16),
            moteus_scales,
            INT16,
            1.0,
            |c| moteus::<2>(INT16, c, 0x04),
        ),
        turns(
            "odrive_position",
            axis(ControlMode::Position),
            axis_scales,
            [0.0, 1e-3, 1e-3, -1.0, -1.0],
            0.0,
            |c| {
                let scaled = |x: f64| {
                    ((x.clamp(-32.767, 32.767) / 0.001).round_ties_even() as i16).to_le_bytes()
                };
                odrive(
                    0x0c,
                    &[&(c[0] as f32).to_le_bytes(), &scaled(c[1]), &scaled(c[2])],
                )
            },
        ),
        turns(
            "odrive_velocity",
            axis(ControlMode::Velocity),
            axis_scales,
            [-1.0, 0.0, 0.0, -1.0, -1.0],
            0.0,
            |c| {
                odrive(
                    0x0d,
                    &[&(c[1] as f32).to_le_bytes(), &(c[2] as f32).to_le_bytes()],
                )
            },
        ),
        turns(
            "odrive_torque",
            axis(ControlMode::Torque),
            axis_scales,
            [-1.0, -1.0, 0.0, -1.0, -1.0],
            0.0,
            |c| odrive(0x0e, &[&(c[2] as f32).to_le_bytes(), &[0; 4]]),
        ),
        turns(
            "cia402_position",
            Protocol::Cia402(counts),
            axis_scales,
            [1.0 / 65536.0, -1.0, 0.012, -1.0, -1.0],
            0.0,
            cia402,
        ),
    ]
}
