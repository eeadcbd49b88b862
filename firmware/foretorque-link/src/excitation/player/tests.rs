use super::super::MotionBounds;
use super::super::series::tests::SWING;
use super::*;
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use foretorque::joint::JointMeasurement;

const TICK_US: u32 = 1000;

/// What [`SWING`] keeps to with a period of 4 s, with room.
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
    JointSample {
        desired,
        measured: Some(JointMeasurement {
            q,
            tau: JointVector::<N>::zeros(),
        }),
    }
}

/// One tick of an arm that follows exactly, or is held at 0.3 rad while the host is in charge.
fn follow(player: &mut Player<N>) -> Option<JointMotion<N>> {
    let held = at_rest(0.3);
    let q = player.desired().map_or(held.q, |motion| motion.q);
    player.step(Some(&sample(held, q)))
}

/// A player on its way to the beginning of the series, all checks passed.
fn approaching() -> Player<N> {
    let mut player = player();
    player.load(&program()).unwrap();
    player.command(ExcitationCommand::Start).unwrap();
    for _ in 0..=check::POINTS / check::POINTS_A_TICK {
        follow(&mut player);
    }
    assert_eq!(player.state(), ExcitationState::Approaching);
    player
}

fn playing() -> Player<N> {
    let mut player = approaching();
    for _ in 0..20_000 {
        follow(&mut player);
        if player.state() == ExcitationState::Playing {
            return player;
        }
    }
    panic!("the approach never ends");
}

/// Velocity and acceleration are those of the positions, and nothing leaps.
fn assert_smooth(motions: &[JointMotion<N>]) {
    let h = 1e-3;
    for three in motions.windows(3) {
        let [before, now, after] = three else {
            unreachable!()
        };
        let qd = (after.q[0] - before.q[0]) / (2.0 * h);
        assert!((qd - now.qd[0]).abs() < 2e-3, "{qd} {now:?}");
        assert!((now.qd[0] - before.qd[0]).abs() < 1.5 * 9.0 * h, "{now:?}");
        assert!(
            (now.qdd[0] - before.qdd[0]).abs() < 0.1,
            "{before:?} {now:?}"
        );
    }
}

#[test]
fn it_approaches_plays_its_periods_and_holds_without_a_leap() {
    let mut player = player();
    player.load(&program()).unwrap();
    player.command(ExcitationCommand::Start).unwrap();
    let mut stages = std::vec![player.state()];
    let mut motions = Vec::new();
    for _ in 0..20_000 {
        motions.extend(follow(&mut player));
        if stages.last() != Some(&player.state()) {
            stages.push(player.state());
        }
    }
    let expected = [
        ExcitationState::Checking,
        ExcitationState::Approaching,
        ExcitationState::Playing,
        ExcitationState::Holding,
    ];
    assert_eq!(stages, expected);
    assert_smooth(&motions);
    assert_eq!(motions[0], at_rest(0.3));
    let end = motions.last().unwrap();
    assert_eq!(
        *end,
        JointMotion {
            q: end.q,
            ..JointMotion::zero()
        }
    );
    // Two periods end where one began.
    let start = PreparedSeries::new(4_000_000, TICK_US).at(&[SWING; N], 0);
    assert_eq!(end.q, start.q);
    let fastest = motions.iter().map(|m| m.qd.amax()).fold(0.0, f32::max);
    assert!(fastest > 1.0 && fastest < BOUNDS.velocity_rad_s);
}

#[test]
fn a_stop_comes_to_rest_on_the_path_and_a_start_begins_again_from_there() {
    for ticks in [10, 700, 1900] {
        let mut player = playing();
        let mut motions = Vec::new();
        for _ in 0..ticks {
            motions.extend(follow(&mut player));
        }
        player.command(ExcitationCommand::Stop).unwrap();
        assert_eq!(
            player.command(ExcitationCommand::Release),
            Err(ExcitationError::Running)
        );
        assert_eq!(
            player.command(ExcitationCommand::Start),
            Err(ExcitationError::Running)
        );
        for _ in 0..1500 {
            motions.extend(follow(&mut player));
        }
        assert_eq!(player.state(), ExcitationState::Holding, "{ticks}");
        assert_smooth(&motions);
        let worst = motions.iter().map(|m| m.qdd.amax()).fold(0.0, f32::max);
        assert!(worst <= 1.5 * BOUNDS.acceleration_rad_s2, "{worst}");
        let held = *motions.last().unwrap();
        player.command(ExcitationCommand::Start).unwrap();
        let next = follow(&mut player).unwrap();
        assert_eq!((player.state(), next), (ExcitationState::Approaching, held));
    }
}

