use super::ExcitationState::{self, *};
use super::path::{JointSeries, Path, PathSpeed, PreparedSeries};
use super::{
    AbortReason, CHECK_POINTS, CHECK_POINTS_A_TICK, ExcitationCommand,
    ExcitationCommand as Command, ExcitationError, ExcitationProgram, MotionBounds, PlayLimits,
    Supervision, check_at_once, check_point, check_start,
};
use foretorque::arm::Arm;
use foretorque::joint::{JointMotion, JointSample, JointVector};

/// Largest desired speed at which the player takes over from the host, rad/s.
const HANDOVER_RAD_S: f32 = 0.02;

/// State of the player from tick to tick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PlayerState<const N: usize> {
    excitation: ExcitationState,
    checked: u32,
    /// A start waits for the check or for a measurement.
    start_waits: bool,
    path: Path<N>,
    /// Position on the path, in units of 2⁻³² of it.
    phase: u32,
    /// Periods begun.
    periods: u16,
    speed: PathSpeed,
    supervision: Supervision<N>,
    /// Desired motion of the last tick, which is measured now.
    last: JointMotion<N>,
}

/// Player of one excitation.
///
/// A stop stays on the path: its speed σ falls from 1 to 0 as a smooth step. Velocity is q′ σ and acceleration
/// q″ σ² + q′ σ̇, so a stop adds at most half of the certified acceleration.
pub struct Player<const N: usize> {
    limits: PlayLimits<N>,
    arm_hash: u32,
    tick_us: u32,
    program: ExcitationProgram<N>,
    series: PreparedSeries,
    state: PlayerState<N>,
}

impl<const N: usize> Player<N> {
    /// A player without an excitation.
    ///
    /// * `tick_us` period of the tick, µs
    pub fn new<A: Arm<N, P>, const P: usize>(tick_us: u32) -> Self {
        Self {
            limits: PlayLimits::for_arm::<A, P>(tick_us),
            arm_hash: A::hash(),
            tick_us,
            program: ExcitationProgram {
                arm_hash: 0,
                period_us: 0,
                periods: 0,
                tracking_rad: 0.0,
                joints: [JointSeries::default(); N],
                certificate: [MotionBounds::default(); N],
            },
            series: PreparedSeries::new(1_000_000, tick_us),
            state: PlayerState {
                excitation: Empty,
                checked: 0,
                start_waits: false,
                path: Path::Series,
                phase: 0,
                periods: 0,
                speed: PathSpeed::NONE,
                supervision: Supervision::default(),
                last: JointMotion::zero(),
            },
        }
    }

    /// State of the excitation.
    pub fn state(&self) -> ExcitationState {
        self.state.excitation
    }

    /// Last desired motion, while the player decides it.
    pub fn desired(&self) -> Option<&JointMotion<N>> {
        self.state().is_active().then_some(&self.state.last)
    }

    /// Loads `program`; its check begins with the next tick.
    ///
    /// Errors: those of the parameters, and the earlier one stays; `Running` while the player is active.
    pub fn load(&mut self, program: &ExcitationProgram<N>) -> Result<(), ExcitationError> {
        if self.state().is_active() {
            return Err(ExcitationError::Running);
        }
        check_at_once(program, &self.limits, self.arm_hash, self.tick_us)?;
        let series = PreparedSeries::new(program.period_us, self.tick_us);
        check_start(program, &series)?;
        self.program = *program;
        self.series = series;
        self.state.speed.prepare(&program.certificate, self.tick_us);
        self.state.excitation = Checking;
        self.state.checked = 0;
        self.state.start_waits = false;
        Ok(())
    }

    /// Executes a command of the host.
    ///
    /// Errors: `NotLoaded`; the error of a refused program; `Running` where the excitation must be at rest.
    pub fn command(&mut self, command: ExcitationCommand) -> Result<(), ExcitationError> {
        match (command, self.state()) {
            (Command::Status, _) => return Ok(()),
            (_, Empty) => return Err(ExcitationError::NotLoaded),
            (_, Refused(error)) => return Err(error),
            (Command::Start | Command::Release, _) if self.moving() => {
                return Err(ExcitationError::Running);
            }
            (Command::Stop, Approaching | Playing) => {
                self.state.excitation = Stopping;
                self.state.speed.stop();
            }
            (Command::Release, state) if state.is_active() => self.state.excitation = Ready,
            _ => {}
        }
        self.state.start_waits = command == Command::Start;
        Ok(())
    }

