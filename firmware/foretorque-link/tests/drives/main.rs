//! Codecs against the clients of tests/data/drives: 200 000 commands each, and replies.

mod clients;

use clients::{Client, clients};
use foretorque_link::drives::*;
use std::path::Path;

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
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
        protocol,
        id: ID,
        host_id: HOST,
        sign: 1.0,
        zero: 0.0,
        gear: 1.0,
        torque_limit: 1.0,
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

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
        .collect()
}

fn frame(id: u32, data: &[u8]) -> Frame {
    Frame::new(id, id > Frame::STANDARD_MAX, data)
}

/// Command that the drive reads, in the units of the client.
fn accepted(client: &Client, profile: &DriveProfile, frame: &Frame) -> [f64; 5] {
    match profile.accept(frame) {
        Some(Request::Command(c)) => [
            c.position / client.unit,
            c.velocity / client.unit,
            c.torque,
            c.kp,
            c.kd,
        ]
        .map(f64::from),
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
                let hex: String = data.iter().map(|byte| format!("{byte:02x}")).collect();
                let line = format!("{id:x},{hex}");
                assert_eq!(*kept, line, "{table}, row {row}: {value:?}");
            }
            let [p, v, torque, kp, kd] = value.map(|value| value as f32);
            let (position, velocity) = (p * client.unit, v * client.unit);
            let command = JointCommand {
                position,
                velocity,
                torque,
                kp,
                kd,
            };
            let mut frames = Frames::new();
            let _ = profile.command(&command, &mut Carry::default(), &mut frames);
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
            let event = profile.decode(&frame(id, &bytes(fields[1])));
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
