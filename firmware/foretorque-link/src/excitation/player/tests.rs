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
    let mut states = vec![player.state()];
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
    for (approach, ticks) in [(true, 400), (false, 10), (false, 700), (false, 1900)] {
        let mut player = if approach { approaching() } else { playing() };
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
fn steps_of_a_coarse_encoder_are_no_speed() {
    let mut player = playing();
    let step = core::f32::consts::TAU / 1024.0;
    for _ in 0..4000 {
        let motion = player.desired().unwrap();
        let q = motion.q.map(|q| (q / step).round() * step);
        player.step(Some(&sample(at_rest(0.0), q)));
        assert_eq!(player.state(), Playing);
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