    /// Desired motion of the next tick, if the player decides it.
    ///
    /// * `sample` sample of this tick: its measurement is supervised, and a start begins where the host holds the arm
    ///
    /// Cost: four points of the check, or one of the path; a `sin_cos` each.
    pub fn step(&mut self, sample: Option<&JointSample<N>>) -> Option<JointMotion<N>> {
        if self.state() == Checking {
            self.check();
        }
        let measured = sample.and_then(|sample| sample.measured.map(|measured| measured.q));
        if self.state.start_waits
            && matches!(self.state(), Ready | Holding | Aborted(_))
            && let (Some(sample), Some(measured)) = (sample, &measured)
        {
            self.begin(sample, measured);
        } else if self.moving() {
            if let Some(reason) = self.exceeded(measured.as_ref()) {
                self.abort(reason);
            }
            self.advance();
        }
        self.state.supervision.before = measured;
        self.desired().copied()
    }

    fn check(&mut self) {
        for _ in 0..CHECK_POINTS_A_TICK {
            if let Err(error) = check_point(&self.program, &self.series, self.state.checked) {
                self.state.excitation = Refused(error);
                self.state.start_waits = false;
                return;
            }
            self.state.checked += 1;
        }
        if self.state.checked >= CHECK_POINTS {
            self.state.excitation = Ready;
        }
    }

    fn moving(&self) -> bool {
        self.state().is_active() && self.state.speed.moving()
    }

    fn abort(&mut self, reason: AbortReason) {
        if !matches!(self.state(), Aborted(_)) {
            self.state.excitation = Aborted(reason);
            self.state.speed.stop();
        }
    }

    /// Takes over the desired motion, at rest where the arm is held, if it is held.
    fn begin(&mut self, sample: &JointSample<N>, measured: &JointVector<N>) {
        let state = &mut self.state;
        state.start_waits = false;
        let held = state.excitation.is_active();
        let desired = if held { state.last } else { sample.desired };
        state.last = JointMotion {
            q: desired.q,
            ..JointMotion::zero()
        };
        let mut speeds = desired.qd.iter();
        let fast = speeds.position(|qd| qd.is_nan() || qd.abs() > HANDOVER_RAD_S);
        state.speed.rest();
        state.supervision.blind = 0;
        state.excitation = Approaching;
        let refused = match fast {
            Some(joint) => Some(AbortReason::Velocity(joint as u8)),
            None => self.exceeded(Some(measured)),
        };
        if let Some(reason) = refused {
            // The measured position: the desired one may not be finite.
            let finite = measured.iter().all(|q| q.is_finite());
            if !held && finite {
                self.state.last.q = *measured;
            }
            if !held && !finite {
                self.state.excitation = Ready;
                return;
            }
            self.abort(reason);
            return;
        }
        let to = self.series.at(&self.program.joints, 0).q;
        let certificate = &self.program.certificate;
        self.state.path = Path::approach(self.state.last.q, to, certificate, self.tick_us);
        (self.state.phase, self.state.periods) = (0, 0);
        self.state.speed.start();
    }

    fn advance(&mut self) {
        let (speed, _) = self.state.speed.now(self.tick_us);
        self.state.speed.advance();
        let (next_speed, slowing) = self.state.speed.now(self.tick_us);
        // Trapezoid rule; 2¹⁶ at full speed, so that the step is exact.
        let mean = (0.5 * (speed + next_speed) * 65_536.0) as u32;
        let step = self.state.path.phase_step(&self.series);
        let step = ((u64::from(step) * u64::from(mean)) >> 16) as u32;
        let (phase, arrived) = self.state.phase.overflowing_add(step);
        self.state.phase = phase;
        if arrived {
            self.arrive();
        }
        if !self.state.speed.moving() && self.state() == Stopping {
            self.state.excitation = Holding;
        }
        self.state.last = self.motion(next_speed, slowing);
    }

    /// Handles the end of the approach, or of a period.
    fn arrive(&mut self) {
        let state = &mut self.state;
        if let Path::Approach { .. } = state.path {
            // Approach and series both rest here, at any path speed.
            state.path = Path::Series;
            state.phase = 0;
            if state.excitation == Approaching {
                state.excitation = Playing;
            }
            return;
        }
        state.periods = state.periods.saturating_add(1);
        if self.program.periods != 0 && state.periods >= self.program.periods {
            state.phase = 0;
            state.speed.rest();
            if state.excitation == Playing {
                state.excitation = Holding;
            }
        }
    }

