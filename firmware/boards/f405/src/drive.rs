//! The drive of a board that drives nothing itself but the enable. A board with a motor stage and an encoder has one of
//! its own, as [`crate::pyboard_drive`] has.

use foretorque_link::hal::TorqueEnable;
use foretorque_link::session::NoLocalSensor;

use crate::arm::BoardSession;
use crate::board::{Board, Drive};
use crate::clock::Clocks;
use crate::fault::EnablePin;

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
    measures: NoLocalSensor,
}

impl<B: Board> Drive for EnableOnly<B> {
    type Own = NoLocalSensor;

    #[inline(always)]
    fn start(_: &Clocks) -> Option<Self> {
        // Switched off by its constructor; only a session that a host has armed switches it on.
        let Ok(enable) = TorqueEnable::new(EnablePin::default());
        Some(Self {
            enable,
            measures: NoLocalSensor,
        })
    }

    #[inline(always)]
    fn watch(&mut self, _: &mut BoardSession) {}

    #[inline(always)]
    fn own(&mut self) -> &mut NoLocalSensor {
        &mut self.measures
    }

    #[inline(always)]
    fn follow(&mut self, session: &mut BoardSession) {
        switch(&mut self.enable, session.torque_enabled());
    }

    #[inline(always)]
    fn report() {}
}
