use super::boards::BoardChoice;
use super::terminal::{SignalGuard, show};
use super::{Failure, positive, unusable};
use clap::Args;
use foretorque_workbench::board::Transport;
use foretorque_workbench::board::serial::{self, Serial};
use foretorque_workbench::files::at;
use foretorque_workbench::overheard::Overheard;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Record the telemetry of a board that another host drives, into CSV and MCAP; nothing is sent
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// serial:PORT of an adapter whose RX is on the board's TX, too
    #[arg(long)]
    board: BoardChoice,
    /// Period of the board, ms; a hello on the line replaces it
    #[arg(long, value_name = "MS", default_value_t = 1.0, value_parser = positive)]
    period_ms: f64,
    /// Record this long, s; without it until Ctrl-C
    #[arg(long, value_parser = positive)]
    duration_s: Option<f64>,
    /// Table of the records; the MCAP beside it has the same name
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Longest wait for bytes.
const WAIT: Duration = Duration::from_millis(50);

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let BoardChoice::Serial(port) = &arguments.board else {
        let board = &arguments.board;
        return Err(unusable(format!(
            "--board {board}: only the line of a board at serial:PORT can be read along"
        )));
    };
    let end = arguments.duration_s.map(Duration::try_from_secs_f64);
    let end = end.transpose()?.map(|duration| Instant::now() + duration);
    let mut line = Serial::open(port, serial::BAUD)?;
    let mut overheard = Overheard::new(&arguments.out, 1e-3 * arguments.period_ms);
    let named = |error| at(&arguments.out, error);
    let mut buffer = [0; 4096];
    let guard = SignalGuard::begin();
    let runs = || !guard.interrupted() && end.is_none_or(|end| Instant::now() < end);
    // A line that ends takes nothing away from what was recorded.
    let mut gone = None;
    while gone.is_none() && runs() {
        match line.receive(&mut buffer, WAIT) {
            Ok(count) => overheard.take(&buffer[..count]).map_err(named)?,
            Err(error) => gone = Some(error),
        }
    }
    let Some((records, torn)) = overheard.finish().map_err(named)? else {
        return Err(unusable(format!(
            "serial:{port}: no telemetry: the host of the board asks for it with Telemetry (docs/protocol.md)"
        )));
    };
    if let Some(error) = gone {
        show!("note: the line ended: {error}")?;
    }
    let out = arguments.out.display();
    show!("{records} records, {torn} left out with a part missing, {out}")
}
