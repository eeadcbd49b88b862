use core::sync::atomic::{AtomicU32, Ordering};

/// A task that has to run before the watchdog is fed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The tick: frames received, torque sent.
    Tick,
    /// The learner: no learning sample left waiting.
    Learner,
    /// The housekeeping at the lowest priority.
    Housekeeping,
    /// The link: samples arrive while torque may flow.
    Link,
}

impl Task {
    /// All tasks.
    pub const ALL: [Self; 4] = [Self::Tick, Self::Learner, Self::Housekeeping, Self::Link];

    const fn bit(self) -> u32 {
        1 << self as u32
    }
}

/// Check-in of the tasks before a watchdog is fed: complete once every task has run since the last time.
///
/// Tasks of any priority check in; one caller reads. A task that hangs, starves the others or is starved leaves the
/// check-in incomplete, and the watchdog is not fed.
///
/// ```
/// use foretorque_link::safety::{Task, TaskCheckIn};
/// let tasks = TaskCheckIn::new();
/// for task in Task::ALL {
///     assert!(!tasks.complete());
///     tasks.check_in(task);
/// }
/// assert!(tasks.complete());
/// assert!(!tasks.complete(), "every task has to check in anew");
/// ```
#[derive(Debug, Default)]
pub struct TaskCheckIn {
    present: AtomicU32,
}

impl TaskCheckIn {
    const ALL: u32 = (1 << Task::ALL.len()) - 1;

    /// No task has checked in.
    pub const fn new() -> Self {
        Self {
            present: AtomicU32::new(0),
        }
    }

    /// Records that `task` has run.
    pub fn check_in(&self, task: Task) {
        self.present.fetch_or(task.bit(), Ordering::Relaxed);
    }

    /// True once every task has checked in since the last time it was true; then it begins anew.
    pub fn complete(&self) -> bool {
        self.present
            .compare_exchange(Self::ALL, 0, Ordering::Relaxed, Ordering::Relaxed)
            .is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_missing_task_leaves_the_check_in_incomplete() {
        for missing in Task::ALL {
            let tasks = TaskCheckIn::new();
            for _ in 0..3 {
                for task in Task::ALL.into_iter().filter(|task| *task != missing) {
                    tasks.check_in(task);
                }
                assert!(!tasks.complete(), "{missing:?}");
            }
            tasks.check_in(missing);
            assert!(tasks.complete(), "{missing:?}");
        }
    }
}