    fn motion(&self, speed: f32, slowing: f32) -> JointMotion<N> {
        let state = &self.state;
        let mut motion = (state.path).at(state.phase, &self.series, &self.program.joints);
        if state.speed.moving() {
            motion.qdd = motion.qdd * (speed * speed) + motion.qd * slowing;
            motion.qd *= speed;
        } else {
            // Exactly at rest.
            motion.qd.fill(0.0);
            motion.qdd.fill(0.0);
        }
        motion
    }

    fn exceeded(&mut self, measured: Option<&JointVector<N>>) -> Option<AbortReason> {
        let state = &mut self.state;
        let tracking = self.program.tracking_rad;
        let tick_us = self.tick_us;
        (state.supervision).exceeded(&self.limits, &state.last, measured, tracking, tick_us)
    }
}

#[cfg(test)]
mod tests {
    use super::super::MotionBounds;
    use super::super::path::tests::SWING;
    use super::*;
    use ExcitationCommand::{Release, Start, Status, Stop};
    use ExcitationState::{Aborted, Approaching, Checking, Holding, Playing, Ready, Refused};
    use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
    use foretorque::joint::JointMeasurement;

    const TICK_US: u32 = 1000;

    /// Bounds of [`SWING`] with a period of 4 s, with a margin.
    const BOUNDS: MotionBounds = MotionBounds {
        position_rad: (-2.2, -0.2),
        velocity_rad_s: 2.5,
        acceleration_rad_s2: 9.0,
    };

    fn program() -> ExcitationProgram<N> {
        ExcitationProgram {
            arm_hash: Ur5::HASH,
            period_us: 4_000_000,
            periods: 2,
            tracking_rad: 0.05,
            joints: [SWING; N],
            certificate: [BOUNDS; N],
        }
    }

    fn player() -> Player<N> {
        Player::new::<Ur5, P>(TICK_US)
    }

    fn at_rest(q: f32) -> JointMotion<N> {
        JointMotion {
            q: JointVector::from_element(q),
            ..JointMotion::zero()
        }
    }

    fn sample(desired: JointMotion<N>, q: JointVector<N>) -> JointSample<N> {
        let tau = JointVector::zeros();
        let measured = Some(JointMeasurement { q, tau });
        JointSample { desired, measured }
    }

    fn loaded(program: &ExcitationProgram<N>) -> Player<N> {
        let mut player = player();
        player.load(program).unwrap();
        player
    }

    /// One tick of an arm that follows exactly, or that the host holds at 0.3 rad.
    fn follow(player: &mut Player<N>) -> Option<JointMotion<N>> {
        let held = at_rest(0.3);
        let q = player.desired().map_or(held.q, |motion| motion.q);
        player.step(Some(&sample(held, q)))
    }

    fn followed(player: &mut Player<N>, ticks: u32) -> Vec<JointMotion<N>> {
        (0..ticks).filter_map(|_| follow(player)).collect()
    }

    /// A player that approaches the start of the series, all checks passed.
    fn approaching() -> Player<N> {
        let mut player = loaded(&program());
        player.command(Start).unwrap();
        followed(&mut player, 1 + CHECK_POINTS / CHECK_POINTS_A_TICK);
        assert_eq!(player.state(), Approaching);
        player
    }

    fn playing() -> Player<N> {
        let mut player = approaching();
        while player.state() == Approaching {
            follow(&mut player);
        }
        assert_eq!(player.state(), Playing);
        player
    }

    /// Asserts that velocity and acceleration are those of the positions, and that nothing jumps.
    fn assert_smooth(motions: &[JointMotion<N>]) {
        let h = 1e-3;
        for three in motions.windows(3) {
            let [before, now, after] = [&three[0], &three[1], &three[2]];
            let qd = (after.q[0] - before.q[0]) / (2.0 * h);
            assert!((qd - now.qd[0]).abs() < 2e-3, "{qd} {now:?}");
            assert!((now.qd[0] - before.qd[0]).abs() < 1.5 * 9.0 * h, "{now:?}");
            let step = (now.qdd[0] - before.qdd[0]).abs();
            assert!(step < 0.1, "{before:?} {now:?}");
        }
    }

