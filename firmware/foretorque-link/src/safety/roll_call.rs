use core::sync::atomic::{AtomicU32, Ordering};

/// Who has to answer before the watchdog is fed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The tick: frames heard, torque answered.
    Tick,
    /// The learner: no lesson left waiting.
    Learner,
    /// The housekeeping below everything else.
    Housekeeping,
    /// The link: while torque may flow, samples come; while none may, nobody has to.
    Link,
}

impl Task {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Tick, Self::Learner, Self::Housekeeping, Self::Link];

    const fn bit(self) -> u32 {
        1 << self as u32
    }
}

/// The roll that is called before a watchdog is fed: complete once every task has answered since the last time.
///
/// Tasks of any priority answer; one caller asks. A task that hangs, starves the others or is starved leaves the roll
/// incomplete, and the watchdog hungry.
///
/// ```
/// use foretorque_link::safety::{RollCall, Task};
/// let roll = RollCall::new();
/// for task in Task::ALL {
///     assert!(!roll.complete());
///     roll.present(task);
/// }
/// assert!(roll.complete());
/// assert!(!roll.complete(), "everybody has to answer anew");
/// ```
#[derive(Debug)]
pub struct RollCall {
    present: AtomicU32,
}

impl RollCall {
    const EVERYBODY: u32 =
        Task::Tick.bit() | Task::Learner.bit() | Task::Housekeeping.bit() | Task::Link.bit();

    /// Nobody has answered.
    pub const fn new() -> Self {
        Self {
            present: AtomicU32::new(0),
        }
    }

    /// `task` has run.
    pub fn present(&self, task: Task) {
        self.present.fetch_or(task.bit(), Ordering::Relaxed);
    }

    /// Everybody has answered since the last complete roll; then it begins anew.
    pub fn complete(&self) -> bool {
        let everybody = Self::EVERYBODY;
        let begun =
            self.present
                .compare_exchange(everybody, 0, Ordering::Relaxed, Ordering::Relaxed);
        begun.is_ok()
    }
}

impl Default for RollCall {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_silent_task_keeps_the_watchdog_hungry() {
        for silent in Task::ALL {
            let roll = RollCall::new();
            for _ in 0..3 {
                for task in Task::ALL.into_iter().filter(|task| *task != silent) {
                    roll.present(task);
                }
                assert!(!roll.complete(), "{silent:?}");
            }
            roll.present(silent);
            assert!(roll.complete(), "{silent:?}");
        }
    }
}
