//! The tables of `docs/safety.md` against the code.

use super::*;
use foretorque::feedforward::FeedForwardConfig;
use std::format;
use std::string::{String, ToString as _};
use std::vec::Vec;

const PAGE: &str = include_str!("../../../../../docs/safety.md");

/// A number as the page has it, to three places.
fn text(value: f32) -> String {
    ((value * 1e3).round() / 1e3).to_string()
}

#[test]
fn every_limit_and_time_of_the_page_is_that_of_the_code() {
    let limits = limits();
    let config = FeedForwardConfig::for_arm::<Ur5, 40>(1e-3);
    let arm = <Ur5 as foretorque::arm::Arm<N, 40>>::limits()[0];
    // Periods of 1 ms, and one that may have begun before.
    let [timeout, measured] = [limits.timeout_ticks - 1, limits.measurement_ticks - 1];
    let hold = config.hold_ticks - 1;
    let hard = text(limits.torque[0] / limits.slew_per_tick[0]);
    let soft = text(config.limits[0].torque / config.slew_per_tick[0]);
    let (range, effort) = (
        limits.highest[0] - arm.position.1,
        limits.effort[0] / arm.torque,
    );
    assert_eq!((text(effort), limits.torque[0]), ("3".into(), arm.torque));
    let speed = format!(
        "{} times",
        text(limits.step_per_tick[0] * 1e3 / arm.velocity)
    );
    let jump = format!("{} rad that a faster motion", text(limits.jump_margin));
    assert_eq!(limits.brake_ticks, 0);
    assert_eq!(limits.with_brake(20_000, 1000).brake_ticks, 21);
    let overdue = (limits.temperature_ticks - 1) / 1000;
    let near = format!("more than {} rad", text(ARM_DISTANCE));
    let rows: &[(&str, &[String])] = &[
        (
            "| 2 | `RampDown` |",
            &[format!("{hard} ms from the torque limit")],
        ),
        ("| torque |", &["the arm's torque limit".into()]),
        (
            "| slew |",
            &[
                format!("the torque limit in {hard} ms, counted"),
                format!("is the torque limit in {soft} ms"),
            ],
        ),
        (
            "| motor temperature |",
            &[
                format!("from {WARM_C} °C to nothing at {HOT_C} °C"),
                format!("counts as {HYSTERESIS_C} °C warmer"),
                format!("for {overdue} to {} s counts as 85 °C", 2 * overdue),
                "outside −40 to 125 °C".into(),
            ],
        ),
        (
            "| position measured |",
            &[
                format!("and {} rad;", text(range)),
                speed.clone(),
                jump.clone(),
            ],
        ),
        ("| position desired |", &[speed, jump]),
        (
            "| following error |",
            &[format!("{timeout} ms of samples"), near.clone()],
        ),
        ("| effort measured |", &["three torque limits".into()]),
        (
            "| age |",
            &[
                format!("{timeout} ms without a usable sample"),
                format!("{measured} ms without a plausible measurement"),
            ],
        ),
        (
            &format!("| 0 to {hold} ms |"),
            &["the torque is held".into()],
        ),
        (
            &format!("| from {hold} ms |"),
            &[format!("{soft} ms from the torque limit")],
        ),
        (
            &format!("| {timeout} ms |"),
            &["the board leaves `Armed`".into()],
        ),
        (
            "| 2 | `CommandTimeout` |",
            &[format!("{timeout} ms without a usable sample")],
        ),
        ("| 10 | `MotorWarm` |", &[format!("above {WARM_C} °C")]),
        (
            "| 11 | `MotorHot` |",
            &[
                format!("{HOT_C} °C or more"),
                format!("below {} °C", HOT_C - HYSTERESIS_C),
            ],
        ),
        ("| 15 | `NoSample` |", &["fewer than three".into()]),
        ("| 16 | `TooFar` |", std::slice::from_ref(&near)),
        (
            "| 20 | `MeasurementTimeout` |",
            &[format!("{measured} ms without a plausible measurement")],
        ),
        (
            "| 21 | `FollowingError` |",
            &[format!("{timeout} ms of samples"), near.clone()],
        ),
    ];
    assert_eq!(ARM_SAMPLES, 3);
    for (cells, texts) in rows {
        let row = PAGE.lines().find(|line| line.starts_with(cells));
        let row = row.unwrap_or_else(|| panic!("docs/safety.md has no row `{cells}`"));
        for text in *texts {
            assert!(row.contains(text), "{row}\nhas no `{text}`");
        }
    }
}

#[test]
fn torque_and_enable_of_every_state_are_those_of_its_row() {
    let mut falling = armed();
    // More than one period falls for the weak joints.
    falling.release(&torque(14.0));
    falling.disarm();
    let mut fault = armed();
    fault.torque_off(SafetyReason::Stopped);
    for mut safety in [ready(), armed(), falling, fault] {
        let state = safety.status().state;
        let cells = format!("| {} | `{state:?}` |", state as u8);
        let row = PAGE.lines().find(|line| line.starts_with(&cells)).unwrap();
        let columns: Vec<_> = row.split('|').map(str::trim).collect();
        assert_eq!(columns[4], if safety.enabled() { "on" } else { "off" });
        let before = safety.output().sum();
        let torque = tick(&mut safety, Some(sample())).sum();
        let (kind, _) = columns[3].split_once([' ', ';', ',']).unwrap();
        let holds = match kind {
            "zero" => torque == 0.0,
            "that" => torque == 5.0 * N as f32,
            "falls" => torque < before,
            other => panic!("`{other}` has no test"),
        };
        assert!(holds, "{row}: {torque}");
    }
}

/// A sample of number `k` that is implausible for `reason`, and the fault of the board's sensor with it.
fn implausible(reason: SafetyReason, k: u32) -> (JointSample<N>, SafetyReason) {
    match reason {
        SafetyReason::DesiredNotFinite => (changed(|s| s.desired.qd[0] = f32::NAN), NO_FAULT),
        SafetyReason::DesiredJump => (changed(|s| s.desired.q[0] += (k % 2) as f32), NO_FAULT),
        sensor => (sample(), sensor),
    }
}

#[test]
fn every_reason_of_the_page_ends_the_torque_as_its_row_has_it() {
    for reason in SafetyReason::ALL {
        let cells = format!("| {} | `{reason:?}` |", reason.code());
        let row = PAGE.lines().find(|line| line.starts_with(&cells));
        let column = row.unwrap().split('|').nth(4).unwrap().trim();
        let mut safety = armed();
        match column {
            // No torque yet, or one that goes on.
            "" | "none yet" | "limit reduced" => continue,
            "off at once, latches" => safety.torque_off(reason),
            "ramps to zero, latches" => safety.trip(reason),
            "ramps to zero" => safety.end(reason),
            "off, latched at start" | "off; cannot be cleared" => {
                safety = Safety::new(limits(), reason);
            }
            "continues, latches if it lasts" | "held, latches if it lasts" => {
                for k in 1..=limits().timeout_ticks {
                    assert_eq!(safety.status().state, SafetyState::Armed, "{reason:?}");
                    let (sample, sensor) = implausible(reason, k);
                    safety.period();
                    safety.admit(Some(sample), 1, sensor);
                }
            }
            other => panic!("{reason:?}: `{other}` has no test"),
        }
        assert_eq!(safety.enabled(), !column.starts_with("off"), "{reason:?}");
        let latches = column != "ramps to zero";
        let latched = if latches { reason } else { NO_FAULT };
        assert_eq!(safety.latched(), latched, "{reason:?}");
        assert_eq!(safety.status().reason, reason);
    }
}
