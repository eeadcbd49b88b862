//! Columns of a log that its motion is taken from.

use super::prepare::{MotionSource, Preparation, PrepareConfig};
use super::whole_log::{GAP_PERIODS, WholeLog};
use crate::dynamics::State;
use std::path::Path;

/// Rows in a period of the motion's cut-off from which derivatives of the positions are believed before logged ones.
const MOTION_ROWS: f64 = 8.0;
/// Logged velocities farther than this share of their RMS from the derivative of the positions are set-points.
const VELOCITY_TRUST: f64 = 0.01;
/// Share for accelerations, which differentiation knows less well.
const ACCELERATION_TRUST: f64 = 0.03;

/// Period and sources of motion of a log, from its first rows.
pub(super) fn choose<const N: usize>(
    log: &WholeLog<N>,
    config: &PrepareConfig,
    path: &Path,
    notes: &mut Vec<String>,
) -> Preparation {
    let (preview, reader, period_s) = (log.preview(), log.reader(), log.period_s());
    let name = path.display();
    if reader.from_current() {
        notes.push(format!("{name}: torque is drive gain × motor current"));
    }
    // Up to the first gap: derivatives across it would be wrong.
    let whole = preview
        .windows(2)
        .position(|pair| pair[1].t_s - pair[0].t_s > GAP_PERIODS * period_s);
    let preview = &preview[..whole.map_or(preview.len(), |row| row + 1)];
    let start_s = preview.first().map_or(0.0, |row| row.t_s);
    let at = |velocity, acceleration| {
        Preparation::new(config, start_s, period_s, velocity, acceleration)
    };
    let derived = at(MotionSource::Derived, MotionSource::Derived);
    let distance =
        |a: &[State<N>], b: &[State<N>], of: fn(&State<N>) -> &nalgebra::SVector<f64, N>| {
            let edge = derived.edge().min(a.len() / 3);
            let inner = edge..a.len() - edge;
            let (mut error, mut size) = (0.0, 0.0);
            for row in inner {
                error += (of(&a[row]) - of(&b[row])).norm_squared();
                size += of(&b[row]).norm_squared();
            }
            (error / f64::max(size, f64::MIN_POSITIVE)).sqrt()
        };
    let from_positions = derived.motion(preview);
    let mut source = |there: bool,
                      what: &str,
                      trust: f64,
                      logged: Preparation,
                      base: &[State<N>],
                      of: fn(&State<N>) -> &nalgebra::SVector<f64, N>| {
        if !there {
            notes.push(format!(
                "{name}: no {what}, derived by central differences of the filtered motion"
            ));
            return MotionSource::Derived;
        }
        // Columns somebody mapped are measurements; the project's own may be set-points beside measured positions, and went
        // through a filter that nobody knows: where positions come often enough, what is derived from them is nearer to
        // the torque, whose filter is known.
        if !reader.is_mapped() && MOTION_ROWS * config.motion_hz * period_s <= 1.0 {
            notes.push(format!(
                "{name}: {what} derived from the positions, which come every {:.1} ms; the log's own have another filter",
                1e3 * period_s
            ));
            return MotionSource::Derived;
        }
        let apart = distance(&logged.motion(preview), base, of);
        if reader.is_mapped() || apart <= trust {
            return MotionSource::Logged;
        }
        notes.push(format!(
            "{name}: logged {what} are {:.1} % of their RMS off the derivative of the positions, taken for set-points; derived instead",
            100.0 * apart
        ));
        MotionSource::Derived
    };
    let velocity = source(
        reader.has_velocity(),
        "velocities",
        VELOCITY_TRUST,
        at(MotionSource::Logged, MotionSource::Derived),
        &from_positions,
        |state| &state.qd,
    );
    let from_velocities = at(velocity, MotionSource::Derived).motion(preview);
    let acceleration = source(
        reader.has_acceleration(),
        "accelerations",
        ACCELERATION_TRUST,
        at(velocity, MotionSource::Logged),
        &from_velocities,
        |state| &state.qdd,
    );
    at(velocity, acceleration)
}
