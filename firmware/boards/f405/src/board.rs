//! Properties of a board with this chip, its pins by number, and the drive of a board that drives nothing itself but the
//! enable. A board with a motor stage and an encoder has one of its own, as [`crate::pyboard_drive`] has.

use core::marker::PhantomData;

use embedded_hal::digital::{ErrorType, OutputPin};
use foretorque::joint::JointSample;
use foretorque_link::hal::TorqueEnable;
use foretorque_link::safety::SafetyReason;
use foretorque_link::session::LocalSensor;
use stm32f4xx_hal::gpio::{PA2, PA3};
use stm32f4xx_hal::pac::{GPIOA, GPIOB, GPIOC};
use stm32f4xx_hal::rcc::Rcc;

use crate::arm::{BoardSession, JOINTS};
use crate::clock::Clocks;

/// A board: constants, pins, and the drive of its joint.
pub trait Board: Send + 'static {
    /// Name in the log.
    const NAME: &'static str;
    /// Crystal, Hz (DS8626 5.3.9: 4 to 26 MHz).
    const CRYSTAL_HZ: u32;
    /// Torque enable of the motor stage, active high; the fault handlers write it without the owner of its pins.
    const ENABLE: Pin;
    /// Release of the brakes, active high; `None` where the board has none.
    const BRAKE: Option<Pin> = None;
    /// The only joint that this board drives, from 0, and so the only one whose rows it learns from; `None` for all. The
    /// torques of all joints are computed either way: the recursion passes through all of them.
    const OWN_JOINT: Option<usize> = None;

    /// Motor stage and encoder, or the enable alone.
    type Drive: Drive;

    /// Gives every pin its job; enable and brake release are low.
    fn start_pins(ports: Ports, rcc: &mut Rcc);
}

/// Hardware that the board drives itself, and the sensor of its own joint; called by the tick's task.
pub trait Drive: LocalSensor<JOINTS> + Sized + Send {
    /// Everything off, no torque commanded. `None` if a constant of the board cannot work.
    fn start(clocks: &Clocks) -> Option<Self>;

    /// Shortest period that the drives follow, µs.
    fn shortest_period_us(&self) -> u32 {
        0
    }

    /// Lowers the torque limits of the session to those of the drives; once, before it has parameters.
    fn limit(&self, _: &mut BoardSession) {}

    /// Take the reports of drives on a bus, and pass faults of stage and encoder to the session; before each tick.
    fn watch(&mut self, session: &mut BoardSession);

    /// After a tick: enable and torque command follow the session.
    fn follow(&mut self, session: &mut BoardSession);

    /// Writes to the log what has changed; from the idle loop.
    fn report();
}

/// The ports whose pins the boards use.
pub struct Ports {
    /// Port A.
    pub a: GPIOA,
    /// Port B.
    pub b: GPIOB,
    /// Port C.
    pub c: GPIOC,
}

/// Gives both pins of the link to USART2: transmitter and receiver, alternate function 7 (DS8626 table 9).
pub fn start_link(transmitter: PA2, receiver: PA3) {
    transmitter.into_alternate::<7>();
    // Held high while nothing is plugged in: an open line is full of start bits.
    receiver.into_alternate::<7>().internal_pull_up(true);
}

/// One pin, by its number of 0 to 15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pin {
    /// Of port A.
    A(u8),
    /// Of port B.
    B(u8),
}

impl Pin {
    /// Drives the pin high or low.
    #[inline(always)]
    pub fn write(self, high: bool) {
        let (Self::A(number) | Self::B(number)) = self;
        let bits = 1 << if high { number } else { number + 16 };
        // SAFETY: BSRR is write-only and changes the named bit in one access (RM0090 8.4.7); no other code drives it.
        unsafe {
            match self {
                Self::A(_) => (*GPIOA::ptr()).bsrr().write(|w| w.bits(bits)),
                Self::B(_) => (*GPIOB::ptr()).bsrr().write(|w| w.bits(bits)),
            }
        };
    }

    /// Level of the pin.
    #[inline(always)]
    pub fn is_high(self) -> bool {
        // SAFETY: a read of the input register, which has no side effect.
        let (levels, number) = unsafe {
            match self {
                Self::A(number) => ((*GPIOA::ptr()).idr().read().bits(), number),
                Self::B(number) => ((*GPIOB::ptr()).idr().read().bits(), number),
            }
        };
        levels & 1 << number != 0
    }
}

/// Torque enable: a pin without state, because a fault handler must be able to make one out of nothing.
pub struct EnablePin<B>(PhantomData<B>);

impl<B> Default for EnablePin<B> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<B> ErrorType for EnablePin<B> {
    type Error = core::convert::Infallible;
}

impl<B: Board> OutputPin for EnablePin<B> {
    fn set_low(&mut self) -> Result<(), Self::Error> {
        B::ENABLE.write(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Self::Error> {
        B::ENABLE.write(true);
        Ok(())
    }
}

/// Switches the enable pin where it differs from `on`.
#[inline(always)]
pub(crate) fn switch<B: Board>(enable: &mut TorqueEnable<EnablePin<B>>, on: bool) {
    if enable.is_on() != on {
        // This pin cannot refuse.
        let Ok(()) = if on { enable.on() } else { enable.off() };
    }
}

/// The enable pin; torque is put out by whoever reads the replies, and measured there.
pub struct EnableOnly<B: Board> {
    enable: TorqueEnable<EnablePin<B>>,
}

impl<B: Board> LocalSensor<JOINTS> for EnableOnly<B> {
    #[inline(always)]
    fn measure(&mut self, _: &mut Option<JointSample<JOINTS>>, _: bool) -> SafetyReason {
        SafetyReason::None
    }
}

impl<B: Board> Drive for EnableOnly<B> {
    #[inline(always)]
    fn start(_: &Clocks) -> Option<Self> {
        // Switched off by its constructor; only a session that a host has armed switches it on.
        let Ok(enable) = TorqueEnable::new(EnablePin::default());
        Some(Self { enable })
    }

    #[inline(always)]
    fn watch(&mut self, _: &mut BoardSession) {}

    #[inline(always)]
    fn follow(&mut self, session: &mut BoardSession) {
        switch(&mut self.enable, session.torque_enabled());
    }

    #[inline(always)]
    fn report() {}
}
