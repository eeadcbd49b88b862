//! Ticks without a sample that can be used.

use super::*;

#[test]
fn without_samples_the_torque_is_held_then_slewed_to_zero() {
    let mut tick = tick(set());
    let before = settled(&mut tick, &motion(0.3));
    for _ in 0..tick.config().hold_ticks {
        let held = tick.step_stale();
        assert_eq!(held.total, before.total);
        assert!(held.flags.contains(Flags::STALE_SAMPLE));
    }
    let mut last = before.total;
    for _ in 0..25 {
        let torque = tick.step_stale();
        assert!(torque.flags.contains(Flags::WITHDRAWN));
        for j in 0..N {
            assert!((torque.total[j] - last[j]).abs() <= tick.config().slew_per_tick[j] * 1.001);
        }
        last = torque.total;
    }
    assert_eq!(last.amax(), 0.0);
    let back = settled(&mut tick, &motion(0.3));
    assert_eq!(back.total, before.total);
}

#[test]
fn a_desired_motion_that_is_not_finite_is_no_sample() {
    let mut broken = motion(0.3);
    broken.qdd[5] = f32::NAN;
    let (mut fed, mut starved) = (tick(set()), tick(set()));
    settled(&mut fed, &motion(0.3));
    settled(&mut starved, &motion(0.3));
    for _ in 0..40 {
        let torque = fed.step(&sample(broken));
        assert!(
            torque
                .flags
                .contains(Flags::STALE_SAMPLE | Flags::NOT_FINITE)
        );
        assert_eq!(torque.total, starved.step_stale().total);
    }
}
