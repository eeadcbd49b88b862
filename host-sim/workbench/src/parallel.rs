//! Work on all cores whose result does not depend on how many there are.

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use std::io;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{OnceLock, mpsc};

/// The calling thread, for the kernel.
const THIS_THREAD: Pid = Pid::from_raw(0);
/// Where this process might run before one of its threads stayed on one core. Threads inherit that from the one that
/// starts them.
static EVERYWHERE: OnceLock<CpuSet> = OnceLock::new();

/// Cores of this machine that this process may use.
pub fn cores() -> usize {
    let allowed = |set: &CpuSet| {
        let all = 0..CpuSet::count();
        all.filter(|&core| set.is_set(core).unwrap_or(false))
            .count()
    };
    EVERYWHERE.get().map_or_else(
        || std::thread::available_parallelism().map_or(1, NonZeroUsize::get),
        allowed,
    )
}

/// Keeps the calling thread on `core`; returns where it might run before.
pub(crate) fn stay_on(core: usize) -> io::Result<CpuSet> {
    let before = sched_getaffinity(THIS_THREAD)?;
    EVERYWHERE.get_or_init(|| before);
    sched_setaffinity(THIS_THREAD, &only(core)?)?;
    Ok(before)
}

/// Lets the calling thread run wherever the process may, whatever the thread was that started it.
pub fn use_every_core() {
    if let Some(everywhere) = EVERYWHERE.get() {
        // Where that fails the thread is slower, and nothing else.
        let _ = sched_setaffinity(THIS_THREAD, everywhere);
    }
}

pub(crate) fn only(core: usize) -> io::Result<CpuSet> {
    let mut set = CpuSet::new();
    set.set(core)?;
    Ok(set)
}

/// `work` on every item, in the order of the items whatever thread does which; `done` is called after each, here.
pub fn in_parallel<T: Sync, R: Send>(
    threads: usize,
    items: &[T],
    work: impl Fn(&T) -> R + Sync,
    mut done: impl FnMut(),
) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    let mut results: Vec<Option<R>> = items.iter().map(|_| None).collect();
    std::thread::scope(|scope| {
        for _ in 0..threads.min(items.len()) {
            let (sender, next, work) = (sender.clone(), &next, &work);
            scope.spawn(move || {
                use_every_core();
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else {
                        return;
                    };
                    // Nobody listens any more only when the caller is gone.
                    let _ = sender.send((index, work(item)));
                }
            });
        }
        drop(sender);
        for (index, result) in receiver {
            results[index] = Some(result);
            done();
        }
    });
    results.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_stays_on_one_core_still_has_all_of_them_worked_on() {
        let before = cores();
        let started = std::thread::spawn(|| {
            let core = nix::sched::sched_getcpu().expect("runs somewhere");
            let home = stay_on(core).expect("may stay where it is");
            let sets = in_parallel(
                cores(),
                &[(); 8],
                |()| sched_getaffinity(THIS_THREAD),
                || {},
            );
            assert!(sets.iter().all(|set| *set == Ok(home)));
            assert_eq!(
                sched_getaffinity(THIS_THREAD),
                only(core).map_err(|_| nix::Error::EINVAL)
            );
            cores()
        });
        assert_eq!(started.join().expect("no panic"), before);
    }
}
