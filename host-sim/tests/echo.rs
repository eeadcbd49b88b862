//! echo
use host_sim::board::qemu::*;
use std::time::{Duration, Instant};
const P: Duration = Duration::from_secs(5);
fn go(image: Image, n: usize, pin: bool) {
    let mut o = QemuOptions::new(image);
    if !pin { o.core = None; }
    let t = Instant::now();
    let mut e = Emulator::start(&o).unwrap();
    let mut b = [0; 1024];
    let mut got = Vec::new();
    while got.len() < 6 { let k = e.read(&mut b, P).unwrap(); got.extend_from_slice(&b[..k]); }
    println!("{image:?} {:?} hello {:?}", t.elapsed(), got);
    let mut m = vec![7u8; 70]; m.push(0);
    let t = Instant::now();
    for _ in 0..n {
        e.write(&m, P).unwrap();
        let mut c = 0;
        while c < m.len() { c += e.read(&mut b, P).unwrap(); }
    }
    println!("{image:?} pin {pin} {} /s", n as f64 / t.elapsed().as_secs_f64());
    if image == Image::Bulk { println!("{:?}", e.hang_up(P)); }
}
#[test] fn echo() { go(Image::Joint, 1000, true); go(Image::Joint, 300, false); go(Image::Bulk, 50000, true); go(Image::Bulk, 20000, false);}
