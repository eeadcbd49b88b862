//! Codecs against the clients of tests/data/drives: 200 000 commands each, and replies.

use super::{motion, values};
use crate::drives::*;
use crate::wire::CRC;
use std::f32::consts::TAU;
use std::path::Path;

const ROWS: usize = 200_000;
const ID: u16 = 3;
const HOST: u16 = 0x13;

fn splitmix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

fn profile(protocol: Protocol) -> DriveProfile {
    let mut profile = DriveProfile {
        id: ID,
        host_id: HOST,
        sign: 1.0,
        zero: 0.0,
        ..super::profile(protocol)
    };
    profile.torque_limit = profile.largest_torque();
    profile.check().unwrap();
    profile
}

fn read(table: &str) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/drives");
    let text = std::fs::read_to_string(folder.join(format!("{table}.csv"))).unwrap();
    text.lines().map(String::from).collect()
}

fn frame(id: u32, data: &[u8]) -> Frame {
    Frame::new(id, id > Frame::STANDARD_MAX, data)
}

/// Command that the drive reads, in the units of the client.
fn accepted(client: &Client, profile: &DriveProfile, frame: &Frame) -> [f64; 5] {
    match profile.accept(frame) {
        Some(Request::Command(command)) => {
            let [p, v, torque, kp, kd] = values(&command);
            [p / client.unit, v / client.unit, torque, kp, kd].map(f64::from)
        }
        other => panic!("{}: {frame:?} reads as {other:?}", client.table),
    }
}

#[test]
fn commands_agree_with_the_clients() {
    for client in clients() {
        let (table, mut state) = (client.table, 1);
        let (profile, lines) = (profile(client.protocol), read(table));
        let (mut crc, mut equal, mut bias) = (CRC.digest(), 0, 0.0);
        for row in 0..ROWS {
            let share = [(); 5].map(|()| (splitmix(&mut state) >> 40) as f64 / f64::from(1 << 24));
            let value: [f64; 5] = std::array::from_fn(|place| {
                let full = if place < 3 {
                    2.4 * share[place] - 1.2
                } else {
                    1.2 * share[place]
                };
                f64::from((full * client.scales[place]) as f32)
            });
            let (id, data) = (client.frame)(value);
            crc.update(&id.to_le_bytes());
            crc.update(&data);
            if let Some(kept) = lines.get(row + 1).filter(|_| row < 200) {
                let line = format!("{id:x},{}", hex::encode(&data));
                assert_eq!(*kept, line, "{table}, row {row}: {value:?}");
            }
            let [p, v, torque, kp, kd] = value.map(|value| value as f32);
            let command = motion([p * client.unit, v * client.unit, torque, kp, kd]);
            let mut frames = Frames::new();
            profile.command(&command, &mut Carry::default(), &mut frames);
            let theirs = frame(id, &data);
            assert_eq!(frames[0].extended, theirs.extended);
            assert_eq!(frames[0].bytes().len(), data.len());
            equal += usize::from(frames[0].id == id && frames[0].bytes() == data);
            let ours = accepted(&client, &profile, &frames[0]);
            let theirs = accepted(&client, &profile, &theirs);
            for place in 0..5 {
                let (step, ours, theirs) = (client.steps[place], ours[place], theirs[place]);
                if step < 0.0 {
                    continue;
                }
                let rounding = 4e-7 * value[place].abs();
                // Half a step from the value, or at the end of the field, where the client is, too.
                let near = (ours - value[place]).abs() <= 0.51 * step + rounding;
                // A half may be rounded to either side.
                let tie = if (ours - theirs).abs() > 1.01 * step + rounding {
                    0.0
                } else {
                    step
                };
                let most = client.apart.max(tie / step.max(1e-30)) * 1.01 * step + rounding;
                let context = || format!("{table} field {place}: {ours} {theirs} {value:?}");
                assert!((ours - theirs).abs() <= most, "{}", context());
                let at_end = value[place].abs() >= 0.99 * ours.abs();
                assert!(near || at_end, "{}", context());
            }
            if value[2].abs() < 0.8 * client.scales[2] {
                bias += (ours[2] - value[2]) / client.steps[2].max(1e-9);
            }
        }
        let stated = lines[0].rsplit(' ').next().unwrap();
        let crc = format!("{:08x}", crc.finalize());
        assert_eq!(crc, stated, "{table}: the formula is not the client's");
        let bias = bias / ROWS as f64;
        println!("{table:16} {equal:6} of {ROWS} equal, mean rounding {bias:+.4} steps");
        let unbiased = client.steps[2] <= 0.0 || bias.abs() < 5e-3;
        assert!(unbiased, "{table}: bias {bias}");
        if client.apart == 0.0 && !table.starts_with("moteus") {
            assert!(equal * 10 > ROWS * 4, "{table}: {equal}");
        }
    }
}

#[test]
fn replies_agree_with_the_clients() {
    for client in clients() {
        let profile = profile(client.protocol);
        for line in read(client.table).iter().skip(201) {
            let fields: Vec<&str> = line.split(',').collect();
            let id = u32::from_str_radix(fields[0], 16).unwrap();
            let event = profile.decode(&frame(id, &hex::decode(fields[1]).unwrap()));
            let Some(Event::Reply(reply)) = event else {
                panic!("{}: {line}: {event:?}", client.table)
            };
            let unit = |value: Option<f32>| value.map(|value| value / client.unit);
            let ours = [unit(reply.position), unit(reply.velocity), reply.torque];
            for ((ours, theirs), scale) in ours.into_iter().zip(&fields[2..]).zip(client.scales) {
                let theirs = theirs.parse::<f32>().ok();
                let near = |ours: f32, theirs: f32| {
                    let most = 3e-7 * (f64::from(theirs).abs() + scale);
                    f64::from((ours - theirs).abs()) <= most
                };
                let same = match (ours, theirs) {
                    (Some(ours), Some(theirs)) => near(ours, theirs),
                    (ours, theirs) => ours == theirs,
                };
                assert!(same, "{}: {line}: {ours:?}", client.table);
            }
        }
    }
}

/// Frame of a command.
type Sent = (u32, Vec<u8>);

/// Client of one table.
struct Client {
    table: &'static str,
    protocol: Protocol,
    /// Full scales of the random commands.
    scales: [f64; 5],
    /// Radians of a unit of position and velocity.
    unit: f32,
    /// Steps of the fields; negative where the frame has no such field.
    steps: [f64; 5],
    /// Its frame of a command.
    frame: Box<dyn Fn([f64; 5]) -> Sent>,
    /// Largest distance of its codes from ours, in steps; 0 for equal bytes.
    apart: f64,
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
fn clients() -> [Client; 9] {
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
