//! Hardware adapters, generic over embedded-hal 1.0: encoder, torque output and enable pin of a joint.
//!
//! ```text
//! encoder (SPI) ──► q                      tau ──► MotorStage ──► TorqueOutput: PWM and direction, or SPI DAC
//!                                                     │  ▲
//!                                       enable output ┘  └ fault input
//! ```
//! Every call is bounded: at most three bus transfers and a few pin accesses, without loops.

mod encoder;
mod output;

use embedded_hal::digital::{InputPin, OutputPin};
#[cfg(test)]
pub(crate) use encoder::tests::Chip;
pub use encoder::{AbsoluteEncoder, Direction, EncoderConfig, EncoderError};
use foretorque::limits::cut;
pub use output::{DacModel, OutputError, PwmWithDirection, SpiDac, TorqueOutput};

/// The torque enable input of a motor stage, active high. Off after construction.
///
/// ```
/// # use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
/// # let pin = Mock::new(&[Transaction::set(State::Low), Transaction::set(State::High), Transaction::set(State::Low)]);
/// let mut enable = foretorque_link::hal::TorqueEnable::new(pin)?;
/// enable.on()?;
/// assert!(enable.is_on());
/// enable.off()?;
/// # enable.release().done();
/// # Ok::<(), embedded_hal_mock::eh1::MockError>(())
/// ```
#[derive(Debug)]
pub struct TorqueEnable<Pin> {
    pin: Pin,
    on: bool,
}

impl<Pin: OutputPin> TorqueEnable<Pin> {
    /// Takes the pin and switches torque off.
    ///
    /// Errors: those of the pin; it is then in an unknown state.
    pub fn new(mut pin: Pin) -> Result<Self, Pin::Error> {
        pin.set_low()?;
        Ok(Self { pin, on: false })
    }

    /// Lets torque through. Errors: those of the pin; torque then counts as off.
    pub fn on(&mut self) -> Result<(), Pin::Error> {
        self.pin.set_high()?;
        self.on = true;
        Ok(())
    }

    /// Switches torque off. Errors: those of the pin; torque then counts as on, so that the caller tries again.
    pub fn off(&mut self) -> Result<(), Pin::Error> {
        self.pin.set_low()?;
        self.on = false;
        Ok(())
    }

    /// Torque may flow.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Gives the pin back, as it is.
    pub fn release(self) -> Pin {
        self.pin
    }
}

/// Scale from torque to the command of the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueScale {
    /// Drive gain κ: link-side torque per motor current, N·m/A (torque constant × gear ratio × efficiency). Negative where
    /// a positive current turns the joint backwards.
    pub gain_nm_per_a: f32,
    /// Motor current at the largest command, A.
    pub full_scale_a: f32,
    /// Largest torque that is put out, N·m.
    pub limit_nm: f32,
}

impl TorqueScale {
    /// All three are valid, and the limit lies within the full scale.
    pub const fn usable(&self) -> bool {
        let full_scale_nm = self.gain_nm_per_a.abs() * self.full_scale_a;
        full_scale_nm.is_finite() && self.limit_nm > 0.0 && self.limit_nm <= full_scale_nm
    }
}

described_errors! {
    /// Reason why no torque is put out.
    pub enum StageError {
        /// (A value that is not positive, or a limit beyond the stage's full scale.)
        Scale = "gain, full scale and limit of the stage do not fit";
        Disabled = "the motor stage is switched off";
        Fault = "the motor stage reports a fault";
        /// (That counts as a fault.)
        FaultInput = "the fault input cannot be read";
        NotFinite = "the torque is not finite";
        Output(error: OutputError) = "the torque command failed", ": {error}";
        /// (Cut the supply.)
        Enable = "the enable output does not switch off; torque may still flow";
    }
}

/// A motor stage: torque command, enable output, fault input (active low, as an open drain pulls it).
///
/// Current = τ / κ, level = current / full scale. Torque is put out only while the stage is enabled and reports no fault.
/// Any error in [`drive`](Self::drive) switches the enable off first; only [`enable`](Self::enable) switches it on.
#[derive(Debug)]
pub struct MotorStage<Output, Enable, Fault> {
    output: Output,
    enable: TorqueEnable<Enable>,
    fault: Fault,
    scale: TorqueScale,
    level_per_nm: f32,
}

