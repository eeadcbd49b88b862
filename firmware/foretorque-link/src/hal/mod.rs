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

    /// Lets torque through. Errors: those of the pin; torque then counts as before.
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
pub(crate) mod tests {
    use super::*;
    use embedded_hal::digital::{ErrorKind, ErrorType, PinState};
    use std::cell::RefCell;
    use std::rc::Rc;

    /// State of the pins and of the output of a motor stage, each of which can fail.
    #[derive(Default)]
    pub(crate) struct Bench {
        pub(crate) enabled: bool,
        /// Times the enable was switched on.
        pub(crate) times_on: u32,
        pub(crate) enable_fails: bool,
        pub(crate) fault: bool,
        pub(crate) fault_fails: bool,
        /// Commands, with those that failed.
        pub(crate) levels: Vec<f32>,
        pub(crate) output_fails: bool,
    }

    /// Every pin and the output of a motor stage.
    #[derive(Clone, Default)]
    pub(crate) struct Pins(pub(crate) Rc<RefCell<Bench>>);

    impl ErrorType for Pins {
        type Error = ErrorKind;
    }

    impl OutputPin for Pins {
        fn set_low(&mut self) -> Result<(), ErrorKind> {
            self.set_state(PinState::Low)
        }

        fn set_high(&mut self) -> Result<(), ErrorKind> {
            self.set_state(PinState::High)
        }

        fn set_state(&mut self, state: PinState) -> Result<(), ErrorKind> {
            let mut bench = self.0.borrow_mut();
            if bench.enable_fails {
                return Err(ErrorKind::Other);
            }
            bench.enabled = state == PinState::High;
            bench.times_on += u32::from(bench.enabled);
            Ok(())
        }
    }

    impl InputPin for Pins {
        fn is_high(&mut self) -> Result<bool, ErrorKind> {
            self.is_low().map(|low| !low)
        }

        fn is_low(&mut self) -> Result<bool, ErrorKind> {
            let bench = self.0.borrow();
            if bench.fault_fails {
                return Err(ErrorKind::Other);
            }
            Ok(bench.fault)
        }
    }

    impl TorqueOutput for Pins {
        fn command(&mut self, level: f32) -> Result<(), OutputError> {
            let mut bench = self.0.borrow_mut();
            bench.levels.push(level);
            if bench.output_fails {
                return Err(FAILED);
            }
            Ok(())
        }
    }

    type Stage = MotorStage<Pins, Pins, Pins>;

    const SCALE: TorqueScale = TorqueScale {
        gain_nm_per_a: 10.0,
        full_scale_a: 20.0,
        limit_nm: 150.0,
    };
    const FAILED: OutputError = OutputError::Bus(embedded_hal::spi::ErrorKind::Other);

    /// A new stage on pins whose enable was on, and their state.
    fn new(scale: TorqueScale) -> (Result<Stage, StageError>, Rc<RefCell<Bench>>) {
        let pins = Pins::default();
        pins.0.borrow_mut().enabled = true;
        let stage = MotorStage::new(pins.clone(), pins.clone(), pins.clone(), scale);
        assert!(!pins.0.borrow().enabled, "off after construction");
        (stage, pins.0)
    }

    fn enabled(scale: TorqueScale) -> (Stage, Rc<RefCell<Bench>>) {
        let (stage, bench) = new(scale);
        let mut stage = stage.unwrap();
        stage.enable().unwrap();
        assert!(stage.is_enabled() && bench.borrow().enabled);
        assert_eq!(bench.borrow().levels, [0.0, 0.0]);
        (stage, bench)
    }

    #[test]
    fn a_pin_that_stays_counts_as_what_it_is() {
        let pins = Pins::default();
        let mut enable = TorqueEnable::new(pins.clone()).unwrap();
        for on in [false, true] {
            pins.0.borrow_mut().enable_fails = true;
            assert!(enable.on().is_err() && enable.off().is_err());
            assert_eq!(enable.is_on(), on);
            pins.0.borrow_mut().enable_fails = false;
            enable.on().unwrap();
        }
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
            let (mut stage, bench) = enabled(scale);
            stage.drive(wanted).unwrap();
            let given = bench.borrow().levels[2];
            assert!((given - level).abs() < 1e-6, "{wanted}: {given}");
        }
    }

    #[test]
    fn nothing_is_put_out_while_disabled() {
        let (mut stage, bench) = enabled(SCALE);
        stage.disable().unwrap();
        assert!(!stage.is_enabled() && !bench.borrow().enabled);
        assert_eq!(stage.drive(10.0), Err(StageError::Disabled));
        assert_eq!(bench.borrow().levels, [0.0; 3]);
    }

    #[test]
    fn errors_switch_the_enable_off_and_prevent_that_it_is_switched_on() {
        type Change = fn(&mut Bench);
        let output = StageError::Output(FAILED);
        let cases: [(Change, f32, StageError); 5] = [
            (|bench| bench.output_fails = true, 10.0, output),
            (|bench| bench.fault = true, 10.0, StageError::Fault),
            (
                |bench| bench.fault_fails = true,
                10.0,
                StageError::FaultInput,
            ),
            (|_| {}, f32::NAN, StageError::NotFinite),
            (|_| {}, f32::INFINITY, StageError::NotFinite),
        ];
        for (change, wanted, error) in cases {
            let (mut stage, bench) = enabled(SCALE);
            change(&mut bench.borrow_mut());
            assert_eq!(stage.drive(wanted), Err(error));
            assert!(!stage.is_enabled() && !bench.borrow().enabled);
            assert_eq!(bench.borrow().levels.last(), Some(&0.0), "{error}");
            assert_eq!(stage.drive(1.0), Err(StageError::Disabled));
            if error != StageError::NotFinite {
                assert_eq!(stage.enable(), Err(error));
                assert!(!stage.is_enabled() && !bench.borrow().enabled);
            }
            assert_eq!(bench.borrow().times_on, 1, "not for a moment: {error}");
        }
    }

    #[test]
    fn an_enable_that_stays_on_is_reported_and_tried_again() {
        let (mut stage, bench) = enabled(SCALE);
        bench.borrow_mut().fault = true;
        for (fails, error) in [(true, StageError::Enable), (false, StageError::Fault)] {
            bench.borrow_mut().enable_fails = fails;
            assert_eq!(stage.drive(1.0), Err(error));
            assert_eq!((stage.is_enabled(), bench.borrow().enabled), (fails, fails));
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
            let scale = TorqueScale {
                gain_nm_per_a,
                full_scale_a,
                limit_nm,
            };
            let (refused, bench) = new(scale);
            assert_eq!(refused.map(drop), Err(StageError::Scale), "{scale:?}");
            assert_eq!(bench.borrow().levels, []);
        }
    }
}
