use super::*;

fn at(q: f32, tau: f32) -> JointMeasurement<2> {
    JointMeasurement {
        q: [q, -q].into(),
        tau: [tau, -tau].into(),
    }
}

#[test]
fn the_factors_are_those_of_the_sums_over_the_window() {
    for delay in LEAST_DELAY..=MOST_DELAY {
        let d = delay as i32;
        let sum = |power| (-d..=d).map(|k: i32| k.pow(power) as f32).sum::<f32>();
        let [sum_0, sum_2, sum_4] = [0, 2, 4].map(sum);
        let curvature = sum_4 - sum_2 * sum_2 / sum_0;
        let expected = FitFactors {
            sum_2,
            inv_sum_0: 1.0 / sum_0,
            mean_square: sum_2 / sum_0,
            inv_sum_2: 1.0 / sum_2,
            inv_curvature: 1.0 / curvature,
        };
        assert_eq!(FitFactors::new(delay), expected);
    }
}

#[test]
fn a_quadratic_is_read_exactly_with_its_torque() {
    let period = 1e-3f64;
    let (q0, qd0, qdd0) = (5.5, -1.7, 9.0);
    let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
    for tick in 0..200 {
        let t = f64::from(tick) * period;
        let q = q0 + qd0 * t + 0.5 * qdd0 * t * t;
        window.push(Some(&at(q as f32, tick as f32)));
        let Some(seen) = window.conditioned(1e3) else {
            assert!(tick < 30);
            continue;
        };
        let then = t - 0.015;
        let q = q0 + qd0 * then + 0.5 * qdd0 * then * then;
        assert!((f64::from(seen.motion.q[0]) - q).abs() < 1e-6);
        assert!((f64::from(seen.motion.qd[1]) + (qd0 + qdd0 * then)).abs() < 1e-4);
        // An f32 near 5.5 rad is rounded to 2.4e-7 rad; the second difference amplifies it 5000-fold a sample.
        let qdd = f64::from(seen.motion.qdd[0]);
        assert!((qdd - qdd0).abs() < 5e-3, "{qdd}");
        assert_eq!(seen.tau[0], (tick - 15) as f32);
    }
}

#[test]
fn no_delay_is_beyond_its_bounds() {
    for (asked, delay) in [(0, LEAST_DELAY), (9, 9), (99, MOST_DELAY)] {
        let mut window = MeasurementWindow::<2>::new(1, asked);
        assert!(window == MeasurementWindow::new(1, delay), "{asked}");
        (0..40).for_each(|tick| window.push(Some(&at(tick as f32, 0.0))));
        assert!(window.conditioned(1e3).is_some());
    }
}

#[test]
fn a_short_filter_belongs_to_its_middle() {
    for delay in [LEAST_DELAY, 7, 14] {
        let mut window = MeasurementWindow::<2>::new(1, delay);
        let mut rows = 0;
        for tick in 0..60u32 {
            let t = 0.01 * tick as f32;
            window.push(Some(&at(2.0 * t * t, tick as f32)));
            let Some(seen) = window.conditioned(100.0) else {
                assert!(tick < taps(delay) - 1, "{delay}: {tick}");
                continue;
            };
            rows += 1;
            let then = tick - delay;
            assert_eq!(seen.tau[0], then as f32);
            let t = 0.01 * then as f32;
            assert!((seen.motion.q[0] - 2.0 * t * t).abs() < 1e-5);
            assert!((seen.motion.qd[0] - 4.0 * t).abs() < 1e-3);
            assert!((seen.motion.qdd[0] - 4.0).abs() < 2e-2);
        }
        assert_eq!(rows, 60 - taps(delay) + 1);
    }
}

#[test]
fn a_sample_of_several_ticks_is_their_mean_and_belongs_to_its_middle() {
    for decimation in [1u32, 2] {
        let mut window = MeasurementWindow::<2>::new(decimation, MOST_DELAY);
        let mut rows = 0;
        for tick in 0..400 {
            let t = 1e-3 * tick as f32;
            window.push(Some(&at(2.0 * t * t, tick as f32)));
            let Some(seen) = window.conditioned(1e3) else {
                assert!(tick < 31 * decimation, "{decimation}: {tick}");
                continue;
            };
            rows += 1;
            // Motion and torque are of the same instant, whatever the delay.
            let then = 1e-3 * seen.tau[0];
            assert!((seen.motion.qd[0] - 4.0 * then).abs() < 2e-3);
            assert!((seen.motion.qdd[0] - 4.0).abs() < 0.05);
        }
        assert!(rows > 250, "{rows}");
    }
}

#[test]
fn cogging_passes_the_filter_with_the_stated_gain() {
    for angle in [0.01f32, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.6] {
        let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
        for tick in 0..TAPS {
            let phase = angle * (tick as f32 - DELAY as f32);
            window.push(Some(&at(phase.cos(), tick as f32)));
        }
        let seen = window.conditioned(1.0).expect("the window is full");
        let gain = -seen.motion.qdd[0] / (angle * angle);
        let stated = cogging_attenuation(angle, TAPS as u32);
        let allowed = if angle > 0.3 { 0.05 } else { 0.01 };
        let error = (gain - stated).abs();
        assert!(error < allowed, "{angle}: {gain} {stated}");
    }
}

#[test]
fn another_period_scales_the_derivatives() {
    let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
    for tick in 0..40 {
        window.push(Some(&at(0.001 * tick as f32, 0.0)));
    }
    let slow = window.conditioned(500.0).unwrap().motion.qd[0];
    assert!((slow - 0.5).abs() < 1e-5, "{slow}");
}