    #[test]
    fn it_approaches_plays_its_periods_and_holds_smoothly() {
        let mut player = loaded(&program());
        player.command(Start).unwrap();
        let mut states = std::vec![player.state()];
        let mut motions = Vec::new();
        for _ in 0..20_000 {
            motions.extend(follow(&mut player));
            states.push(player.state());
        }
        states.dedup();
        assert_eq!(states, [Checking, Approaching, Playing, Holding]);
        assert_smooth(&motions);
        assert_eq!(motions[0], at_rest(0.3));
        let end = motions.last().unwrap();
        // Two periods end where one began.
        let start = PreparedSeries::new(4_000_000, TICK_US).at(&[SWING; N], 0);
        let rest = JointMotion {
            q: start.q,
            ..JointMotion::zero()
        };
        assert_eq!(*end, rest);
        let fastest = motions.iter().map(|m| m.qd.amax()).fold(0.0, f32::max);
        assert!(fastest > 1.0 && fastest < BOUNDS.velocity_rad_s);
    }

    #[test]
    fn a_stop_rests_on_the_path_and_a_start_continues_from_there() {
        for ticks in [10, 700, 1900] {
            let mut player = playing();
            let mut motions = followed(&mut player, ticks);
            player.command(Stop).unwrap();
            for refused in [Release, Start] {
                assert_eq!(player.command(refused), Err(ExcitationError::Running));
            }
            motions.extend(followed(&mut player, 1500));
            assert_eq!(player.state(), Holding, "{ticks}");
            assert_smooth(&motions);
            let worst = motions.iter().map(|m| m.qdd.amax()).fold(0.0, f32::max);
            assert!(worst <= 1.5 * BOUNDS.acceleration_rad_s2, "{worst}");
            let held = *motions.last().unwrap();
            player.command(Start).unwrap();
            let next = follow(&mut player).unwrap();
            assert_eq!((player.state(), next), (Approaching, held));
        }
    }

    #[test]
    fn a_stop_on_the_approach_rests_there() {
        let mut player = approaching();
        followed(&mut player, 400);
        player.command(Stop).unwrap();
        let motions = followed(&mut player, 2000);
        assert_eq!(player.state(), Holding);
        assert_smooth(&motions);
    }

    #[test]
    fn after_a_release_the_host_decides_and_may_load_another() {
        let mut player = playing();
        assert_eq!(player.load(&program()), Err(ExcitationError::Running));
        player.command(Stop).unwrap();
        followed(&mut player, 2000);
        player.command(Release).unwrap();
        assert_eq!((player.state(), follow(&mut player)), (Ready, None));
        assert_eq!(player.load(&program()), Ok(()));
    }

    /// The motions of an excitation that plays with the positions of tick `tick` changed, and the player at its end.
    fn disturbed(
        tick: u32,
        ticks: u32,
        change: impl Fn(&mut JointVector<N>),
    ) -> (Player<N>, Vec<JointMotion<N>>) {
        let mut player = playing();
        let mut motions = Vec::new();
        for k in 0..ticks {
            let mut q = player.desired().unwrap().q;
            if k == tick {
                change(&mut q);
            }
            motions.extend(player.step(Some(&sample(at_rest(0.0), q))));
        }
        (player, motions)
    }

    #[test]
    fn an_arm_that_does_not_follow_or_is_not_finite_aborts_it() {
        let state = |change: fn(&mut JointVector<N>)| disturbed(100, 200, change).0.state();
        assert_eq!(state(|_| {}), Playing);
        let tracking = state(|q| q[2] += 0.06);
        assert_eq!(tracking, Aborted(AbortReason::Tracking(2)));
        let jumped = state(|q| q[4] += 0.04);
        assert_eq!(jumped, Aborted(AbortReason::Velocity(4)));
        let outside = state(|q| q[1] = 7.0);
        assert_eq!(outside, Aborted(AbortReason::Position(1)));
        for nothing in [f32::NAN, f32::INFINITY] {
            let (player, _) = disturbed(100, 200, |q| q[5] = nothing);
            assert_eq!(player.state(), Aborted(AbortReason::NotFinite(5)));
        }
    }

    #[test]
    fn an_aborted_one_comes_to_rest_and_waits_for_release() {
        let (mut player, motions) = disturbed(600, 3000, |q| q[0] -= 0.2);
        assert_eq!(player.state(), Aborted(AbortReason::Tracking(0)));
        assert_smooth(&motions);
        assert_eq!(motions.last().unwrap().qd, JointVector::<N>::zeros());
        player.command(Release).unwrap();
        assert_eq!(player.state(), Ready);
    }

    #[test]
    fn it_continues_without_measurements_for_ten_ticks() {
        let mut player = playing();
        (0..11).for_each(|_| _ = player.step(None));
        assert_eq!(player.state(), Playing);
        player.step(None);
        assert_eq!(player.state(), Aborted(AbortReason::Blind));
    }

