//! Logs as a stream: one thread reads, all cores prepare, and stretches come out in the order of the log.

use super::clock::GAP_PERIODS;
use super::columns::Layout;
use super::log::LogRow;
use super::prepare::{Preparation, PrepareConfig, Prepared, Stretch};
use super::whole_log::WholeLog;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use crate::table::TableError;
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};

/// Rows of one stretch, margins apart. Large against the margins, small enough for a few of them in memory.
const STRETCH: usize = 16_384;

/// Prepares a log stretch by stretch on all cores and passes every stretch to `take` in the order of the log, so that sums
/// are the same in every run. Memory does not grow with the log.
///
/// * `notes` receives derived columns and gaps
///
/// Errors: [`TableError`] of the first bad row, perhaps after some stretches.
pub fn for_each_prepared(
    path: &Path,
    robot: &Robot,
    layout: &Layout,
    config: &PrepareConfig,
    notes: &mut Vec<String>,
    take: &mut dyn FnMut(&Preparation, Prepared),
) -> Result<Preparation, TableError> {
    let mut log = WholeLog::open(path, robot)?;
    let preparation = Preparation::of_log(&log, config, path, notes);
    let (workers, cut) = (cores(), &preparation);
    std::thread::scope(|scope| {
        let (to_workers, stretches) = sync_channel::<Stretch>(workers);
        let reading = scope.spawn(move || cut_into_stretches(&mut log, cut, path, &to_workers));
        loop {
            let batch: Vec<Stretch> = stretches.iter().take(workers).collect();
            if batch.is_empty() {
                break;
            }
            let prepare = |stretch: &Stretch| Prepared::new(stretch, cut, layout);
            for prepared in in_parallel(workers, &batch, prepare, || ()) {
                take(cut, prepared);
            }
        }
        match reading.join() {
            Ok(outcome) => notes.extend(outcome?),
            Err(panic) => std::panic::resume_unwind(panic),
        }
        Ok::<_, TableError>(())
    })?;
    Ok(preparation)
}

/// Sends the log to the workers in stretches with margins; returns notes on gaps and lost rows.
fn cut_into_stretches(
    log: &mut WholeLog,
    preparation: &Preparation,
    path: &Path,
    to_workers: &SyncSender<Stretch>,
) -> Result<Vec<String>, TableError> {
    let (mut notes, name) = (Vec::new(), path.display());
    let (margin, edge) = (preparation.margin(), preparation.edge());
    // Rows not yet sent with the margin before them; `begin` is where the unsent core starts.
    let mut rows: Vec<LogRow> = Vec::new();
    let mut begin = edge;
    let send = |rows: Vec<LogRow>, core: std::ops::Range<usize>| {
        // The receiver is gone only when a worker has panicked, which the scope reports.
        let _ = to_workers.send(Stretch { rows, core });
    };
    loop {
        let row = log.next_row()?;
        let pair = row.as_ref().zip(rows.last());
        let step = pair.map_or(0.0, |(row, last)| row.t_s - last.t_s);
        let gap = step > GAP_PERIODS * preparation.period_s;
        if let (true, Some(row)) = (gap, &row) {
            notes.push(format!(
                "{name}:{}: column t_s: gap of {step:.4} s, more than {GAP_PERIODS} periods: split here",
                row.line
            ));
        }
        if gap || row.is_none() {
            let end = rows.len().saturating_sub(edge);
            let rows = std::mem::take(&mut rows);
            if begin < end {
                send(rows, begin..end);
            }
            begin = edge;
        } else if rows.len() >= begin + STRETCH + margin {
            let end = begin + STRETCH;
            let keep = end.saturating_sub(margin);
            let rest = rows[keep..].to_vec();
            send(std::mem::replace(&mut rows, rest), begin..end);
            begin = end - keep;
        }
        match row {
            Some(row) => rows.push(row),
            None => break,
        }
    }
    notes.extend(log.reader.wraps());
    if log.lost > 0 {
        notes.push(format!(
            "{name}: {} rows are missing according to its clock and were interpolated",
            log.lost
        ));
    }
    Ok(notes)
}
