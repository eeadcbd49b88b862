//! Drive gains from standstill: the motors hold the gravity torque.

use super::log::LogReader;
use super::record::GainRecord;
use super::{IdentifyError, refused};
use crate::Refusal;
use crate::dynamics::{PerJoint, RigidBodies};
use crate::robot::Robot;
use crate::table::TableError;
use std::path::PathBuf;

/// The arm must stand this long, s, and a stand is cut when it has lasted ten times as long.
const STAND_S: f64 = 0.2;
/// Fewest stands.
const FEWEST: usize = 3;
/// Largest relative deviation of a gain that is used.
const LARGEST_DEVIATION: f64 = 0.1;

/// Sums over one stand.
struct Stand {
    from_s: f64,
    q: PerJoint<f64>,
    current: PerJoint<f64>,
    rows: f64,
}

/// The robot with drive gains from standstill, and their records.
///
/// Errors: of the logs; a log without currents; a gain that neither standstill nor the description gives.
pub fn with_gains(
    robot: &Robot,
    logs: &[PathBuf],
    still_rad_s: f64,
) -> Result<(Robot, Vec<GainRecord>), IdentifyError> {
    let gains = standstill_gains(robot, logs, still_rad_s)?;
    if let Some(joint) = gains.iter().position(|own| own.gain_nm_a.is_none()) {
        let problem = format!(
            "standstill does not show the gain of joint {}: give --drive-gains, or a log that stands still in {FEWEST} poses at least",
            joint + 1
        );
        let names: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
        return Err(Refusal::of(names.join(", "), problem).into());
    }
    let mut robot = robot.clone();
    for (joint, record) in robot.joints.iter_mut().zip(&gains) {
        joint.drive.gain = record.gain_nm_a;
    }
    Ok((robot, gains))
}

/// Gains (N·m/A) that make the mean current of every stand the gravity torque of the description, by least squares of the
/// currents over the torques: stiction lies in the current. The description's gain stays where too few stands show too
/// little gravity, or stiction scatters it by more than a tenth.
///
/// Errors: of the logs; a log without currents.
fn standstill_gains(
    robot: &Robot,
    logs: &[PathBuf],
    still_rad_s: f64,
) -> Result<Vec<GainRecord>, IdentifyError> {
    let model = RigidBodies::new(robot);
    // Gravity torque and mean current of each stand.
    let mut stands: Vec<(PerJoint<f64>, PerJoint<f64>)> = Vec::new();
    // With gains of one a torque is a current.
    let mut plain = robot.clone();
    plain
        .joints
        .iter_mut()
        .for_each(|joint| joint.drive.gain = Some(1.0));
    for path in logs {
        let mut reader = LogReader::open(path, &plain)?;
        if !reader.has_currents {
            return Err(refused(path, "no motor currents to find drive gains from"));
        }
        for_each_stand(&mut reader, model.joints(), still_rad_s, |stand| {
            let mean = |sum: PerJoint<f64>| sum.map(|sum| sum / stand.rows);
            stands.push((model.gravity_torques(&mean(stand.q)), mean(stand.current)));
        })?;
    }
    let record = |joint: usize| {
        let pairs = || stands.iter().map(|(g, i)| (g[joint], i[joint]));
        let power: f64 = pairs().map(|(g, _)| g * g).sum();
        let inverse = pairs().map(|(g, i)| g * i).sum::<f64>() / power;
        let rest: f64 = pairs().map(|(g, i)| (i - g * inverse).powi(2)).sum();
        let count = stands.len();
        let deviation = (rest / (count.max(2) - 1) as f64 / power).sqrt() / inverse;
        let known = count >= FEWEST && inverse > 0.0 && deviation < LARGEST_DEVIATION;
        let described = robot.joints[joint].drive.gain;
        GainRecord {
            gain_nm_a: known.then(|| 1.0 / inverse).or(described),
            std_nm_a: known.then(|| deviation / inverse),
            description_nm_a: described,
            stands: count,
        }
    };
    Ok((0..model.joints()).map(record).collect())
}

/// Calls `take` with every stand of a log that lasts long enough.
fn for_each_stand(
    reader: &mut LogReader,
    joints: usize,
    still_rad_s: f64,
    mut take: impl FnMut(Stand),
) -> Result<(), TableError> {
    let mut stand: Option<Stand> = None;
    let mut last_s = 0.0;
    loop {
        let row = reader.next_row()?;
        let still = row.as_ref().is_some_and(|row| match &stand {
            _ if reader.has_velocity() => row.qd.iter().all(|qd| qd.abs() <= still_rad_s),
            Some(stand) => {
                let mut apart = row.q.iter().zip(stand.q.iter());
                apart.all(|(q, sum)| (q - sum / stand.rows).abs() <= still_rad_s * STAND_S)
            }
            None => true,
        });
        let end_s = row.as_ref().map_or(last_s, |row| row.t_s);
        last_s = end_s;
        let ends = |stand: &mut Stand| !still || end_s - stand.from_s > 10.0 * STAND_S;
        if let Some(stand) = stand.take_if(ends)
            && stand.rows > 1.0
            && end_s - stand.from_s >= STAND_S
        {
            take(stand);
        }
        let Some(row) = row else { return Ok(()) };
        if still {
            let stand = stand.get_or_insert_with(|| Stand {
                from_s: row.t_s,
                q: PerJoint::repeat(joints, 0.0),
                current: PerJoint::repeat(joints, 0.0),
                rows: 0.0,
            });
            for joint in 0..joints {
                stand.q[joint] += row.q[joint];
                stand.current[joint] += row.tau[joint];
            }
            stand.rows += 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    #[test]
    fn the_end_of_a_log_is_no_stand() {
        let mut robot = Robot::load("ur5").expect("built in");
        robot.joints.truncate(1);
        let mut text = "t_s,q1_rad,i1_a\n".to_owned();
        for k in 0..100 {
            let t_s = 0.01 * f64::from(k);
            writeln!(text, "{t_s},{t_s},1").expect("a string");
        }
        let here = tempfile::tempdir().expect("creates");
        let path = here.path().join("moves.csv");
        std::fs::write(&path, text).expect("writes");
        let gains = standstill_gains(&robot, &[path], 0.05).expect("a log");
        assert_eq!(gains[0].stands, 0);
    }
}
