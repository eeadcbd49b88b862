//! The logs as the board meets them, row by row, and what batch least squares on the other paths says of them.

use super::record::{GATE_RAD_S, N};
use crate::real_ur5::{PATHS, columns};
use crate::{Progress, StudyError};
use foretorque::joint::JointMeasurement;
use foretorque_workbench::dynamics::State;
use foretorque_workbench::identification::{
    ColumnSet, IdentifyConfig, IdentifyError, Layout, MethodName, Preparation, PrepareConfig,
    Prepared, WholeLog, for_each_prepared, identify,
};
use foretorque_workbench::robot::Robot;
use std::path::{Path, PathBuf};

/// The friction columns of the reference.
pub(super) const RICH: &str = "coulomb-viscous+offset+stribeck+sqrt+load";

/// Filters of the reference and of the figures, as published for these logs.
const PREPARE: PrepareConfig = PrepareConfig {
    motion_hz: 20.0,
    torque_hz: Some(10.0),
    still_rad_s: GATE_RAD_S,
};

/// One row of a log.
pub(super) struct Row {
    /// As the drives reported it, unfiltered.
    pub(super) measured: JointMeasurement<N>,
    /// Motion, filtered forwards and backwards: what the figures are taken of.
    pub(super) state: State<N>,
    /// Torque through the same filter, N·m.
    pub(super) tau: [f64; N],
    /// Torques of plain and rich batch least squares on the other paths, N·m, through the same filter.
    pub(super) batch: [[f64; N]; 2],
}

/// A stretch of a log without a gap.
pub(super) struct Stretch {
    /// Which path it is of.
    pub(super) path: usize,
    pub(super) rows: Vec<Row>,
    pub(super) preparation: Preparation,
}

/// All logs in the order of [`PATHS`].
///
/// Errors: a log is missing or damaged; an identification fails.
pub(super) fn read(
    directory: &Path,
    robot: &Robot,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Vec<Stretch>, StudyError> {
    let mut stretches = Vec::new();
    for (number, (name, files)) in PATHS.iter().enumerate() {
        progress("path held out", number, PATHS.len());
        let others = PATHS.iter().filter(|(other, _)| other != name);
        let training: Vec<PathBuf> = others
            .flat_map(|(_, files)| files.iter().map(|file| directory.join(file)))
            .collect();
        let held_out: Vec<PathBuf> = files.iter().map(|file| directory.join(file)).collect();
        let mut found: [Vec<Vec<[f64; N]>>; 2] = Default::default();
        let mut prepared = Vec::new();
        for (text, found) in ["coulomb-viscous", RICH].iter().zip(&mut found) {
            let columns = columns(text)?;
            let layout = Layout::<N>::new(robot, &columns).ok_or(StudyError::Joints(N))?;
            let theta = batch(robot, &training, &held_out[..1], columns, seed)?;
            prepared.clear();
            for file in &held_out {
                for_each_prepared(
                    file,
                    robot,
                    &layout,
                    &PREPARE,
                    &mut Vec::new(),
                    &mut |preparation, stretch| {
                        found.push(predictions(&layout, &theta, &stretch));
                        prepared.push((file.clone(), preparation.clone(), stretch));
                    },
                )?;
            }
        }
        for (k, (file, preparation, stretch)) in prepared.into_iter().enumerate() {
            let raw = raw_rows(&file, robot)?;
            let rows = stretch.core.clone().filter_map(|row| {
                let t_s = stretch.t_s[row];
                let place = raw.partition_point(|(raw_s, _)| *raw_s < t_s);
                let measured = raw.get(place)?.1;
                Some(Row {
                    measured,
                    state: stretch.states[row],
                    tau: std::array::from_fn(|joint| stretch.tau[row * N + joint]),
                    batch: [found[0][k][row], found[1][k][row]],
                })
            });
            stretches.push(Stretch {
                path: number,
                rows: rows.collect(),
                preparation,
            });
        }
    }
    Ok(stretches)
}

/// Weighted least squares over the training logs: one value a parameter.
fn batch(
    robot: &Robot,
    training: &[PathBuf],
    held_out: &[PathBuf],
    columns: ColumnSet,
    seed: u64,
) -> Result<Vec<f64>, StudyError> {
    let config = IdentifyConfig {
        methods: vec![MethodName::Wls],
        columns,
        prepare: PREPARE,
        seed,
        fold_period_s: None,
        gains_from_standstill: false,
        truth: None,
    };
    let outcome = identify::<N>(robot, training, held_out, &config, &|_| ())?;
    let record = outcome.report.methods.get(&MethodName::Wls.to_string());
    let parameters = record.ok_or(IdentifyError::Unsolvable)?.parameters.iter();
    Ok(parameters.map(|parameter| parameter.value).collect())
}

/// Torques of `theta` in every row of a stretch, N·m; the columns are filtered already.
fn predictions(layout: &Layout<N>, theta: &[f64], stretch: &Prepared<N>) -> Vec<[f64; N]> {
    let rows = stretch.panel.chunks_exact(layout.width);
    rows.map(|row| {
        std::array::from_fn(|joint| {
            let columns = row[layout.offset[joint]..].iter();
            let active = layout.active[joint].iter();
            columns
                .zip(active)
                .map(|(x, &place)| x * theta[place])
                .sum()
        })
    })
    .collect()
}

/// Time and measurement of every row.
fn raw_rows(file: &Path, robot: &Robot) -> Result<Vec<(f64, JointMeasurement<N>)>, StudyError> {
    let mut log = WholeLog::<N>::open(file, robot)?;
    let mut rows = Vec::new();
    while let Some(row) = log.next_row()? {
        let measured = JointMeasurement {
            q: row.q.map(|q| q as f32).into(),
            tau: row.tau.map(|tau| tau as f32).into(),
        };
        rows.push((row.t_s, measured));
    }
    Ok(rows)
}
