//! An excitation that the board plays itself, from the upload to the end, natively and in the emulator.

use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::excitation::{
    AbortReason, ExcitationCommand, ExcitationError, ExcitationProgram, ExcitationState,
};
use foretorque_link::wire::NackReason;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{BoardError, Client, Native, Transport};
use foretorque_workbench::excitation::{Excitation, QuickConfig};
use foretorque_workbench::robot::Robot;
use std::time::Duration;

const BOOT: Duration = Duration::from_secs(5);
/// Ticks of one run: check, approach, one period of 2 s, rest.
const TICKS: usize = 5000;

fn excitation() -> Excitation {
    let robot = Robot::load("ur5").expect("built in");
    let config = QuickConfig {
        period_s: 2.0,
        ..QuickConfig::default()
    };
    Excitation::quick(&robot, 1, &config, || ()).expect("the UR5 can move")
}

fn program() -> ExcitationProgram<N> {
    let program = excitation().program(Ur5::HASH, 1, 0.05);
    program.expect("six joints")
}

fn client(transport: Box<dyn Transport>) -> Client<N> {
    let connected = Client::connect::<Ur5, P>(transport, BOOT);
    let mut client = connected.unwrap_or_else(|error| panic!("{error}"));
    // A machine that is busy with other tests may keep the emulator waiting.
    client.set_timeout(Duration::from_secs(20));
    client
}

fn native() -> Client<N> {
    client(Box::new(Native::<Ur5, N, P>::new().expect("usable limits")))
}

fn emulated() -> Client<N> {
    let emulator = Emulator::start(&QemuOptions::new(Image::Bulk));
    client(Box::new(emulator.unwrap_or_else(|error| panic!("{error}"))))
}

/// Reply of the board in one tick: torque bit for bit, state, desired motion.
type Reply = (Vec<u32>, Option<(ExcitationState, JointMotion<N>)>);

/// Plays it on an arm that follows within the resolution of the link, and is `late` in joint 3 from tick 2000 on.
fn play(client: &mut Client<N>, late: f32) -> Vec<Reply> {
    client.load_excitation(&program()).expect("it is taken");
    let beside = excitation().at::<N>(0.0).q.add_scalar(-0.1);
    let mut desired = JointMotion {
        q: beside.cast(),
        ..JointMotion::zero()
    };
    let standing = JointSample {
        desired,
        measured: Some(JointMeasurement {
            q: desired.q,
            tau: JointVector::zeros(),
        }),
    };
    client.arm(&standing).expect("the board can be armed");
    client
        .excitation(ExcitationCommand::Start)
        .expect("it may be started");
    client.learning(true).expect("the board learns");
    let mut replies = Vec::new();
    for tick in 0..TICKS {
        let mut q = desired.q;
        if tick >= 2000 {
            q[2] += late;
        }
        let sample = JointSample {
            desired,
            measured: Some(JointMeasurement {
                q,
                tau: desired.qd * 8.0,
            }),
        };
        let reply = client.sample(&sample).expect("a torque");
        if let Some((_, motion)) = reply.excited {
            desired = motion;
        }
        let torque = reply.total.iter().map(|tau| tau.to_bits()).collect();
        replies.push((torque, reply.excited));
    }
    replies
}

fn stages(replies: &[Reply]) -> Vec<Option<ExcitationState>> {
    let mut stages: Vec<_> = replies
        .iter()
        .map(|(_, e)| e.map(|(stage, _)| stage))
        .collect();
    stages.dedup();
    stages
}

#[test]
fn the_board_plays_the_series_of_the_file_the_same_natively_and_emulated() {
    let replies = play(&mut native(), 0.0);
    let expected = [
        None,
        Some(ExcitationState::Approaching),
        Some(ExcitationState::Playing),
        Some(ExcitationState::Holding),
    ];
    assert_eq!(stages(&replies), expected);
    let series = excitation();
    let playing: Vec<_> = replies
        .iter()
        .filter_map(|(_, excited)| excited.filter(|(stage, _)| *stage == ExcitationState::Playing))
        .collect();
    assert_eq!(playing.len(), 2000);
    // The wire's resolution is the coarsest part: 2^-20 rad, 2^-18 rad/s, 2^-9 rad/s², half a step of each, and f32.
    for (k, (_, motion)) in playing.iter().enumerate() {
        let exact = series.at::<N>(k as f64 * 1e-3);
        let apart = |seen: &JointVector<N>, exact: nalgebra::SVector<f64, N>| {
            (seen.cast::<f64>() - exact).amax()
        };
        assert!(apart(&motion.q, exact.q) < 1.5e-6, "tick {k}");
        assert!(apart(&motion.qd, exact.qd) < 1e-5, "tick {k}");
        assert!(apart(&motion.qdd, exact.qdd) < 1.1e-3, "tick {k}");
    }
    assert!(
        play(&mut emulated(), 0.0) == replies,
        "the emulator differs"
    );
}

#[test]
fn an_arm_that_does_not_follow_is_told_in_the_reply_and_brought_to_rest() {
    let mut client = native();
    let replies = play(&mut client, 0.06);
    let aborted = Some(ExcitationState::Aborted(AbortReason::Tracking(2)));
    assert_eq!(stages(&replies).last(), Some(&aborted));
    let (_, end) = replies
        .last()
        .and_then(|(_, excited)| *excited)
        .expect("in charge");
    assert_eq!(end.qd, JointVector::<N>::zeros());
    assert_eq!(
        client
            .excitation(ExcitationCommand::Release)
            .expect("at rest"),
        ExcitationState::Ready
    );
}

#[test]
fn a_file_for_another_arm_or_beyond_the_limits_is_refused_with_its_reason() {
    let refused = |change: fn(&mut ExcitationProgram<N>)| {
        let mut program = program();
        change(&mut program);
        match native().load_excitation(&program) {
            Err(BoardError::Refused(NackReason::Excitation(reason))) => Some(reason),
            _ => None,
        }
    };
    let beyond = ExcitationError::CertificateBeyondLimits(1);
    assert_eq!(
        refused(|p| p.arm_hash += 1),
        Some(ExcitationError::WrongArm)
    );
    assert_eq!(
        refused(|p| p.certificate[1].velocity_rad_s = 9.0),
        Some(beyond)
    );
    assert_eq!(refused(|_| {}), None);
}
