use crate::PERIODS;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
use foretorque_link::bank::ParameterBank;
use foretorque_link::wire::{Configuration, HostMessage, Pacing, SampleFrame, encode};

/// Writes the seeds of a target into the directory FORETORQUE_SEEDS, if it is set.
pub fn plant(target: &str) {
    let Some(directory) = std::env::var_os("FORETORQUE_SEEDS") else {
        return;
    };
    for (number, seed) in seeds(target).iter().enumerate() {
        let file = std::path::Path::new(&directory).join(format!("seed-{number}"));
        std::fs::write(&file, seed).expect("the directory of the seeds can be written");
    }
}

/// First inputs of a target: valid ones, made from the current types.
pub fn seeds(target: &str) -> Vec<Vec<u8>> {
    let banks = [
        bytes(&ParameterBank::nominal::<Ur5, 6, 40>()),
        bytes(&ParameterBank::nominal::<Panda, 7, 48>()),
    ];
    match target {
        "drives" => crate::drives::frames(),
        "bank" => banks
            .iter()
            .flat_map(|bank| {
                let body = bank.get(5..bank.len() - 4).unwrap_or_default();
                [[&[1], &bank[..]].concat(), [&[0], body].concat()]
            })
            .collect(),
        "store" => banks
            .iter()
            .map(|bank| {
                let mut sector = [0xFF; 32];
                sector[..4].copy_from_slice(b"FTSL");
                sector[4..8].copy_from_slice(&[1, 0, ParameterBank::FORMAT_VERSION, 0xFF]);
                sector[8..12].copy_from_slice(&1u32.to_le_bytes());
                sector[12..16].copy_from_slice(&bank[5..9]);
                sector[16..20].copy_from_slice(&(bank.len() as u32).to_le_bytes());
                let half = [&sector[..], bank].concat();
                [&[0], &half[..], &half[..]].concat()
            })
            .collect(),
        _ => {
            let all: Vec<u8> = messages()
                .iter()
                .flat_map(|m| [&[m.len() as u8], &m[..]].concat())
                .collect();
            let one = messages()
                .into_iter()
                .map(|m| [&[0, m.len() as u8], &m[..]].concat());
            // The decoder keeps to inputs of one frame or two, which are fast.
            if target != "session" {
                return one.collect();
            }
            let long = [&[0], &all[..]].concat();
            one.chain([long]).chain(lives()).collect()
        }
    }
}

fn bytes(bank: &ParameterBank) -> Vec<u8> {
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer)
        .expect("the buffer fits the largest bank")
        .to_vec()
}

/// The bytes of a message of each kind that a host may send.
fn messages() -> Vec<Vec<u8>> {
    let rest = JointSample {
        desired: JointMotion::<6>::zero(),
        measured: None,
    };
    let mut messages = vec![
        HostMessage::Hello,
        HostMessage::Sample(SampleFrame::new(&rest)),
        HostMessage::Evaluate((&rest.desired).into()),
        HostMessage::Configure(Configuration::default()),
        HostMessage::Learning { on: true },
        HostMessage::Statistics,
        HostMessage::Reset,
    ];
    let bank = bytes(&ParameterBank::nominal::<Ur5, 6, 40>());
    for (place, chunk) in bank.chunks(64).enumerate() {
        let offset = (place * 64) as u16;
        messages.push(HostMessage::BankWrite {
            offset,
            bytes: chunk.iter().copied().collect(),
        });
    }
    messages.iter().map(body).collect()
}

/// Lives of a board with a timer: armed, moved and ended in every way, in both pacings.
fn lives() -> Vec<Vec<u8>> {
    let still = |q: f32| {
        let mut desired = JointMotion::<6>::zero();
        desired.q.fill(q);
        let measured = JointMeasurement {
            q: desired.q,
            tau: desired.q,
        };
        let measured = Some(measured);
        HostMessage::Sample(SampleFrame::new(&JointSample { desired, measured }))
    };
    let ends = [HostMessage::Disarm, HostMessage::Stop, HostMessage::Hello];
    let pacings = [Pacing::Link, Pacing::SysTick];
    let mut lives = Vec::new();
    for (pacing, end) in pacings
        .into_iter()
        .flat_map(|p| ends.iter().map(move |e| (p, e)))
    {
        let configured = HostMessage::Configure(Configuration {
            pacing,
            brake_close_ms: lives.len() as u16 % 2 * 40,
            ..Configuration::default()
        });
        let mut life = vec![0];
        let mut deliver = |message: &HostMessage<6>, periods: u8| {
            let bytes = body(message);
            life.push(bytes.len() as u8);
            life.extend(bytes);
            life.push(PERIODS + periods);
        };
        deliver(&configured, 0);
        (0..3).for_each(|_| deliver(&still(0.5), 0));
        deliver(&HostMessage::Arm, 0);
        (0..4).for_each(|k| deliver(&still(0.5 + 1e-3 * k as f32), k));
        deliver(&still(0.5), 5);
        deliver(end, 11);
        deliver(&HostMessage::ClearFault, 0);
        lives.push(life);
    }
    lives
}

/// Bytes of a message in its frame, between header and checksum.
fn body(message: &HostMessage<6>) -> Vec<u8> {
    let mut buffer = [0; foretorque_link::wire::MAX_FRAME];
    let frame = encode(1, message, &mut buffer).expect("a frame fits every message");
    let mut content = frame.to_vec();
    let length =
        cobs::decode_in_place(&mut content[..frame.len() - 1]).expect("it was just encoded");
    content.get(3..length - 4).unwrap_or_default().to_vec()
}
