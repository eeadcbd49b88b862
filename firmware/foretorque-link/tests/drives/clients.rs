//! The frames of the clients, as formulas.

use super::{HOST, ID};
use foretorque_link::drives::*;
use std::f32::consts::TAU;

/// Frame of a command.
type Sent = (u32, Vec<u8>);

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
    pub(crate) frame: Box<dyn Fn([f64; 5]) -> Sent>,
    /// Largest distance of its codes from ours, in steps; 0 for equal bytes.
    pub(crate) apart: f64,
}

fn damiao([p, v, t, kp, kd]: [f64; 5]) -> Sent {
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

fn robstride([p, v, t, kp, kd]: [f64; 5]) -> Sent {
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

/// Steps of integers on the wire: turns, turns/s, N·m, parts of the gains.
const INT16: [f64; 5] = [1e-4, 2.5e-4, 0.01, 1.0 / 32767.0, 1.0 / 32767.0];
const INT32: [f64; 5] = {
    let part = 1.0 / 2_147_483_647.0;
    [1e-5, 1e-5, 1e-3, part, part]
};

fn moteus(resolution: Resolution, values: [f64; 5]) -> Sent {
    let form = match resolution {
        Resolution::Int16 => 0x04,
        Resolution::Int32 => 0x08,
        Resolution::F32 => 0x0c,
    };
    let mut data = vec![1, 0, 10, form, 5, 0x20];
    for (place, value) in values.into_iter().enumerate() {
        let code = |steps: [f64; 5], most: i32| {
            (value / steps[place]).clamp((-most).into(), most.into()) as i32
        };
        match resolution {
            Resolution::F32 => data.extend((value as f32).to_le_bytes()),
            Resolution::Int32 => data.extend(code(INT32, i32::MAX).to_le_bytes()),
            Resolution::Int16 => data.extend((code(INT16, 32767) as i16).to_le_bytes()),
        }
    }
    data.extend([0x0d, 0x27]);
    data.extend(0.0625_f32.to_le_bytes());
    data.extend([0x11, 0, 0x10 | form | 3, 1, 0x12, 0x0e]);
    let mut lengths = [16, 20, 24, 32, 48].into_iter();
    let length = lengths.find(|length| *length >= data.len()).unwrap();
    data.resize(length, 0x50);
    (0x8000 | u32::from(HOST) << 8 | u32::from(ID), data)
}

fn odrive(mode: ControlMode, [p, v, t, _, _]: [f64; 5]) -> Sent {
    let float = |x: f64| (x as f32).to_le_bytes();
    let scaled =
        |x: f64| ((x.clamp(-32.767, 32.767) / 0.001).round_ties_even() as i16).to_le_bytes();
    let (command, data) = match mode {
        ControlMode::Position => (0x0c, [&float(p)[..], &scaled(v), &scaled(t)].concat()),
        ControlMode::Velocity => (0x0d, [float(v), float(t)].concat()),
        ControlMode::Torque => (0x0e, [float(t), [0; 4]].concat()),
    };
    (u32::from(ID) << 5 | command, data)
}

fn cia402([p, _, t, _, _]: [f64; 5]) -> Sent {
    // Halves away from zero.
    let position = (p * 65536.0).round() as i32;
    let torque = (t * 1000.0 / 12.0).round().clamp(-32767.0, 32767.0) as i16;
    (
        0x200 + u32::from(ID),
        [&[15, 0], &position.to_le_bytes()[..], &torque.to_le_bytes()].concat(),
    )
}

fn moteus_client(table: &'static str, resolution: Resolution) -> Client {
    let (steps, apart) = match resolution {
        Resolution::Int16 => (INT16, 1.0),
        Resolution::Int32 => (INT32, 1.0),
        Resolution::F32 => ([0.0; 5], 0.0),
    };
    Client {
        table,
        protocol: Protocol::Moteus(Moteus {
            kp: TAU,
            kd: TAU,
            watchdog_s: 0.0625,
            resolution,
        }),
        scales: [3.0, 10.0, 20.0, 0.8, 0.8],
        unit: TAU,
        steps,
        frame: Box::new(move |values| moteus(resolution, values)),
        apart,
    }
}

const AXIS_SCALES: [f64; 5] = [50.0, 40.0, 40.0, 1.0, 1.0];

fn odrive_client(table: &'static str, mode: ControlMode, [p, v, t]: [f64; 3]) -> Client {
    Client {
        table,
        protocol: Protocol::Odrive(Odrive {
            mode,
            velocity_scale: 1000.0,
            torque_scale: 1000.0,
            torque_scale_endpoint: 0,
            polled: false,
        }),
        scales: AXIS_SCALES,
        unit: TAU,
        steps: [p, v, t, -1.0, -1.0],
        frame: Box::new(move |values| odrive(mode, values)),
        apart: 0.0,
    }
}

/// Every client.
pub(crate) fn clients() -> [Client; 9] {
    let ranges = |position, velocity, torque| Ranges {
        position,
        velocity,
        torque,
        kp: 500.0,
        kd: 5.0,
    };
    let counts = Cia402 {
        mode: ControlMode::Position,
        counts_per_turn: 65536.0,
        rated_torque: 12.0,
    };
    [
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
            frame: Box::new(damiao),
            apart: 1.0,
        },
        Client {
            table: "robstride",
            protocol: Protocol::RobStride(ranges(2.0 * TAU, 44.0, 17.0)),
            scales: [12.566370964050293, 44.0, 17.0, 500.0, 5.0],
            unit: 1.0,
            steps: [8.0 * std::f64::consts::PI, 88.0, 34.0, 500.0, 5.0].map(|span| span / 65535.0),
            frame: Box::new(robstride),
            apart: 2.0,
        },
        moteus_client("moteus_f32", Resolution::F32),
        moteus_client("moteus_int32", Resolution::Int32),
        moteus_client("moteus_int16", Resolution::Int16),
        odrive_client("odrive_position", ControlMode::Position, [0.0, 1e-3, 1e-3]),
        odrive_client("odrive_velocity", ControlMode::Velocity, [-1.0, 0.0, 0.0]),
        odrive_client("odrive_torque", ControlMode::Torque, [-1.0, -1.0, 0.0]),
        Client {
            table: "cia402_position",
            protocol: Protocol::Cia402(counts),
            scales: AXIS_SCALES,
            unit: TAU,
            steps: [1.0 / 65536.0, -1.0, 0.012, -1.0, -1.0],
            frame: Box::new(cia402),
            apart: 0.0,
        },
    ]
}
