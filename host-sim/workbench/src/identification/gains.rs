//! Drive gains from standstill: the motors hold the gravity torque.

use super::log::LogReader;
use super::record::GainRecord;
use super::{IdentifyError, joined, refused};
use crate::Refusal;
use crate::dynamics::{PerJoint, RigidBodies};
use crate::robot::{Joint, Robot};
use crate::table::TableError;
use std::path::PathBuf;

/// The arm must stand this long, s, and a stand is cut when it has lasted ten times as long: the arm may creep. A part at the
/// pose of the part before is no stand of its own.
const STAND_S: f64 = 0.2;
const FEWEST: usize = 3;
/// Largest relative deviation of a gain that is used.
const LARGEST_DEVIATION: f64 = 0.1;

/// Sums over one stand.
struct Stand {
    from_s: f64,
    to_s: f64,
    q: PerJoint<f64>,
    current: PerJoint<f64>,
    rows: f64,
}

impl Stand {
    /// Mean position within `reach` of `q` at every joint, rad.
    fn is_at(&self, q: &PerJoint<f64>, reach: f64) -> bool {
        let mut pairs = self.q.iter().zip(q.iter());
        pairs.all(|(sum, q)| (q - sum / self.rows).abs() <= reach)
    }

    /// Adds `rows` rows with these sums.
    fn add(&mut self, q: &PerJoint<f64>, current: &PerJoint<f64>, rows: f64) {
        for (sums, more) in [(&mut self.q, q), (&mut self.current, current)] {
            let pairs = sums.iter_mut().zip(more.iter());
            pairs.for_each(|(sum, more)| *sum += more);
        }
        self.rows += rows;
    }
}

/// The robot with drive gains from standstill, and their records.
///
/// Gains (N·m/A) that make the mean current of every stand the gravity torque of the description, by least squares of the
/// currents over the torques: stiction lies in the current. The description's gain stays where too few stands show too
/// little gravity, or stiction scatters it by more than a tenth.
///
/// Errors: of the logs; a log without currents; a gain that neither standstill nor the description gives.
pub fn with_gains(
    robot: &Robot,
    logs: &[PathBuf],
    still_rad_s: f64,
) -> Result<(Robot, Vec<GainRecord>), IdentifyError> {
    let model = RigidBodies::new(robot);
    let mut stands: Vec<Stand> = Vec::new();
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
        add_stands(&mut reader, model.joints(), still_rad_s, &mut stands)?;
    }
    // Gravity torque and mean current of each stand.
    let means = stands.iter().map(|stand| {
        let [q, current] = [stand.q, stand.current].map(|sum| sum.map(|sum| sum / stand.rows));
        (model.gravity_torques(&q), current)
    });
    let stands: Vec<(PerJoint<f64>, PerJoint<f64>)> = means.collect();
    let mut found = robot.clone();
    let record = |(joint, own): (usize, &mut Joint)| {
        let pairs = || stands.iter().map(|(g, i)| (g[joint], i[joint]));
        let power: f64 = pairs().map(|(g, _)| g * g).sum();
        let inverse = pairs().map(|(g, i)| g * i).sum::<f64>() / power;
        let rest: f64 = pairs().map(|(g, i)| (i - g * inverse).powi(2)).sum();
        let count = stands.len();
        let deviation = (rest / (count.max(2) - 1) as f64 / power).sqrt() / inverse;
        let known = count >= FEWEST && inverse > 0.0 && deviation < LARGEST_DEVIATION;
        let described = own.drive.gain;
        own.drive.gain = known.then(|| 1.0 / inverse).or(described);
        let number = joint + 1;
        let unknown = || {
            let problem = format!(
                "standstill does not show the gain of joint {number}: give --drive-gains, or a log that stands still in {FEWEST} poses at least"
            );
            Refusal::of(joined(logs), problem)
        };
        Ok(GainRecord {
            gain_nm_a: own.drive.gain.ok_or_else(unknown)?,
            std_nm_a: known.then(|| deviation / inverse),
            description_nm_a: described,
            stands: count,
        })
    };
    let records = found.joints.iter_mut().enumerate().map(record);
    let records = records.collect::<Result<_, Refusal>>()?;
    Ok((found, records))
}

