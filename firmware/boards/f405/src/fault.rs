//! The way out: outputs safe, reason kept over the reset, restart. Nothing here waits.

use core::mem::MaybeUninit;
use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::peripheral::SCB;
use foretorque_link::hal::TorqueEnable;
use foretorque_link::safety::SafetyReason;
use foretorque_link::wire::ResetReason;
use stm32f4xx_hal::pac::RCC;

use crate::board::{Board, EnablePin};

/// Why the board restarted itself. The number is what is kept over the reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
#[repr(u8)]
pub enum Reason {
    /// It did not: power on, the reset pin, a debugger.
    None = 0,
    /// A panic; the place is the line of the source.
    Panic = 1,
    /// A hard fault; the place is the address of the instruction.
    HardFault = 2,
    /// An interrupt or exception without a handler; the place is its number.
    Unexpected = 3,
    /// A configuration built into the firmware was refused; the place is the line of the source.
    Setup = 4,
    /// The stack ran out of its region; there is no place.
    Stack = 5,
    /// The host requested it; there is no place.
    Requested = 6,
}

/// Record kept over a reset: a mark, reason, place, and their check word. The linker leaves the section alone at start-up,
/// and a reset does not clear the RAM (RM0090 6.1).
#[unsafe(link_section = ".uninit.reason")]
static mut KEPT: MaybeUninit<[u32; 4]> = MaybeUninit::uninit();

/// The fault that safety has latched, likewise: a mark, its code, their check word.
#[unsafe(link_section = ".uninit.latched")]
static mut LATCHED: MaybeUninit<[u32; 3]> = MaybeUninit::uninit();

/// Mark that [`KEPT`] and [`LATCHED`] were written by this firmware: power-on leaves anything there.
const MARK: u32 = 0x7041_5553;

/// Opens the brakes of a board that has some, or lets them close.
#[inline(always)]
pub fn release_brake<B: Board>(open: bool) {
    if let Some(pin) = B::BRAKE {
        pin.write(open);
    }
}

/// Why the board restarted last time, and where; clears it.
pub fn take() -> (Reason, u32) {
    let kept = &raw mut KEPT;
    // SAFETY: called once, from `init`, with interrupts off; any bit pattern is a valid [u32; 4].
    let [mark, reason, place, check] = unsafe { kept.cast::<[u32; 4]>().read_volatile() };
    // SAFETY: as above.
    unsafe { kept.cast::<[u32; 4]>().write_volatile([0; 4]) };
    if mark != MARK || check != mark ^ reason ^ place {
        return (Reason::None, 0);
    }
    let reason = match reason {
        1 => Reason::Panic,
        2 => Reason::HardFault,
        3 => Reason::Unexpected,
        4 => Reason::Setup,
        5 => Reason::Stack,
        6 => Reason::Requested,
        _ => Reason::None,
    };
    (reason, place)
}

/// The fault that was latched when the board restarted. After power-on there is none.
pub fn latched() -> SafetyReason {
    let kept = &raw const LATCHED;
    // SAFETY: any bit pattern is a valid [u32; 3]; the words are written in the tick's task alone, and read before it runs.
    let [mark, code, check] = unsafe { kept.cast::<[u32; 3]>().read_volatile() };
    if mark != MARK || check != mark ^ code {
        return SafetyReason::None;
    }
    SafetyReason::from_code(code as u8)
}

/// Keeps the fault that is latched over a reset.
pub fn keep_latched(fault: SafetyReason) {
    let kept = &raw mut LATCHED;
    let code = u32::from(fault.code());
    // SAFETY: called from the tick's task alone.
    unsafe {
        kept.cast::<[u32; 3]>()
            .write_volatile([MARK, code, MARK ^ code])
    };
}

