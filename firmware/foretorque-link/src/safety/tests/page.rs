//! The tables of `docs/safety.md` against the code.

use super::*;
use foretorque::feedforward::FeedForwardConfig;

const PAGE: &str = include_str!("../../../../../docs/safety.md");

/// The row of the page that begins with `cells`.
fn row(cells: &str) -> &'static str {
    let row = PAGE.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/safety.md has no row `{cells}`"))
}

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
    let speed = text(limits.step_per_tick[0] * 1e3 / arm.velocity);
    let margin = text(JUMP_MARGIN);
    let jump = format!("{speed} times …, and {margin} rad that a faster motion");
    assert_eq!(limits.brake_ticks, 0);
    assert_eq!(limits.with_brake(20_000, 1000).brake_ticks, 21);
    let overdue = (limits.temperature_ticks - 1) / 1000;
    let (late, near) = (2 * overdue, text(ARM_DISTANCE));
    let cool = HOT_C - HYSTERESIS_C;
    // Beginning of a row and parts of it, in their order.
    let rows = [
        format!("| 2 | `RampDown` |…{hard} ms from the torque limit"),
        "| torque |…the arm's torque limit".into(),
        format!("| slew |…the torque limit in {hard} ms, counted…is the torque limit in {soft} ms"),
        format!("| motor temperature |…from {WARM_C} °C to nothing at {HOT_C} °C"),
        format!("| motor temperature |…counts as {HYSTERESIS_C} °C warmer"),
        format!("| motor temperature |…for {overdue} to {late} s counts as 85 °C"),
        "| motor temperature |…outside −40 to 125 °C".into(),
        format!("| position measured |…and {} rad;…{jump}", text(range)),
        format!("| position desired |…{jump}"),
        format!("| following error |…{timeout} ms of samples…more than {near} rad"),
        "| effort measured |…three torque limits".into(),
        format!("| age |…{timeout} ms without a usable sample"),
        format!("| age |…{measured} ms without a plausible measurement"),
        format!("| 0 to {hold} ms |…the torque is held"),
        format!("| from {hold} ms |…{soft} ms from the torque limit"),
        format!("| {timeout} ms |…the board leaves `Armed`"),
        format!("| 2 | `CommandTimeout` |…{timeout} ms without a usable sample"),
        format!("| 10 | `MotorWarm` |…above {WARM_C} °C"),
        format!("| 11 | `MotorHot` |…{HOT_C} °C or more…below {cool} °C"),
        "| 15 | `NoSample` |…fewer than three".into(),
        format!("| 16 | `TooFar` |…more than {near} rad"),
        format!("| 20 | `MeasurementTimeout` |…{measured} ms without a plausible measurement"),
        format!("| 21 | `FollowingError` |…{timeout} ms of samples…more than {near} rad"),
    ];
    assert_eq!(ARM_SAMPLES, 3);
    for wanted in &rows {
        let mut parts = wanted.split('…');
        let mut rest = row(parts.next().unwrap());
        for part in parts {
            let found = rest.split_once(part);
            rest = found
                .unwrap_or_else(|| panic!("`{wanted}` is not on the page"))
                .1;
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
        let row = row(&format!("| {} | `{state:?}` |", state as u8));
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
        let row = row(&format!("| {} | `{reason:?}` |", reason.code()));
        let column = row.split('|').nth(4).unwrap().trim();
        assert_eq!(reason.latches(), column.contains("latch"), "{row}");
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
