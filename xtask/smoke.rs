// The smallest program that needs of a toolchain what the firmware needs: core, alloc, soft double arithmetic, memory
// intrinsics, whole-program optimisation and a linker.
#![no_std]
#![no_main]

extern crate alloc;

use core::alloc::{GlobalAlloc, Layout};
use core::hint::black_box;

struct Nothing;

// SAFETY: it never hands out memory.
unsafe impl GlobalAlloc for Nothing {
    unsafe fn alloc(&self, _: Layout) -> *mut u8 {
        core::ptr::null_mut()
    }
    unsafe fn dealloc(&self, _: *mut u8, _: Layout) {}
}

#[global_allocator]
static NOTHING: Nothing = Nothing;

#[panic_handler]
fn halt(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

#[unsafe(no_mangle)]
extern "C" fn _start() -> ! {
    let from = [black_box(1u8); 256];
    let mut to = alloc::vec![0u8; black_box(256)];
    to.copy_from_slice(&from[..black_box(256)]);
    black_box((&to, black_box(1.5f64) * black_box(2.5f64)));
    loop {}
}