#[test]
fn a_stop_on_the_approach_rests_there() {
    let mut player = approaching();
    for _ in 0..400 {
        follow(&mut player);
    }
    player.command(ExcitationCommand::Stop).unwrap();
    let mut motions = Vec::new();
    for _ in 0..2000 {
        motions.extend(follow(&mut player));
    }
    assert_eq!(player.state(), ExcitationState::Holding);
    assert_smooth(&motions);
}

#[test]
fn released_the_host_is_in_charge_again_and_may_load_another() {
    let mut player = playing();
    assert_eq!(player.load(&program()), Err(ExcitationError::Running));
    player.command(ExcitationCommand::Stop).unwrap();
    for _ in 0..2000 {
        follow(&mut player);
    }
    player.command(ExcitationCommand::Release).unwrap();
    assert_eq!(
        (player.state(), follow(&mut player)),
        (ExcitationState::Ready, None)
    );
    assert_eq!(player.load(&program()), Ok(()));
}

/// What becomes of a playing excitation whose tick 100 sees `spoil`ed positions.
fn spoiled(spoil: impl Fn(&mut JointVector<N>)) -> ExcitationState {
    let mut player = playing();
    for tick in 0..200 {
        let mut q = player.desired().unwrap().q;
        if tick == 100 {
            spoil(&mut q);
        }
        player.step(Some(&sample(at_rest(0.0), q)));
    }
    player.state()
}

#[test]
fn an_arm_that_does_not_follow_or_is_no_number_breaks_it_off() {
    assert_eq!(spoiled(|_| {}), ExcitationState::Playing);
    let tracking = spoiled(|q| q[2] += 0.06);
    assert_eq!(tracking, ExcitationState::Aborted(AbortReason::Tracking(2)));
    let leapt = spoiled(|q| q[4] += 0.04);
    assert_eq!(leapt, ExcitationState::Aborted(AbortReason::Velocity(4)));
    let gone = spoiled(|q| q[1] = 7.0);
    assert_eq!(gone, ExcitationState::Aborted(AbortReason::Position(1)));
    for nothing in [f32::NAN, f32::INFINITY] {
        let stage = spoiled(|q| q[5] = nothing);
        assert_eq!(stage, ExcitationState::Aborted(AbortReason::NotFinite(5)));
    }
}

#[test]
fn an_aborted_one_comes_to_rest_and_stays_in_charge_with_its_reason() {
    let mut player = playing();
    let mut motions = Vec::new();
    for tick in 0..3000 {
        let mut q = player.desired().unwrap().q;
        if tick == 600 {
            q[0] -= 0.2;
        }
        motions.extend(player.step(Some(&sample(at_rest(0.0), q))));
    }
    assert_eq!(
        player.state(),
        ExcitationState::Aborted(AbortReason::Tracking(0))
    );
    assert_smooth(&motions);
    assert_eq!(motions.last().unwrap().qd, JointVector::<N>::zeros());
    player.command(ExcitationCommand::Release).unwrap();
    assert_eq!(player.state(), ExcitationState::Ready);
}

#[test]
fn it_goes_on_blind_for_ten_ticks_and_no_longer() {
    let mut player = playing();
    for _ in 0..11 {
        player.step(None);
    }
    assert_eq!(player.state(), ExcitationState::Playing);
    player.step(None);
    assert_eq!(player.state(), ExcitationState::Aborted(AbortReason::Blind));
}

#[test]
fn it_does_not_begin_on_a_moving_arm_or_one_that_is_not_where_it_is_held() {
    let mut moving = at_rest(0.3);
    moving.qd[3] = 0.1;
    let cases = [
        (
            moving,
            moving.q,
            ExcitationState::Aborted(AbortReason::Velocity(3)),
        ),
        (
            at_rest(0.3),
            JointVector::from_element(0.36),
            ExcitationState::Aborted(AbortReason::Tracking(0)),
        ),
        (
            at_rest(f32::NAN),
            JointVector::from_element(0.3),
            ExcitationState::Aborted(AbortReason::NotFinite(0)),
        ),
    ];
    for (desired, q, stage) in cases {
        let mut player = player();
        player.load(&program()).unwrap();
        for _ in 0..300 {
            follow(&mut player);
        }
        player.command(ExcitationCommand::Start).unwrap();
        let motion = player.step(Some(&sample(desired, q))).unwrap();
        assert_eq!(player.state(), stage);
        assert_eq!(motion.q, q, "at rest where the arm is");
        assert_eq!(
            (motion.qd, motion.qdd),
            (JointVector::<N>::zeros(), JointVector::<N>::zeros())
        );
    }
}