/// Adds every stand of a log that lasts long enough to `stands`, or to the last of them at the same pose.
fn add_stands(
    reader: &mut LogReader,
    joints: usize,
    still_rad_s: f64,
    stands: &mut Vec<Stand>,
) -> Result<(), TableError> {
    let reach = still_rad_s * STAND_S;
    let mut stand: Option<Stand> = None;
    loop {
        let row = reader.next_row()?;
        // Velocities that are always zero show no stand: the positions have to agree.
        let still = row.as_ref().is_some_and(|row| {
            let slow = row.qd.iter().all(|qd| qd.abs() <= still_rad_s);
            slow && stand
                .as_ref()
                .is_none_or(|stand| stand.is_at(&row.q, reach))
        });
        let now_s = row.as_ref().map_or(f64::INFINITY, |row| row.t_s);
        let ends = |stand: &mut Stand| !still || now_s - stand.from_s > 10.0 * STAND_S;
        if let Some(stand) = stand.take_if(ends)
            && stand.rows > 1.0
            && stand.to_s - stand.from_s >= STAND_S
        {
            let mean = stand.q.map(|sum| sum / stand.rows);
            match stands.last_mut().filter(|last| last.is_at(&mean, reach)) {
                Some(last) => last.add(&stand.q, &stand.current, stand.rows),
                None => stands.push(stand),
            }
        }
        let Some(row) = row else { return Ok(()) };
        if still {
            let stand = stand.get_or_insert_with(|| Stand {
                from_s: row.t_s,
                to_s: row.t_s,
                q: PerJoint::repeat(joints, 0.0),
                current: PerJoint::repeat(joints, 0.0),
                rows: 0.0,
            });
            stand.add(&row.q, &row.tau, 1.0);
            stand.to_s = row.t_s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::log_tests::{first_joints, log_of};
    use super::*;

    /// Gain of joint 2 of a UR5 by a log of -1 A there whose angle is `q` at a time, with and without velocities.
    fn found(seconds: u32, q: fn(f64) -> f64) -> [GainRecord; 2] {
        let robot = first_joints(2);
        [true, false].map(|has_velocities| {
            let velocities = if has_velocities {
                ",qd1_rad_s,qd2_rad_s"
            } else {
                ""
            };
            let rows = (0..100 * seconds).map(|k| {
                let t_s = 0.01 * f64::from(k);
                let qd = 100.0 * (q(t_s + 0.01) - q(t_s));
                let row = [t_s, 0.0, q(t_s), 0.0, -1.0, 0.0, qd];
                row[..if has_velocities { 7 } else { 5 }].to_vec()
            });
            let (_here, path) = log_of(&format!("t_s,q1_rad,q2_rad,i1_a,i2_a{velocities}"), rows);
            with_gains(&robot, &[path], 0.05).expect("a log").1[1]
        })
    }

    #[test]
    fn the_end_of_a_log_is_no_stand() {
        for gain in found(1, |t_s| t_s) {
            assert_eq!(gain.stands, 0);
        }
    }

    #[test]
    fn velocities_of_zero_and_gaps_make_no_stand() {
        let of = |header: &str, row: &dyn Fn(u32) -> Vec<f64>| {
            let (_here, path) = log_of(header, (0..400).map(row));
            let (_, records) = with_gains(&first_joints(1), &[path], 0.05).expect("a log");
            records[0].stands
        };
        let t_s = |k: u32| 0.01 * f64::from(k);
        let zero = |k| vec![t_s(k), t_s(k), 1.0, 0.0];
        assert_eq!(of("t_s,q1_rad,i1_a,qd1_rad_s", &zero), 0);
        let gaps = |k| vec![t_s(k) + 0.3 * f64::from(k / 40), t_s(k), 1.0];
        assert_eq!(of("t_s,q1_rad,i1_a", &gaps), 0);
    }

    #[test]
    fn a_long_rest_in_one_pose_is_one_stand() {
        for gain in found(10, |_| 0.3) {
            assert_eq!((gain.stands, gain.std_nm_a), (1, None));
        }
        // Four poses of 2.5 s, each of them more than one part.
        for gain in found(10, |t_s| 0.3 + 0.1 * (t_s / 2.5).floor()) {
            assert_eq!(gain.stands, 4);
            assert!(gain.std_nm_a.is_some());
        }
    }
}