/// Why the board started, for the link: what was kept, else the flags of the chip (RM0090 7.3.21); clears both.
///
/// The emulator's chip has no such flags.
pub fn reset_reason(kept: Reason, rcc: &RCC) -> ResetReason {
    let chip = rcc.csr().read();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    match kept {
        Reason::Panic | Reason::Setup => ResetReason::Panic,
        Reason::HardFault | Reason::Unexpected | Reason::Stack => ResetReason::Fault,
        Reason::Requested => ResetReason::Software,
        // A supply that broke down: the RAM may hold anything, as after power-on.
        Reason::None if chip.porrstf().bit_is_set() || chip.borrstf().bit_is_set() => {
            ResetReason::PowerOn
        }
        Reason::None if chip.wdgrstf().bit_is_set() || chip.wwdgrstf().bit_is_set() => {
            ResetReason::Watchdog
        }
        Reason::None if chip.sftrstf().bit_is_set() => ResetReason::Software,
        // Every reset also pulls the pin, so its flag means something only when it stands alone.
        Reason::None if chip.padrstf().bit_is_set() => ResetReason::Pin,
        Reason::None => ResetReason::Unknown,
    }
}

/// Makes the outputs safe, keeps the reason and restarts. The torque stays off until the host arms the board again.
pub fn leave<B: Board>(reason: Reason, place: u32) -> ! {
    cortex_m::interrupt::disable();
    // The constructor is what switches off; an infallible pin cannot refuse.
    let _ = TorqueEnable::new(EnablePin::<B>::default());
    release_brake::<B>(false);
    let kept = &raw mut KEPT;
    // SAFETY: interrupts are off and this does not return: nothing reads the words before the reset.
    unsafe {
        let check = MARK ^ reason as u32 ^ place;
        kept.cast::<[u32; 4]>()
            .write_volatile([MARK, reason as u32, place, check])
    };
    compiler_fence(Ordering::SeqCst);
    SCB::sys_reset()
}

/// Bytes that the core pushes at most when an exception comes: eight registers and the state of the FPU.
const FRAME_BYTES: u32 = 104;

/// The end of [`fault_handlers!`]'s entry of the hard fault.
///
/// * `pointer` stack pointer after the exception came
/// * `place` address of the interrupted instruction
pub extern "C" fn hard_fault<B: Board>(pointer: u32, place: u32) -> ! {
    unsafe extern "C" {
        static _stack_end: u8;
        static _stack_start: u8;
    }
    // An overflowing stack faults where it leaves the region, and the core cannot push below that either.
    let end = (&raw const _stack_end) as u32;
    let start = (&raw const _stack_start) as u32;
    if !(end + FRAME_BYTES..start).contains(&pointer) {
        leave::<B>(Reason::Stack, 0);
    }
    leave::<B>(Reason::HardFault, place)
}

/// The handlers of panic, hard fault and unexpected exception in the firmware of a board: they all [`leave`].
#[macro_export]
macro_rules! fault_handlers {
    ($board:ty) => {
        #[panic_handler]
        fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
            $crate::fault::leave::<$board>(
                $crate::fault::Reason::Panic,
                info.location().map_or(0, |place| place.line()),
            )
        }

        /// The entry of the hard fault. It pushes nothing before it has a stack again, because the stack may be what
        /// failed: passes the stack pointer on, and starts the stack over, for nothing returns from here.
        // SAFETY: the name is that of the vector, and no other handler has it.
        #[unsafe(naked)]
        #[unsafe(export_name = "HardFault")]
        extern "C" fn hard_fault_entry() -> ! {
            core::arch::naked_asm!(
                "mov r0, sp",
                // The interrupted instruction: word 6 of what the core pushed, if that is inside the region of the stack.
                "ldr r2, =_stack_end",
                "movs r1, #0",
                "ldr r3, =_stack_start",
                "cmp r0, r2",
                "blo 1f",
                "cmp r0, r3",
                "bhs 1f",
                "ldr r1, [r0, #24]",
                "1:",
                "mov sp, r3",
                "b {handler}",
                handler = sym $crate::fault::hard_fault::<$board>,
            )
        }

        #[cortex_m_rt::exception]
        unsafe fn DefaultHandler(number: i16) {
            $crate::fault::leave::<$board>($crate::fault::Reason::Unexpected, number as u32)
        }
    };
}