#[test]
fn a_start_waits_for_a_measurement() {
    let mut player = player();
    player.load(&program()).unwrap();
    player.command(ExcitationCommand::Start).unwrap();
    for _ in 0..300 {
        assert_eq!(player.step(None), None);
    }
    assert_eq!(player.state(), ExcitationState::Ready);
    follow(&mut player);
    assert_eq!(player.state(), ExcitationState::Approaching);
}

#[test]
fn a_program_that_cannot_be_played_is_refused_at_once() {
    let changed = |change: fn(&mut ExcitationProgram<N>)| {
        let mut program = program();
        change(&mut program);
        player().load(&program)
    };
    use ExcitationError::{CertificateBeyondLimits, NotAtRest, Number, WrongArm};
    assert_eq!(changed(|_| {}), Ok(()));
    assert_eq!(changed(|p| p.arm_hash ^= 1), Err(WrongArm));
    assert_eq!(changed(|p| p.period_us = 99_000), Err(Number(0)));
    assert_eq!(changed(|p| p.tracking_rad = 0.11), Err(Number(0)));
    assert_eq!(changed(|p| p.tracking_rad = f32::NAN), Err(Number(0)));
    assert_eq!(changed(|p| p.joints[2].q0_rad = f32::NAN), Err(Number(2)));
    assert_eq!(
        changed(|p| p.joints[3].b_rad_s[4] = f32::INFINITY),
        Err(Number(3))
    );
    let beyond = |joint| Err(CertificateBeyondLimits(joint));
    assert_eq!(
        changed(|p| p.certificate[0].position_rad.1 = 6.4),
        beyond(0)
    );
    assert_eq!(
        changed(|p| p.certificate[1].velocity_rad_s = 3.2),
        beyond(1)
    );
    assert_eq!(
        changed(|p| p.certificate[5].acceleration_rad_s2 = 20.1),
        beyond(5)
    );
    assert_eq!(
        changed(|p| p.certificate[4].velocity_rad_s = f32::NAN),
        beyond(4)
    );
    assert_eq!(
        changed(|p| p.joints[1].a_rad_s[0] += 0.01),
        Err(NotAtRest(1))
    );
}

#[test]
fn a_series_that_does_not_keep_its_certificate_is_refused_by_the_check() {
    let cases: [fn(&mut MotionBounds); 4] = [
        |bounds| bounds.position_rad.0 = -1.5,
        |bounds| bounds.position_rad.1 = -0.9,
        |bounds| bounds.velocity_rad_s = 1.0,
        |bounds| bounds.acceleration_rad_s2 = 3.0,
    ];
    for (case, change) in cases.into_iter().enumerate() {
        let mut program = program();
        change(&mut program.certificate[3]);
        let mut player = player();
        player.load(&program).unwrap();
        player.command(ExcitationCommand::Start).unwrap();
        for _ in 0..300 {
            assert_eq!(follow(&mut player), None);
        }
        let refused = ExcitationError::CertificateBroken(3);
        assert_eq!(
            player.state(),
            ExcitationState::Refused(refused),
            "case {case}"
        );
        assert_eq!(player.command(ExcitationCommand::Start), Err(refused));
    }
}

#[test]
fn without_a_program_there_is_nothing_to_start() {
    let mut player = player();
    for command in [
        ExcitationCommand::Start,
        ExcitationCommand::Stop,
        ExcitationCommand::Release,
    ] {
        assert_eq!(player.command(command), Err(ExcitationError::NotLoaded));
    }
    assert_eq!(player.command(ExcitationCommand::Status), Ok(()));
    assert_eq!(follow(&mut player), None);
}

#[test]
fn whatever_is_measured_the_motion_is_finite_and_inside_the_certificate() {
    let mut bits = 0x1234_5678_u32;
    let mut any = || {
        bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f32::from_bits(bits)
    };
    for _ in 0..200 {
        let mut player = playing();
        for tick in 0..300 {
            let mut q = player.desired().unwrap().q;
            if tick > 20 {
                q = JointVector::from_fn(|_, _| any());
            }
            let anything = at_rest(any());
            let motion = player.step(Some(&sample(anything, q))).unwrap();
            assert!(
                motion
                    .q
                    .iter()
                    .all(|q| (BOUNDS.position_rad.0..BOUNDS.position_rad.1).contains(q))
            );
            assert!(motion.qd.amax() <= BOUNDS.velocity_rad_s);
            assert!(motion.qdd.amax() <= 1.5 * BOUNDS.acceleration_rad_s2);
        }
        assert!(matches!(player.state(), ExcitationState::Aborted(_)));
    }
}
