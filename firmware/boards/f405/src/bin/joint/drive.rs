//! What this board drives itself: nothing but the enable. A board with a motor stage and an encoder has another file in
//! the place of this one, as `joint-drive` has.

use foretorque_link::hal::TorqueEnable;
use foretorque_link::session::HostMeasures;

use crate::fault::EnablePin;
use crate::rooms::BoardSession;

/// The enable pin; torque is put out by whoever reads the replies, and measured there.
pub(crate) struct Drive {
    enable: TorqueEnable<EnablePin>,
    measures: HostMeasures,
}

impl Drive {
    /// Everything off. Cannot fail here.
    #[inline(always)]
    pub(crate) fn start() -> Option<Self> {
        // Switched off by its constructor; only a session that a host has armed switches it on.
        let Ok(enable) = TorqueEnable::new(EnablePin);
        Some(Self {
            enable,
            measures: HostMeasures,
        })
    }

    /// Before the ticks of this round: tells the session what is wrong out there.
    #[inline(always)]
    pub(crate) fn watch(&mut self, _: &mut BoardSession) {}

    /// What measures the own joint.
    #[inline(always)]
    pub(crate) fn own(&mut self) -> &mut HostMeasures {
        &mut self.measures
    }

    /// After a tick: brings the enable pin to where it shall be.
    #[inline(always)]
    pub(crate) fn follow(&mut self, session: &mut BoardSession) {
        let on = session.torque_enabled();
        if self.enable.is_on() != on {
            // This pin cannot refuse.
            let Ok(()) = if on {
                self.enable.on()
            } else {
                self.enable.off()
            };
        }
    }

    /// Writes to the log what has changed; from the idle loop.
    #[inline(always)]
    pub(crate) fn report() {}
}
