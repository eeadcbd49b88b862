//! The proof that nothing the board runs every tick can panic: this does not link when a panic can be reached.
//!
//! It calls every public entry of the tick with values the compiler cannot see through. To find a culprit, replace
//! `panic_never` by a handler of one's own and look for callers of `core::panicking` in the disassembly.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod proof {
    use core::hint::black_box;

    use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5 as Arm};
    use foretorque::learning::{Learner, LearnerConfig};
    use foretorque_link::session::{
        BoardDescription, Clock, Housekeeping, Mailboxes, NoLocalSensor, Session,
    };
    use foretorque_link::wire::{BoardMessage, Decoder, FrameBuffer, HostMessage};
    use foretorque_link::write_key::{KEY_BYTES, WriteKey};
    use {panic_never as _, stm32f4xx_hal as _};

    #[cortex_m_rt::entry]
    fn main() -> ! {
        loop {
            run();
        }
    }

    /// A clock whose count the compiler cannot see through.
    struct Opaque;

    impl Clock for Opaque {
        fn now(&self) -> u32 {
            black_box(0)
        }
    }

    fn run() -> Option<()> {
        let mut session = black_box(
            Session::<Arm, JOINTS, PARAMETERS, _>::new(black_box(BoardDescription {
                write_key: WriteKey::from_slot(black_box([1; KEY_BYTES])),
                ..BoardDescription::plain(Opaque)
            }))
            .ok()?,
        );
        let set = black_box(session.feed_forward().state().active);
        let mut learner: Learner<Arm, _, _> =
            Learner::new(LearnerConfig::for_arm::<Arm>(black_box(1e-3)), set).ok()?;
        let mut mailboxes = black_box(Mailboxes::default());
        let mut housekeeping: Housekeeping<Arm, JOINTS, PARAMETERS> = Housekeeping::new(None);
        let mut out = black_box(FrameBuffer::new());
        let mut bytes = black_box([0u8; 64]);
        loop {
            // Every message of the link: decode, tick, bank, statistics, reset.
            let received = black_box(&bytes);
            session.receive(received, &mut mailboxes, &mut out, &mut NoLocalSensor);
            session.timer_tick(&mut mailboxes, &mut out, &mut NoLocalSensor);
            housekeeping.work(&mut mailboxes.parameters);
            session.poll_parameters(&mut mailboxes, &mut out);
            session.note_overruns(1);
            session.note_missed(1);
            session.send_hello(&mut out);
            // The learner as the board runs it, and as the other owners do.
            while let Some(sample) = mailboxes.learner.begin(&mut learner) {
                learner.study(&sample);
                mailboxes.learner.finish(&mut learner, black_box(1));
            }
            mailboxes.learner.work(&mut learner, &Opaque);
            black_box(session.statistics(&mailboxes.learner));
            // The host's half, for people who put both on a board.
            let mut decoder = Decoder::new();
            let message = decoder
                .push(black_box(0))?
                .ok()?
                .message::<HostMessage<JOINTS>>()
                .ok()?;
            out.push(black_box(1), &message).ok()?;
            let answer = decoder
                .push(black_box(0))?
                .ok()?
                .message::<BoardMessage<JOINTS>>()
                .ok()?;
            out.push(black_box(1), &answer).ok()?;
            bytes = black_box(bytes);
            black_box(out.as_bytes());
            out.clear();
        }
    }
}

foretorque_f405::on_the_host!();
