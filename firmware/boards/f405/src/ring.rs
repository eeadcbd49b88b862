//! Bytes between an interrupt and a task: the two ends of a queue that remember its length.
//!
//! The ends of heapless divide by a length that they read from memory; here it is a constant, so no division can panic.

use core::hint::assert_unchecked;

use heapless::spsc::{Consumer, Producer, Queue};

/// The end where bytes go in.
pub struct Sender<const N: usize>(Producer<'static, u8>);

/// The end where bytes come out.
pub struct Receiver<const N: usize>(Consumer<'static, u8>);

/// The two ends of `queue`.
pub fn split<const N: usize>(queue: &'static mut Queue<u8, N>) -> (Sender<N>, Receiver<N>) {
    let (sender, receiver) = queue.split();
    (Sender(sender), Receiver(receiver))
}

impl<const N: usize> Sender<N> {
    /// Puts a byte in; false if the queue is full.
    #[inline(always)]
    pub fn put(&mut self, byte: u8) -> bool {
        // SAFETY: the only constructor takes a queue of this length.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.enqueue(byte).is_ok()
    }

    /// Bytes that can be put in.
    #[inline(always)]
    pub fn free(&self) -> usize {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.capacity() - self.0.len()
    }
}

impl<const N: usize> Receiver<N> {
    /// Takes the oldest byte out.
    #[inline(always)]
    pub fn take(&mut self) -> Option<u8> {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.dequeue()
    }
}
