//! Drive gains from standstill: the motors hold the gravity torque.

use super::error::IdentifyError;
use super::log::LogReader;
use super::record::GainRecord;
use crate::dynamics::{Joints, ReferenceModel};
use crate::robot::Robot;
use std::path::PathBuf;

/// The arm must stand this long, s, and a stand is cut when it has lasted ten times as long.
const STAND_S: f64 = 0.2;
/// Fewest stands.
const FEWEST: usize = 3;
/// Largest relative deviation of a gain that is used.
const LARGEST_DEVIATION: f64 = 0.1;

/// Sums over one stand.
struct Stand<const N: usize> {
    from_s: f64,
    q: Joints<N>,
    current: Joints<N>,
    rows: f64,
}

/// Gains (N·m/A) that make the mean current of every stand the gravity torque of the description, by least squares of the
/// currents over the torques: stiction lies in the current. Where too few stands show too little gravity, or stiction
/// scatters it by more than a tenth, the description's gain stays.
///
/// Errors: of the logs; a log without currents; another number of joints.
pub(super) fn standstill_gains<const N: usize>(
    robot: &Robot,
    logs: &[PathBuf],
    still_rad_s: f64,
) -> Result<Vec<GainRecord>, IdentifyError> {
    let model = ReferenceModel::<N>::new(robot)
        .ok_or_else(|| IdentifyError::Joints(robot.name.clone(), N))?;
    // Gravity torque and mean current of each stand.
    let mut stands: Vec<(Joints<N>, Joints<N>)> = Vec::new();
    let gain = Joints::<N>::from_iterator(robot.joints.iter().map(|joint| joint.drive.gain));
    for path in logs {
        let mut reader = LogReader::<N>::open(path, robot)?;
        if !reader.from_current() {
            return Err(IdentifyError::NoCurrents(path.clone()));
        }
        let mut stand: Option<Stand<N>> = None;
        loop {
            let row = reader.next_row()?;
            let stands_still = row.as_ref().is_some_and(|row| match &stand {
                _ if reader.has_velocity() => row.qd.iter().all(|qd| qd.abs() <= still_rad_s),
                Some(stand) => {
                    let apart = Joints::from(row.q) - stand.q / stand.rows;
                    apart.amax() <= still_rad_s * STAND_S
                }
                None => true,
            });
            let long = |stand: &Stand<N>| {
                row.as_ref()
                    .is_some_and(|row| row.t_s - stand.from_s > 10.0 * STAND_S)
            };
            if (!stands_still || stand.as_ref().is_some_and(long))
                && let Some(stand) = stand.take_if(|_| true)
                && stand.rows > 1.0
            {
                let lasted = row
                    .as_ref()
                    .map_or(f64::INFINITY, |row| row.t_s - stand.from_s);
                if lasted >= STAND_S {
                    let gravity = model.gravity_torques(&(stand.q / stand.rows));
                    stands.push((gravity, stand.current / stand.rows));
                }
            }
            let Some(row) = row else { break };
            if stands_still {
                let place = stand.get_or_insert_with(|| Stand {
                    from_s: row.t_s,
                    q: Joints::zeros(),
                    current: Joints::zeros(),
                    rows: 0.0,
                });
                place.q += Joints::from(row.q);
                place.current += Joints::from(row.tau).component_div(&gain);
                place.rows += 1.0;
            }
        }
    }
    Ok((0..N)
        .map(|joint| {
            let pairs = || stands.iter().map(|(g, i)| (g[joint], i[joint]));
            let power: f64 = pairs().map(|(g, _)| g * g).sum();
            let inverse = pairs().map(|(g, i)| g * i).sum::<f64>() / power;
            let rest: f64 = pairs().map(|(g, i)| (i - g * inverse).powi(2)).sum();
            let count = stands.len();
            let deviation = (rest / (count.max(2) - 1) as f64 / power).sqrt() / inverse;
            let known = count >= FEWEST && inverse > 0.0 && deviation < LARGEST_DEVIATION;
            GainRecord {
                gain_nm_a: if known { 1.0 / inverse } else { gain[joint] },
                std_nm_a: known.then(|| deviation / inverse),
                description_nm_a: gain[joint],
                stands: count,
            }
        })
        .collect())
}