/// Swinging joint whose torque is the number of the tick.
fn swinging(tick: usize) -> JointMeasurement<2> {
    at((0.003 * tick as f32).sin(), tick as f32)
}

/// Output of a window after each of 200 ticks, with the measurements of `arrives`.
fn outputs(
    arrives: impl Fn(usize) -> Option<JointMeasurement<2>>,
) -> std::vec::Vec<Option<ConditionedSample<2>>> {
    let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
    let output = |tick| {
        window.push(arrives(tick).as_ref());
        window.conditioned(1e3)
    };
    (0..200).map(output).collect()
}

#[test]
fn a_short_gap_is_bridged() {
    let whole = outputs(|tick| Some(swinging(tick)));
    let whole_at = |tick: usize| whole[tick].unwrap();
    let not_a_number = JointMeasurement {
        tau: JointVector::<2>::new(f32::NAN, 0.0),
        ..swinging(0)
    };
    for (missing, length) in [(None, 1), (None, 3), (Some(not_a_number), 2)] {
        let gap = 100..100 + length;
        let seen = outputs(|tick| match gap.contains(&tick) {
            true => missing,
            false => Some(swinging(tick)),
        });
        for (tick, (seen, whole)) in seen.iter().zip(&whole).enumerate().skip(30) {
            if gap.contains(&tick) {
                // Two joints, so the sample before the gap serves one more tick.
                assert_eq!(*seen, (tick == 100).then(|| whole_at(99)), "{tick}");
                continue;
            }
            let (seen, whole) = (seen.unwrap(), whole.unwrap());
            assert!((seen.tau - whole.tau).amax() < 1e-4);
            assert!((seen.motion.q - whole.motion.q).amax() < 2e-5);
            assert!((seen.motion.qdd - whole.motion.qdd).amax() < 0.2, "{tick}");
        }
    }
}

/// Sensors read in every second and third tick; reports 0 to 2 ticks old, the newest first; reports late by one tick, some
/// of them with the one before.
#[test]
fn measurements_of_uneven_age_give_rows_in_every_tick() {
    let age = |tick: usize| [0, 2, 1, 0, 0, 1, 2, 2, 0, 1][tick % 10];
    let newest = |tick: usize| (0..=tick).map(|tick| tick.saturating_sub(age(tick))).max();
    let late = |tick: usize| tick - usize::from(matches!(tick % 23, 6 | 12 | 13));
    let cases: [(&str, &dyn Fn(usize) -> usize); 4] = [
        ("every second", &|tick| tick - tick % 2),
        ("every third", &|tick| tick - tick % 3),
        ("by chance", &|tick| newest(tick).unwrap_or(0)),
        ("late", &late),
    ];
    for (name, measured_at) in cases {
        let mut rows = [0; 2];
        let seen = outputs(|tick| Some(swinging(measured_at(tick))));
        for (tick, seen) in seen.iter().enumerate() {
            let Some(ConditionedSample { motion, tau }) = seen else {
                continue;
            };
            rows[tick % 2] += 1;
            // The torque is the tick of the instant.
            let (sine, cosine) = (0.003 * tau[0]).sin_cos();
            // At the times of their arrival, late measurements err by 0.04 rad/s and 11 rad/s².
            let (qd, qdd) = (motion.qd[0] - 3.0 * cosine, motion.qdd[0] + 9.0 * sine);
            let right = qd.abs() < 0.001 && qdd.abs() < 0.01;
            assert!(right, "{name}: {tick}: {qd} {qdd}");
        }
        assert!(rows.iter().all(|&rows| rows > 25), "{name}: {rows:?}");
    }
}

#[test]
fn a_long_gap_empties_the_window() {
    let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
    for tick in 0..50 {
        window.push(Some(&swinging(tick)));
    }
    for gap in 1..=MAX_BRIDGED {
        window.push(None);
        // A sample serves each of two joints once.
        assert_eq!(window.conditioned(1e3).is_some(), gap < 2, "{gap}");
        assert!(window.is_full());
    }
    window.push(None);
    for tick in 60..90 {
        assert!(!window.is_full() && window.conditioned(1e3).is_none());
        window.push(Some(&swinging(tick)));
    }
    window.push(Some(&swinging(90)));
    assert_eq!(window.conditioned(1e3).unwrap().tau[0], 75.0);
}

#[test]
fn after_a_long_gap_of_copies_the_window_fills_twice() {
    let mut window = MeasurementWindow::<2>::new(1, MOST_DELAY);
    (0..50).for_each(|tick| window.push(Some(&swinging(tick))));
    for _ in 0..=MAX_BRIDGED {
        window.push(Some(&swinging(49)));
    }
    let empty = |tick: &usize| {
        window.push(Some(&swinging(*tick)));
        !window.is_full()
    };
    let first = 55;
    let filling = (first..).take_while(empty).count() + 1;
    assert_eq!(filling, 2 * TAPS - RECENT - 1);
}

#[test]
fn a_slower_sensor_leaves_rows_to_every_joint() {
    for (decimation, every) in [(1u32, 2), (2, 2), (4, 4), (6, 2), (6, 3)] {
        let mut window = MeasurementWindow::<6>::new(decimation, MOST_DELAY);
        let mut rows = [0; 6];
        for tick in 0..3000_usize {
            let mut measured = JointMeasurement::<6>::zero();
            measured.q.fill(1e-3 * (tick / every * every) as f32);
            window.push(Some(&measured));
            rows[tick % 6] += usize::from(window.conditioned(1e3).is_some());
        }
        assert!(
            rows.iter().all(|rows| *rows > 400),
            "{decimation} {every}: {rows:?}"
        );
    }
}
