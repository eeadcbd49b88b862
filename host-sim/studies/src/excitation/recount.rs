//! Limits counted again, by code that shares nothing with the search and its certificate but the description.

use foretorque_workbench::dynamics::RigidBodies;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::robot::{Placement, Robot, segment_distance};
use nalgebra::{Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// Result of a recount.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recount {
    /// Instants that were looked at.
    pub points: u32,
    /// Limits missed: position, velocity, acceleration, torque, table, distance of links.
    pub violations: u64,
    /// Velocities, accelerations and torques beyond the certificate's worst.
    pub beyond_certificate: u64,
}

/// Counts violated limits at `points` instants of a period; `None` when the excitation carries no certificate of this
/// robot.
///
/// * `range_rad` range of every joint around zero that the excitation was made for
pub fn recount(
    robot: &Robot,
    excitation: &Excitation,
    range_rad: f64,
    points: u32,
) -> Option<Recount> {
    let model = RigidBodies::new(robot);
    let certificate = excitation.certificate.as_deref()?;
    let worst = |limit: &str, of: &str| {
        let mut checks = certificate.limits.iter();
        let check = checks.find(|check| check.limit == limit && check.of == of);
        check.map(|check| check.worst)
    };
    let peaks: Vec<[f64; 3]> = robot
        .joints
        .iter()
        .map(|joint| {
            let of = |limit| worst(limit, &joint.name);
            Some([of("velocity")?, of("acceleration")?, of("torque")?])
        })
        .collect::<Option<_>>()?;
    let clear = robot.workspace.clearance;
    let (mut violations, mut beyond) = (0, 0);
    for k in 0..points {
        let state = excitation.motion(excitation.period_s * f64::from(k) / f64::from(points));
        let rigid = model.inverse_dynamics(&state);
        let mut expect = |kept: bool| violations += u64::from(!kept);
        for (j, joint) in robot.joints.iter().enumerate() {
            let limits = &joint.limits;
            let friction = joint.friction.viscous * state.qd[j]
                + joint.friction.coulomb * state.qd[j].signum();
            let tau = (rigid[j] + friction).abs();
            expect(state.q[j].abs() <= range_rad);
            expect((limits.position.0..=limits.position.1).contains(&state.q[j]));
            expect(state.qd[j].abs() <= limits.velocity);
            expect(state.qdd[j].abs() <= limits.acceleration);
            expect(tau <= limits.torque);
            let seen = [state.qd[j].abs(), state.qdd[j].abs(), tau];
            let over = seen
                .iter()
                .zip(&peaks[j])
                .filter(|(seen, peak)| seen > peak);
            beyond += over.count() as u64;
        }
        let links = placed(robot, &state.q);
        for (outer, capsules) in links.iter().enumerate() {
            for (ends, radius) in capsules {
                let lowest = ends[0].z.min(ends[1].z) - radius;
                let table = robot.workspace.table_height;
                expect(outer == 0 || table.is_none_or(|table| lowest >= table + clear));
                for (other, width) in links.iter().take(outer.saturating_sub(1)).flatten() {
                    expect(segment_distance(ends, other) - radius - width >= clear);
                }
            }
        }
    }
    Some(Recount {
        points,
        violations,
        beyond_certificate: beyond,
    })
}

/// Ends of all capsules in the base frame, and their radii, link by link.
fn placed(robot: &Robot, q: &[f64]) -> Vec<Vec<([Vector3<f64>; 2], f64)>> {
    let mut frame = Placement::identity();
    let links = robot.joints.iter().zip(q.iter()).map(|(joint, q)| {
        frame = frame.then(&joint.placement);
        frame.rot_parent_child *= Rotation3::from_axis_angle(&Vector3::z_axis(), *q).matrix();
        let at = |end: Vector3<f64>| frame.origin + frame.rot_parent_child * end;
        let capsules = joint.capsules.iter();
        capsules
            .map(|capsule| (capsule.ends.map(at), capsule.radius))
            .collect()
    });
    links.collect()
}
