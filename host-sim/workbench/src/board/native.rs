use super::{Described, Transport};
use foretorque::arm::{Arm, ArmModel};
use foretorque::learning::{ConfigError, Learner, LearnerConfig};
use foretorque_link::session::{
    BoardDescription, Housekeeping, LocalSensor, Mailboxes, NoClock, NoLocalSensor, Session,
};
use foretorque_link::wire::FrameBuffer;
use std::collections::VecDeque;
use std::io;
use std::time::Duration;

/// The board in this process: the firmware's own session and learner behind the very same frames.
///
/// The learner takes its learning sample right after each reply, as it does on the board that simulates in bulk.
pub struct Native<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N> = NoLocalSensor> {
    arm: &'static ArmModel<N, P>,
    session: Session<A, N, P>,
    mailboxes: Mailboxes<N, P>,
    housekeeping: Housekeeping<A, N, P>,
    learner: Learner<A, N, P>,
    out: FrameBuffer,
    waiting: VecDeque<u8>,
    sensor: S,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Native<A, N, P> {
    /// A board that has just booted and sent its hello.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn new() -> Result<Self, ConfigError> {
        Self::described(BoardDescription::plain(NoClock), NoLocalSensor)
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N>> Native<A, N, P, S> {
    /// Session and sensor.
    pub fn parts(&mut self) -> (&mut Session<A, N, P>, &mut S) {
        (&mut self.session, &mut self.sensor)
    }

    /// Lets one period of the timer pass that the description of the board may have, as on silicon beside the samples, whichever
    /// of the two paces the board.
    pub fn timer(&mut self) {
        self.select_arm();
        self.session
            .timer_tick(&mut self.mailboxes, &mut self.out, &mut self.sensor);
        self.flush();
        self.mailboxes.learner.work(&mut self.learner, &NoClock);
    }

    /// A board that has just booted as `board` describes and sent its hello, with a sensor of its own.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn described(board: BoardDescription, sensor: S) -> Result<Self, ConfigError> {
        let session = Session::new(board)?;
        let period_s = session.configuration().period_us as f32 * 1e-6;
        let set = session.feed_forward().state().active;
        let mut native = Self {
            arm: A::model(),
            session,
            mailboxes: Mailboxes::new(),
            housekeeping: Housekeeping::new(None),
            learner: Learner::new(LearnerConfig::for_arm::<A>(period_s), set)?,
            out: FrameBuffer::new(),
            waiting: VecDeque::new(),
            sensor,
        };
        native.session.send_hello(&mut native.out);
        native.flush();
        Ok(native)
    }

    /// The session inside.
    pub fn session(&self) -> &Session<A, N, P> {
        &self.session
    }

    /// The learner inside.
    pub fn learner(&self) -> &Learner<A, N, P> {
        &self.learner
    }

    /// Makes the arm of this board the described arm of this thread.
    fn select_arm(&self) {
        if A::COMPILED.is_none() {
            Described::select(self.arm);
        }
    }

    fn flush(&mut self) {
        self.waiting.extend(self.out.as_bytes());
        self.out.clear();
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N>> Transport
    for Native<A, N, P, S>
{
    fn name(&self) -> String {
        "native".into()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.select_arm();
        for frame in bytes.split_inclusive(|&byte| byte == 0) {
            self.session
                .receive(frame, &mut self.mailboxes, &mut self.out, &mut self.sensor);
            if self.housekeeping.work(&mut self.mailboxes.parameters) {
                self.session
                    .poll_parameters(&mut self.mailboxes, &mut self.out);
            }
            self.flush();
            self.mailboxes.learner.work(&mut self.learner, &NoClock);
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
        let count = buffer.len().min(self.waiting.len());
        for (slot, byte) in buffer.iter_mut().zip(self.waiting.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}
