//! Bytes or frames between an interrupt and a task: the two ends of a queue that remember its length.
//!
//! The ends of heapless divide by a length that they read from memory; here it is a constant, so no division can panic.

use core::hint::assert_unchecked;

use heapless::spsc::{Consumer, Producer, Queue};

/// The end where they go in.
pub struct Sender<const N: usize, T: 'static = u8>(Producer<'static, T>);

/// The end where they come out.
pub struct Receiver<const N: usize, T: 'static = u8>(Consumer<'static, T>);

/// The two ends of `queue`.
pub fn split<const N: usize, T>(queue: &'static mut Queue<T, N>) -> (Sender<N, T>, Receiver<N, T>) {
    let (sender, receiver) = queue.split();
    (Sender(sender), Receiver(receiver))
}

impl<const N: usize, T> Sender<N, T> {
    /// Puts one in; false if the queue is full.
    #[inline(always)]
    pub fn put(&mut self, item: T) -> bool {
        // SAFETY: the only constructor takes a queue of this length.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.enqueue(item).is_ok()
    }

    /// Number that can be put in.
    #[inline(always)]
    pub fn free(&self) -> usize {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.capacity() - self.0.len()
    }
}

impl<const N: usize, T> Receiver<N, T> {
    /// Takes the oldest one out.
    #[inline(always)]
    pub fn take(&mut self) -> Option<T> {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.dequeue()
    }
}
