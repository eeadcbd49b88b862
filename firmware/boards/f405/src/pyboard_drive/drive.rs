//! The board's own joint: a motor stage drives it, an encoder measures it.

use core::cell::Cell;

use cortex_m::interrupt::{self, Mutex};
use foretorque_link::drive::{JointEncoder, JointStage};
use foretorque_link::hal::{
    AbsoluteEncoder, EncoderError, MotorStage, PwmWithDirection, StageError,
};
use foretorque_link::session::LocalSensor;

use super::pins::{DirectionPin, FaultInput, StageEnable};
use super::pulse::Pulse;
use super::spi::EncoderDevice;
use super::{ENCODER, JOINT, SCALE, TURN};
use crate::arm::{BoardSession, JOINTS};
use crate::board::Drive;
use crate::clock::Clocks;

/// Errors of stage and encoder, for the log, which the tick does not write.
#[derive(Clone, Copy, PartialEq)]
struct Faults {
    stage: Option<StageError>,
    encoder: Option<EncoderError>,
}

impl Faults {
    const NONE: Self = Self {
        stage: None,
        encoder: None,
    };
}

static SEEN: Mutex<Cell<Faults>> = Mutex::new(Cell::new(Faults::NONE));
static LOGGED: Mutex<Cell<Faults>> = Mutex::new(Cell::new(Faults::NONE));

/// Motor stage and encoder of the own joint.
pub struct StageAndEncoder {
    stage: JointStage<PwmWithDirection<Pulse, DirectionPin>, StageEnable, FaultInput>,
    encoder: JointEncoder<EncoderDevice>,
}

impl Drive for StageAndEncoder {
    type Own = JointEncoder<EncoderDevice>;

    #[inline(never)]
    fn start(_: &Clocks) -> Option<Self> {
        let output = PwmWithDirection::new(Pulse::start(), DirectionPin);
        let stage = MotorStage::new(output, StageEnable, FaultInput, SCALE);
        let encoder = AbsoluteEncoder::new(EncoderDevice::start(), ENCODER);
        let mut encoder = JointEncoder::new(encoder.ok()?, JOINT, TURN);
        // The first frame only requests a reading, so that the first tick has a position.
        let _ = LocalSensor::<JOINTS>::measure(&mut encoder, &mut None, true);
        Some(Self {
            stage: JointStage::new(stage.ok()?, JOINT),
            encoder,
        })
    }

    fn watch(&mut self, session: &mut BoardSession) {
        self.stage.check(session);
    }

    fn own(&mut self) -> &mut Self::Own {
        &mut self.encoder
    }

    fn follow(&mut self, session: &mut BoardSession) {
        self.stage.apply(session);
        let seen = Faults {
            stage: self.stage.last_error(),
            encoder: self.encoder.last_error(),
        };
        interrupt::free(|token| SEEN.borrow(token).set(seen));
    }

    fn report() {
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
