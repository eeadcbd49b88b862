//! An emulator process that cannot be left behind.

use crate::parallel::{only, stay_on};
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::prctl;
use nix::sys::signal::Signal;
use nix::unistd::Pid;
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, Command, ExitStatus};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Lines of the emulator's stderr that are kept.
const KEPT_LINES: usize = 60;

/// A running emulator: killed and reaped when this goes out of scope, killed by the kernel when this process dies.
#[derive(Debug)]
pub(crate) struct Guarded {
    child: Child,
    lines: Arc<Mutex<VecDeque<String>>>,
    reader: Option<std::thread::JoinHandle<()>>,
    /// Where the calling thread was allowed to run before it joined the emulator on one core.
    affinity: Option<CpuSet>,
}

impl Guarded {
    /// Starts `command`, which inherits `kept` under the same numbers; `core` pins it and the calling thread together.
    pub(crate) fn start(
        mut command: Command,
        kept: Vec<OwnedFd>,
        core: Option<usize>,
    ) -> io::Result<Self> {
        let numbers: Vec<RawFd> = kept.iter().map(AsRawFd::as_raw_fd).collect();
        let parent = Pid::this();
        let set = core.map(only).transpose()?;
        let prepare = move || {
            prctl::set_pdeathsig(Signal::SIGKILL)?;
            if Pid::parent() != parent {
                // The parent died before the request above was in force.
                return Err(io::ErrorKind::NotFound.into());
            }
            if let Some(set) = &set {
                sched_setaffinity(Pid::from_raw(0), set)?;
            }
            for &number in &numbers {
                // SAFETY: `kept` holds the descriptors open until the child has started.
                let descriptor = unsafe { std::os::fd::BorrowedFd::borrow_raw(number) };
                fcntl(descriptor, FcntlArg::F_SETFD(FdFlag::empty()))?;
            }
            Ok(())
        };
        // SAFETY: between fork and exec the closure makes plain system calls only; it allocates nothing.
        unsafe { command.pre_exec(prepare) };
        let mut child = spawn(command)?;
        drop(kept);
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let stderr = child.stderr.take();
        let reader = stderr.map(|stderr| listen(stderr, Arc::clone(&lines)));
        let affinity = core.map(stay_on).transpose()?;
        Ok(Self {
            child,
            lines,
            reader,
            affinity,
        })
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the emulator to end, at most `timeout`.
    pub(crate) fn ended(&mut self, timeout: Duration) -> io::Result<Option<ExitStatus>> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(status) = self.child.try_wait()? {
                self.join_reader();
                return Ok(Some(status));
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits for the last lines of an emulator that has ended.
    fn join_reader(&mut self) {
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
    }

    /// Last message of the emulator about itself on stderr, else its last line: when it gives up it also lists all registers.
    pub(crate) fn last_message(&self) -> Option<String> {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let own = lines.iter().rev().find(|line| line.starts_with("qemu"));
        own.or(lines.back()).cloned()
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        // Both fail only when the child is gone already, which is what is wanted.
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.join_reader();
        if let Some(before) = &self.affinity {
            let _ = sched_setaffinity(Pid::from_raw(0), before);
        }
    }
}

/// Starts children from one thread that lives as long as the process: the kernel sends the death signal of a child
/// when the *thread* that started it ends, which must not happen to a board handed from one thread to another.
fn spawn(command: Command) -> io::Result<Child> {
    type Order = (Command, Sender<io::Result<Child>>);
    static SPAWNER: OnceLock<Sender<Order>> = OnceLock::new();
    let spawner = SPAWNER.get_or_init(|| {
        let (orders, taken) = channel::<Order>();
        std::thread::spawn(move || {
            for (mut command, answer) in taken {
                // The one who asked is waiting below.
                let _ = answer.send(command.spawn());
            }
        });
        orders
    });
    let (answer, spawned) = channel();
    let gone = || io::Error::other("the thread that starts emulators is gone");
    spawner.send((command, answer)).map_err(|_| gone())?;
    spawned.recv().map_err(|_| gone())?
}

/// Keeps the last lines of the emulator's stderr.
fn listen(stderr: ChildStderr, lines: Arc<Mutex<VecDeque<String>>>) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        for line in BufReader::new(stderr).lines().map_while(Result::ok) {
            // Written at every start: the pace of virtual time is set by the link, not by a timer.
            if line.contains("icount sleep disabled and no active timers") {
                continue;
            }
            let mut lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
            if lines.len() == KEPT_LINES {
                lines.pop_front();
            }
            lines.push_back(line);
        }
    })
}
