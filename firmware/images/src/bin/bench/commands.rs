//! Commands that a board may receive, one a call, and the orders that the housekeeping has finished.

use core::mem::MaybeUninit;

use foretorque::arm::Arm as _;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::JointMotion;
use foretorque_link::session::{
    BoardDescription, Housekeeping, Mailboxes, NoClock, NoLocalSensor, Session,
};
use foretorque_link::wire::{BankSource, Configuration, FrameBuffer, HostMessage, MAC_BYTES};
use foretorque_link::write_key::{KEY_BYTES, WriteKey};

/// Calls after which the commands begin again: fewer than a row is traced.
const CALLS: u32 = 9;
const SEED: [u8; MAC_BYTES] = [5; MAC_BYTES];

/// A keyed board without a store, and its next frame.
pub(crate) struct Link {
    session: Session<Ur5, JOINTS, PARAMETERS>,
    mailboxes: Mailboxes<JOINTS, PARAMETERS>,
    housekeeping: Housekeeping<Ur5, JOINTS, PARAMETERS>,
    frame: FrameBuffer,
    out: FrameBuffer,
    call: u32,
}

impl Link {
    /// Initialises a board in place; `None` if a limit of the arm cannot work.
    #[inline(never)]
    pub(crate) fn init(place: &'static mut MaybeUninit<Self>) -> Option<&'static mut Self> {
        let session = Session::new(BoardDescription {
            write_key: Some(key()),
            seed: Some(SEED),
            ..BoardDescription::plain(NoClock)
        });
        Some(place.write(Self {
            session: session.ok()?,
            mailboxes: Mailboxes::default(),
            housekeeping: Housekeeping::new(None),
            frame: FrameBuffer::new(),
            out: FrameBuffer::new(),
            call: 0,
        }))
    }

    /// The next frame: of a command that the board takes while it is armed, or the one to `configure` it, the dearest at
    /// rest. The housekeeping executes what the last one ordered.
    pub(crate) fn next(&mut self, configure: bool) {
        self.housekeeping.work(&mut self.mailboxes.parameters);
        self.out.clear();
        self.frame.clear();
        let order = [9, 0];
        let motion = JointMotion::<JOINTS>::zero();
        let round = self.call / CALLS;
        if configure {
            // The same numbers whatever the calls before.
            self.call = self.call.max(0x1000);
        }
        let sequence = self.call as u16 + 1;
        let message = match self.call % CALLS {
            _ if configure => HostMessage::Configure(Configuration::default()),
            0 => HostMessage::Evaluate((&motion).into()),
            1 => HostMessage::BankWrite {
                offset: 0,
                bytes: [7; 64].into_iter().collect(),
            },
            2 => HostMessage::BankRead {
                source: BankSource::Live,
                offset: 0,
            },
            // Nothing arrives: the reply to the order before is taken over.
            3 => HostMessage::Stop,
            4 => HostMessage::BankRead {
                source: BankSource::Live,
                offset: 64,
            },
            5 => HostMessage::Statistics,
            6 => HostMessage::Challenge,
            7 => {
                let nonce = key().challenge(&SEED, round);
                let mac = key().sign_order(&nonce, Ur5::HASH, order);
                HostMessage::Unlock { order, mac }
            }
            _ => HostMessage::Hello,
        };
        if !matches!(message, HostMessage::Stop) {
            let _ = self.frame.push(sequence, &message);
        }
        self.call += 1;
    }

    /// Work of the tick's task for the command, without a tick.
    #[inline(always)]
    pub(crate) fn run(&mut self) {
        self.session
            .poll_parameters(&mut self.mailboxes, &mut self.out);
        let (frame, out) = (self.frame.as_bytes(), &mut self.out);
        self.session
            .receive(frame, &mut self.mailboxes, out, &mut NoLocalSensor);
    }
}

fn key() -> WriteKey {
    WriteKey::from_slot([3; KEY_BYTES]).expect("a key that is not blank")
}