    #[test]
    fn it_does_not_start_on_a_moving_or_distant_arm() {
        let mut moving = at_rest(0.3);
        moving.qd[3] = 0.1;
        for (desired, q, reason) in [
            (moving, 0.3, AbortReason::Velocity(3)),
            (at_rest(0.3), 0.36, AbortReason::Tracking(0)),
            (at_rest(f32::NAN), 0.3, AbortReason::NotFinite(0)),
        ] {
            let mut player = loaded(&program());
            followed(&mut player, 300);
            player.command(Start).unwrap();
            let measured = JointVector::from_element(q);
            let motion = player.step(Some(&sample(desired, measured))).unwrap();
            assert_eq!(player.state(), Aborted(reason));
            assert_eq!(motion, at_rest(q), "at rest where the arm is");
        }
    }

    #[test]
    fn a_start_waits_for_a_measurement() {
        let mut player = loaded(&program());
        player.command(Start).unwrap();
        for _ in 0..300 {
            assert_eq!(player.step(None), None);
        }
        assert_eq!(player.state(), Ready);
        follow(&mut player);
        assert_eq!(player.state(), Approaching);
    }

    #[test]
    fn an_unplayable_program_is_refused_at_once() {
        use ExcitationError::{CertificateBeyondLimits as Beyond, NotAtRest, Number, WrongArm};
        type Change = fn(&mut ExcitationProgram<N>);
        let cases: [(Change, ExcitationError); 11] = [
            (|p| p.arm_hash ^= 1, WrongArm),
            (|p| p.period_us = 99_000, Number(0)),
            (|p| p.tracking_rad = 0.11, Number(0)),
            (|p| p.tracking_rad = f32::NAN, Number(0)),
            (|p| p.joints[2].q0_rad = f32::NAN, Number(2)),
            (|p| p.joints[3].b_rad_s[4] = f32::INFINITY, Number(3)),
            (|p| p.certificate[0].position_rad.1 = 6.4, Beyond(0)),
            (|p| p.certificate[1].velocity_rad_s = 3.2, Beyond(1)),
            (|p| p.certificate[5].acceleration_rad_s2 = 20.1, Beyond(5)),
            (|p| p.certificate[4].velocity_rad_s = f32::NAN, Beyond(4)),
            (|p| p.joints[1].a_rad_s[0] += 0.01, NotAtRest(1)),
        ];
        for (change, error) in cases {
            let mut program = program();
            change(&mut program);
            assert_eq!(player().load(&program), Err(error));
        }
    }

    #[test]
    fn a_series_beyond_its_certificate_fails_the_check() {
        let cases: [fn(&mut MotionBounds); 4] = [
            |bounds| bounds.position_rad.0 = -1.5,
            |bounds| bounds.position_rad.1 = -0.9,
            |bounds| bounds.velocity_rad_s = 1.0,
            |bounds| bounds.acceleration_rad_s2 = 3.0,
        ];
        for (case, change) in cases.into_iter().enumerate() {
            let mut program = program();
            change(&mut program.certificate[3]);
            let mut player = loaded(&program);
            player.command(Start).unwrap();
            assert_eq!(followed(&mut player, 300), []);
            let error = ExcitationError::CertificateBroken(3);
            assert_eq!(player.state(), Refused(error), "case {case}");
            assert_eq!(player.command(Start), Err(error));
        }
    }

    #[test]
    fn without_a_program_nothing_starts() {
        let mut player = player();
        for command in [Start, Stop, Release] {
            assert_eq!(player.command(command), Err(ExcitationError::NotLoaded));
        }
        assert_eq!(player.command(Status), Ok(()));
        assert_eq!(follow(&mut player), None);
    }

    #[test]
    fn any_measurement_leaves_the_motion_inside_the_certificate() {
        let mut bits = 0x1234_5678_u32;
        let mut any = || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from_bits(bits)
        };
        let (low, high) = BOUNDS.position_rad;
        for _ in 0..200 {
            let mut player = playing();
            for tick in 0..300 {
                let mut q = player.desired().unwrap().q;
                if tick > 20 {
                    q = JointVector::from_fn(|_, _| any());
                }
                let anything = at_rest(any());
                let motion = player.step(Some(&sample(anything, q))).unwrap();
                assert!(motion.q.iter().all(|q| (low..high).contains(q)));
                assert!(motion.qd.amax() <= BOUNDS.velocity_rad_s);
                assert!(motion.qdd.amax() <= 1.5 * BOUNDS.acceleration_rad_s2);
            }
            assert!(matches!(player.state(), Aborted(_)));
        }
    }
}
