//! The tick of the flashable firmware around two pipes of the emulator: the same code, many more ticks a second.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod run {
    use core::mem::MaybeUninit;

    use foretorque_f405::arm::BoardSession;
    use foretorque_f405::arm::{Arm, JOINTS, Learner, PARAMETERS, init_learner};
    use foretorque_f405::counter::{self, Counter};
    use foretorque_images::{Streams, exit};
    use foretorque_link::session::{BoardDescription, Housekeeping, Mailboxes, NoLocalSensor};
    use foretorque_link::wire::{Capabilities, FrameBuffer, ResetReason};
    use stm32f4xx_hal::pac;

    /// Bytes handed to the session at once.
    const CHUNK: usize = 64;

    /// Runs until the host hangs up. Ends the emulator with an error when it could not start.
    #[cortex_m_rt::entry]
    fn main() -> ! {
        exit(run().is_some())
    }

    fn run() -> Option<()> {
        let streams = Streams::open()?;
        let counter = counter::start_instructions(&pac::Peripherals::take()?.TIM2);
        let board = BoardDescription {
            capabilities: Capabilities::LEARNING,
            counter,
            // Virtual time is not the chip's: there is no honest number.
            counter_hz: 0,
            reset_reason: ResetReason::Unknown,
            ..BoardDescription::plain(Counter)
        };
        let place = cortex_m::singleton!(: MaybeUninit<BoardSession> = MaybeUninit::uninit())?;
        let session = BoardSession::init_in_place(place, board).ok()?;
        let period_s = session.configuration().period_us as f32 * 1e-6;
        let prior = &session.feed_forward().state().active;
        let place = cortex_m::singleton!(: MaybeUninit<Learner> = MaybeUninit::uninit())?;
        let learner = init_learner(place, period_s, prior)?;
        let housekeeping =
            cortex_m::singleton!(: Housekeeping<Arm, JOINTS, PARAMETERS> = Housekeeping::empty())?;
        housekeeping.start(None);
        let mut mailboxes = Mailboxes::default();
        let mut out = FrameBuffer::new();
        let mut buffer = [0u8; 1024];

        session.send_hello(&mut out);
        if !streams.write(out.as_bytes()) {
            return Some(());
        }
        out.clear();
        while let Some(bytes) = streams.read(&mut buffer) {
            // In pieces, as the flashable firmware takes them: a piece cannot ask for more than the replies can carry.
            for piece in bytes.chunks(CHUNK) {
                session.receive(piece, &mut mailboxes, &mut out, &mut NoLocalSensor);
                if housekeeping.work(&mut mailboxes.parameters) {
                    session.poll_parameters(&mut mailboxes, &mut out);
                }
                if !out.is_empty() && !streams.write(out.as_bytes()) {
                    return Some(());
                }
                out.clear();
                mailboxes.learner.work(learner, &Counter);
            }
        }
        Some(())
    }

    /// Reports no place: the host gets the emulator's exit status, a debugger shows the rest.
    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        exit(false)
    }
}

foretorque_f405::on_the_host!();
