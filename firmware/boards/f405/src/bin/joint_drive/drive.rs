//! What this board drives itself: its joint, by a motor stage, and measured by an encoder.

use core::cell::Cell;

use cortex_m::interrupt::{self, Mutex};
use foretorque_link::drive::{JointEncoder, JointStage};
use foretorque_link::hal::{
    AbsoluteEncoder, EncoderError, MotorStage, PwmWithDirection, StageError,
};
use foretorque_link::session::OwnJoint as _;

use crate::board::{self, ENCODER, JOINTS, SCALE, TURN};
use crate::fault::EnablePin;
use crate::pins::{DirectionPin, FaultInput, StageEnable};
use crate::pulse::Pulse;
use crate::rooms::BoardSession;
use crate::spi::EncoderDevice;

/// What is wrong with stage and encoder, for the log, which nobody writes in the tick.
#[derive(Clone, Copy, PartialEq)]
struct Troubles {
    stage: Option<StageError>,
    encoder: Option<EncoderError>,
}

impl Troubles {
    const NONE: Self = Self {
        stage: None,
        encoder: None,
    };
}

static SEEN: Mutex<Cell<Troubles>> = Mutex::new(Cell::new(Troubles::NONE));
static LOGGED: Mutex<Cell<Troubles>> = Mutex::new(Cell::new(Troubles::NONE));

/// Motor stage and encoder of the own joint.
pub(crate) struct Drive {
    stage: JointStage<PwmWithDirection<Pulse, DirectionPin>, StageEnable, FaultInput>,
    encoder: JointEncoder<EncoderDevice>,
}

impl Drive {
    /// Everything off, no torque commanded. `None` if scale or encoder of the board's file cannot work.
    #[inline(never)]
    pub(crate) fn start() -> Option<Self> {
        let joint = board::OWN_JOINT?;
        let output = PwmWithDirection::new(Pulse::start(), DirectionPin);
        let stage = MotorStage::new(output, StageEnable(EnablePin), FaultInput, SCALE);
        let encoder = AbsoluteEncoder::new(EncoderDevice::start(), ENCODER);
        let mut encoder = JointEncoder::new(encoder.ok()?, joint, TURN);
        // The first reading brings nothing, it only asks: so the first tick has a position.
        let _ = encoder.measure::<JOINTS>(None, true);
        Some(Self {
            stage: JointStage::new(stage.ok()?, joint),
            encoder,
        })
    }

    /// Before the ticks of this round: a stage with a fault is off, and the session knows.
    pub(crate) fn watch(&mut self, session: &mut BoardSession) {
        self.stage.watch(session);
    }

    /// What measures the own joint.
    pub(crate) fn own(&mut self) -> &mut JointEncoder<EncoderDevice> {
        &mut self.encoder
    }

    /// After a tick: enable and torque command are what the session says.
    pub(crate) fn follow(&mut self, session: &mut BoardSession) {
        self.stage.follow(session);
        let seen = Troubles {
            stage: self.stage.trouble(),
            encoder: self.encoder.trouble(),
        };
        interrupt::free(|token| SEEN.borrow(token).set(seen));
    }

    /// Writes to the log what has changed; from the idle loop.
    pub(crate) fn report() {
        let (seen, logged) = interrupt::free(|token| {
            let seen = SEEN.borrow(token).get();
            (seen, LOGGED.borrow(token).replace(seen))
        });
        if let Some(error) = seen.stage.filter(|_| seen.stage != logged.stage) {
            defmt::error!("stage: {=str}", error.text());
        }
        match seen.encoder {
            error if error == logged.encoder => {}
            Some(error) => defmt::warn!("encoder: {=str}", error.text()),
            None => defmt::info!("encoder: a position"),
        }
    }
}
