//! A board of this process on a pseudo-terminal.

use foretorque_workbench::board::Transport;
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// A board on a pseudo-terminal, until it goes out of scope.
pub(crate) struct PlayedBoard {
    pub(crate) port: String,
    done: Arc<AtomicBool>,
    player: Option<JoinHandle<()>>,
}

impl PlayedBoard {
    /// Lets `board` answer, every frame changed by `change` on its way to the host.
    pub(crate) fn start(
        mut board: impl Transport + Send + 'static,
        change: fn(&[u8]) -> Vec<u8>,
    ) -> Self {
        let (mut line, end) = TTYPort::pair().expect("the system has pseudo-terminals");
        let port = end.name().expect("it has a name");
        line.set_timeout(Duration::from_millis(5))
            .expect("it has a timeout");
        let done = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&done);
        let player = std::thread::spawn(move || {
            let mut buffer = [0; 1024];
            while !ended.load(Ordering::Relaxed) {
                // Nothing received, or no process at the other end yet.
                let Ok(count) = line.read(&mut buffer) else {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                board.send(&buffer[..count]).expect("the board lives");
                let count = board
                    .receive(&mut buffer, Duration::ZERO)
                    .expect("the board lives");
                for frame in buffer[..count].split_inclusive(|&byte| byte == 0) {
                    // A host that has received enough hangs up.
                    let _ = line.write_all(&change(frame));
                }
            }
        });
        drop(end);
        Self {
            port,
            done,
            player: Some(player),
        }
    }
}

impl Drop for PlayedBoard {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        if let Some(player) = self.player.take() {
            let _ = player.join();
        }
    }
}