impl<Output, Enable, Fault> MotorStage<Output, Enable, Fault>
where
    Output: TorqueOutput,
    Enable: OutputPin,
    Fault: InputPin,
{
    /// A stage that is switched off, with the command at zero.
    ///
    /// Errors: [`StageError::Scale`], [`StageError::Enable`], [`StageError::Output`].
    pub fn new(
        output: Output,
        enable: Enable,
        fault: Fault,
        scale: TorqueScale,
    ) -> Result<Self, StageError> {
        let enable = TorqueEnable::new(enable).map_err(|_| StageError::Enable)?;
        if !scale.usable() {
            return Err(StageError::Scale);
        }
        let mut stage = Self {
            output,
            enable,
            fault,
            scale,
            level_per_nm: 1.0 / (scale.gain_nm_per_a * scale.full_scale_a),
        };
        stage.output.command(0.0).map_err(StageError::Output)?;
        Ok(stage)
    }

    /// Switches the stage on, with the command at zero.
    ///
    /// Errors: any but `Scale`, `Disabled` and `NotFinite`; the stage is then off, except for [`StageError::Enable`].
    pub fn enable(&mut self) -> Result<(), StageError> {
        let ready = self.healthy();
        let zeroed = ready.and_then(|()| self.output.command(0.0).map_err(StageError::Output));
        if let Err(error) = zeroed {
            return Err(self.trip(error));
        }
        if self.enable.on().is_err() {
            return Err(self.trip(StageError::Enable));
        }
        Ok(())
    }

    /// Switches the stage off, then brings the command to zero.
    ///
    /// Errors: [`StageError::Enable`], and torque may still flow; [`StageError::Output`], and none does.
    pub fn disable(&mut self) -> Result<(), StageError> {
        let switched = self.enable.off().map_err(|_| StageError::Enable);
        let zeroed = self.output.command(0.0).map_err(StageError::Output);
        switched.and(zeroed)
    }

    /// Switches the stage off if it reports a fault.
    ///
    /// Errors: [`StageError::Fault`], [`StageError::FaultInput`]; [`StageError::Enable`], and torque may still flow.
    pub fn check(&mut self) -> Result<(), StageError> {
        match self.healthy() {
            Err(error) if self.enable.is_on() => Err(self.trip(error)),
            seen => seen,
        }
    }

    /// Torque may flow.
    pub fn is_enabled(&self) -> bool {
        self.enable.is_on()
    }

    /// Puts out `tau_nm`, N·m, positive accelerates +q; cut to the limit of the scale.
    ///
    /// Errors: all but [`StageError::Disabled`] have switched the stage off; with [`StageError::Enable`] this failed too.
    ///
    /// Cost: one read of a pin, one command.
    pub fn drive(&mut self, tau_nm: f32) -> Result<(), StageError> {
        if !self.enable.is_on() {
            return Err(StageError::Disabled);
        }
        let done = self.put_out(tau_nm);
        done.map_err(|error| self.trip(error))
    }

    /// Gives output, enable pin and fault pin back, as they are.
    pub fn release(self) -> (Output, Enable, Fault) {
        (self.output, self.enable.release(), self.fault)
    }

    fn put_out(&mut self, tau_nm: f32) -> Result<(), StageError> {
        self.healthy()?;
        if !tau_nm.is_finite() {
            return Err(StageError::NotFinite);
        }
        let (bounded, _) = cut(tau_nm, self.scale.limit_nm);
        let level = bounded * self.level_per_nm;
        self.output.command(level).map_err(StageError::Output)
    }

    fn healthy(&mut self) -> Result<(), StageError> {
        match self.fault.is_high() {
            Ok(true) => Ok(()),
            Ok(false) => Err(StageError::Fault),
            Err(_) => Err(StageError::FaultInput),
        }
    }

    /// Switches off; returns the reason, or [`StageError::Enable`] where that failed.
    fn trip(&mut self, reason: StageError) -> StageError {
        match self.disable() {
            Err(StageError::Enable) => StageError::Enable,
            _ => reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::spi::ErrorKind;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};

    const SCALE: TorqueScale = TorqueScale {
        gain_nm_per_a: 10.0,
        full_scale_a: 20.0,
        limit_nm: 150.0,
    };
    const FAILED: OutputError = OutputError::Bus(ErrorKind::Other);

    /// Records the commands; the one at `fails` fails.
    #[derive(Default)]
    struct Recorder {
        levels: Vec<f32>,
        fails: Option<usize>,
    }

    impl TorqueOutput for Recorder {
        fn command(&mut self, level: f32) -> Result<(), OutputError> {
            self.levels.push(level);
            if self.fails == Some(self.levels.len() - 1) {
                return Err(FAILED);
            }
            Ok(())
        }
    }

    fn low() -> Transaction {
        Transaction::set(State::Low)
    }

    fn high() -> Transaction {
        Transaction::set(State::High)
    }

    fn fault(present: bool) -> Transaction {
        Transaction::get(if present { State::Low } else { State::High })
    }

    fn broken(transaction: Transaction) -> Transaction {
        transaction.with_error(MockError::Io(std::io::ErrorKind::BrokenPipe))
    }

    #[test]
    fn a_pin_that_stays_counts_as_what_it_is() {
        for (sets, on) in [
            (vec![low(), high(), broken(low())], true),
            (vec![low(), broken(high())], false),
        ] {
            let mut enable = TorqueEnable::new(Mock::new(&sets)).unwrap();
            assert_eq!(enable.on().is_ok(), on);
            assert!(!on || enable.off().is_err());
            assert_eq!(enable.is_on(), on);
            enable.release().done();
        }
    }

    /// A stage whose pins expect exactly these transactions.
    fn stage(
        scale: TorqueScale,
        fails: Option<usize>,
        enables: &[Transaction],
        faults: &[Transaction],
    ) -> MotorStage<Recorder, Mock, Mock> {
        let levels = Vec::new();
        let recorder = Recorder { levels, fails };
        MotorStage::new(recorder, Mock::new(enables), Mock::new(faults), scale).unwrap()
    }

    fn levels(stage: MotorStage<Recorder, Mock, Mock>) -> Vec<f32> {
        let (output, mut enable, mut fault) = stage.release();
        enable.done();
        fault.done();
        output.levels
    }

    #[test]
    fn torque_is_scaled_and_limited() {
        for (gain, wanted, level) in [
            (10.0, 50.0, 0.25),
            (-10.0, 50.0, -0.25),
            (10.0, -150.0, -0.75),
            (10.0, 150.1, 0.75),
            (10.0, -1e9, -0.75),
        ] {
            let mut scale = SCALE;
            scale.gain_nm_per_a = gain;
            let mut stage = stage(scale, None, &[low(), high()], &[fault(false), fault(false)]);
            stage.enable().unwrap();
            stage.drive(wanted).unwrap();
            let levels = levels(stage);
            assert_eq!(levels[..2], [0.0, 0.0]);
            assert!((levels[2] - level).abs() < 1e-6, "{wanted}: {}", levels[2]);
        }
    }

    #[test]
    fn nothing_is_put_out_while_disabled() {
        let mut stage = stage(SCALE, None, &[low(), high(), low()], &[fault(false)]);
        assert_eq!(stage.drive(10.0), Err(StageError::Disabled));
        stage.enable().unwrap();
        assert!(stage.is_enabled());
        stage.disable().unwrap();
        assert_eq!(stage.drive(10.0), Err(StageError::Disabled));
        assert_eq!(levels(stage), [0.0; 3]);
    }

    #[test]
    fn errors_switch_the_enable_off() {
        let cases = [
            (Some(2), fault(false), 10.0, StageError::Output(FAILED)),
            (None, fault(true), 10.0, StageError::Fault),
            (None, broken(fault(false)), 10.0, StageError::FaultInput),
            (None, fault(false), f32::NAN, StageError::NotFinite),
            (None, fault(false), f32::INFINITY, StageError::NotFinite),
        ];
        for (fails, seen, wanted, error) in cases {
            let mut stage = stage(SCALE, fails, &[low(), high(), low()], &[fault(false), seen]);
            stage.enable().unwrap();
            assert_eq!(stage.drive(wanted), Err(error));
            assert!(!stage.is_enabled());
            assert_eq!(stage.drive(1.0), Err(StageError::Disabled));
            assert_eq!(levels(stage).last(), Some(&0.0), "{error}");
        }
    }

    #[test]
    fn an_enable_that_stays_on_is_reported_and_tried_again() {
        let enables = [low(), high(), broken(low()), low()];
        let faults = [fault(false), fault(true), fault(true)];
        let mut stage = stage(SCALE, None, &enables, &faults);
        stage.enable().unwrap();
        assert_eq!(stage.drive(1.0), Err(StageError::Enable));
        assert!(stage.is_enabled());
        assert_eq!(stage.drive(1.0), Err(StageError::Fault));
        assert!(!stage.is_enabled());
        levels(stage);
    }

    #[test]
    fn a_stage_with_a_fault_or_an_output_that_cannot_be_zeroed_is_not_enabled() {
        for (fails, seen, error) in [
            (None, fault(true), StageError::Fault),
            (Some(1), fault(false), StageError::Output(FAILED)),
        ] {
            let mut stage = stage(SCALE, fails, &[low(), low()], &[seen]);
            assert_eq!(stage.enable(), Err(error));
            assert!(!stage.is_enabled());
            levels(stage);
        }
    }

    #[test]
    fn an_invalid_scale_is_refused_with_the_enable_off() {
        for (gain_nm_per_a, full_scale_a, limit_nm) in [
            (0.0, 20.0, 1.0),
            (10.0, 0.0, 1.0),
            (10.0, 20.0, 0.0),
            (10.0, 20.0, 200.1),
            (f32::NAN, 20.0, 1.0),
            (10.0, f32::INFINITY, 1.0),
            (10.0, 20.0, f32::NAN),
        ] {
            let (mut enable, mut fault) = (Mock::new(&[low()]), Mock::new(&[]));
            let scale = TorqueScale {
                gain_nm_per_a,
                full_scale_a,
                limit_nm,
            };
            let output = Recorder::default();
            let refused = MotorStage::new(output, enable.clone(), fault.clone(), scale);
            assert_eq!(refused.map(drop), Err(StageError::Scale), "{scale:?}");
            enable.done();
            fault.done();
        }
    }
}
