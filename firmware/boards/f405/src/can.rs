//! bxCAN of the STM32F405: two controllers for classic frames, with bounded waits. Source: RM0090, chapter 32.
//!
//! Frames leave in the order in which they are given, and those that wait for too long are taken back. Every frame of the bus
//! is received: CAN1 through filter bank 0, CAN2 through bank 14, both into FIFO 0. The banks of both belong to CAN1, so CAN1 starts first. The driver works on
//! [`Registers`]; on the host a model of the peripheral stands in. It has not run on silicon.

use foretorque_link::drives::Frame;
use foretorque_link::drives::in_line::Port;

/// Registers of one controller or port, by their offset in bytes.
pub trait Registers {
    /// Reads a register.
    fn read(&self, offset: usize) -> u32;
    /// Writes a register.
    fn write(&mut self, offset: usize, value: u32);
}

/// Offsets of RM0090, table 184.
pub mod offset {
    /// Master control.
    pub const MCR: usize = 0x00;
    /// Master status.
    pub const MSR: usize = 0x04;
    /// Transmit status.
    pub const TSR: usize = 0x08;
    /// Receive FIFO 0.
    pub const RF0R: usize = 0x0c;
    /// Interrupt enable.
    pub const IER: usize = 0x14;
    /// Error status.
    pub const ESR: usize = 0x18;
    /// Bit timing.
    pub const BTR: usize = 0x1c;
    /// Identifier of transmit mailbox 0; its length and data follow, the next mailbox is 16 bytes on.
    pub const TI0R: usize = 0x180;
    /// Identifier at the head of FIFO 0; its length and data follow.
    pub const RI0R: usize = 0x1b0;
    /// Filter master.
    pub const FMR: usize = 0x200;
    /// Filter scale.
    pub const FS1R: usize = 0x20c;
    /// Filter activation.
    pub const FA1R: usize = 0x21c;
    /// First register of filter bank 0; the next bank is 8 bytes on.
    pub const F0R1: usize = 0x240;
}

const INRQ: u32 = 1;
const TXFP: u32 = 1 << 2;
const ABOM: u32 = 1 << 6;
const INAK: u32 = 1;
/// Transmit mailbox 0 is empty; the next two bits are those of the others.
const TME0: u32 = 1 << 26;
const TXRQ: u32 = 1;
const RTR: u32 = 1 << 1;
const IDE: u32 = 1 << 2;
/// Frames in FIFO 0.
const FMP: u32 = 3;
/// Takes the frame of transmit mailbox 0 back; the bits of the others are 8 bits on each.
const ABRQ0: u32 = 1 << 7;
const FOVR: u32 = 1 << 4;
const RFOM: u32 = 1 << 5;
const BOFF: u32 = 1 << 2;
/// Interrupts: a mailbox is empty again, FIFO 0 has a frame.
const TMEIE: u32 = 1;
const FMPIE0: u32 = 1 << 1;
/// Bus off is latched in the status. It interrupts nobody without a further bit.
const BOFIE: u32 = 1 << 10;
/// Status: an error was latched; writing it clears it.
const ERRI: u32 = 1 << 2;
/// Requests of the three mailboxes that are complete; writing them clears the interrupt.
const RQCP: u32 = 1 | 1 << 8 | 1 << 16;
const FINIT: u32 = 1;
/// First filter bank of CAN2.
const CAN2_BANK: u32 = 14;

/// Bit timing register for `bit_s` from a peripheral clock of `clock_hz`, sample point 80 to 88 %.
///
/// `None` where no whole number of 10 to 20 time quanta gives the rate.
pub const fn timing(clock_hz: u32, bit_s: u32) -> Option<u32> {
    let mut quanta = 20;
    while quanta >= 10 {
        let rate = bit_s.saturating_mul(quanta);
        if rate != 0 && clock_hz.is_multiple_of(rate) && clock_hz / rate <= 1024 {
            let (divider, second) = (clock_hz / rate, (quanta + 4) / 7);
            let first = quanta - 1 - second;
            if first <= 16 {
                return Some((divider - 1) | (first - 1) << 16 | (second - 1) << 20);
            }
        }
        quanta -= 1;
    }
    None
}

/// Opens the filters of both controllers for every frame, into FIFO 0. `can1`: registers of CAN1, whose clock runs.
pub fn open_filters(can1: &mut impl Registers) {
    // The other bits are reserved and keep their values.
    let others = can1.read(offset::FMR) & !(0x3f << 8 | FINIT) | CAN2_BANK << 8;
    can1.write(offset::FMR, others | FINIT);
    let banks = 1 | 1 << CAN2_BANK;
    can1.write(offset::FS1R, banks);
    for bank in [0, CAN2_BANK as usize] {
        // Mask 0: no bit of the identifier matters. Identifier and mask mode, and FIFO 0, are the state after reset.
        can1.write(offset::F0R1 + 8 * bank, 0);
        can1.write(offset::F0R1 + 8 * bank + 4, 0);
    }
    can1.write(offset::FA1R, banks);
    can1.write(offset::FMR, others);
}

/// One started controller.
#[derive(Debug)]
pub struct Bxcan<R> {
    registers: R,
    /// Counts since which the frames of the mailboxes wait.
    since: [u32; 3],
    /// Overruns of the FIFO: a frame each, or more.
    overruns: u32,
}

impl<R: Registers> Bxcan<R> {
    /// Starts a controller with the bit timing `timing`; reads a status at most `polls` times.
    ///
    /// It takes part in the bus once that has been idle; both interrupts are enabled. `None`: it does not answer.
    pub fn start(mut registers: R, timing: u32, polls: u32) -> Option<Self> {
        // Out of sleep, first in first out, back after bus off without the program's help.
        registers.write(offset::MCR, INRQ | TXFP | ABOM);
        // It has entered its initialisation.
        (0..polls).find(|_| registers.read(offset::MSR) & INAK != 0)?;
        registers.write(offset::BTR, timing);
        registers.write(offset::MCR, TXFP | ABOM);
        registers.write(offset::IER, TMEIE | FMPIE0 | BOFIE);
        Some(Self {
            registers,
            since: [0; 3],
            overruns: 0,
        })
    }

    /// The controller takes no part in the bus: it has left it after too many errors, or has not seen it idle since the
    /// start. It joins again by itself, after 128 times eleven recessive bits. True once, too, where that was since the last
    /// call.
    pub fn is_off(&mut self) -> bool {
        let status = self.registers.read(offset::MSR);
        if status & ERRI != 0 {
            self.registers.write(offset::MSR, ERRI);
        }
        status & (INAK | ERRI) != 0 || self.registers.read(offset::ESR) & BOFF != 0
    }
}

impl<R: Registers> Port for Bxcan<R> {
    fn receive(&mut self) -> Option<Frame> {
        let complete = self.registers.read(offset::TSR) & RQCP;
        if complete != 0 {
            self.registers.write(offset::TSR, complete);
        }
        let status = self.registers.read(offset::RF0R);
        if status & FOVR != 0 {
            self.registers.write(offset::RF0R, FOVR);
            self.overruns = self.overruns.saturating_add(1);
        }
        if status & FMP == 0 {
            return None;
        }
        let id = self.registers.read(offset::RI0R);
        // Lengths of 9 to 15 mean eight bytes.
        let length = (self.registers.read(offset::RI0R + 4) & 15).min(8) as usize;
        let [d0, d1, d2, d3] = self.registers.read(offset::RI0R + 8).to_le_bytes();
        let [d4, d5, d6, d7] = self.registers.read(offset::RI0R + 12).to_le_bytes();
        self.registers.write(offset::RF0R, RFOM);
        let data = [d0, d1, d2, d3, d4, d5, d6, d7];
        let bytes = if id & RTR == 0 {
            data.get(..length)?
        } else {
            &[]
        };
        let mut frame = if id & IDE != 0 {
            Frame::extended(id >> 3, bytes)
        } else {
            Frame::standard(id >> 21, bytes)
        };
        frame.remote = id & RTR != 0;
        Some(frame)
    }

    fn send(&mut self, frame: &Frame, since: u32) -> bool {
        let bytes = frame.bytes();
        if frame.fd || bytes.len() > 8 {
            // What no classic bus can carry did not come from one: it must not stop the queue.
            return true;
        }
        let status = self.registers.read(offset::TSR);
        let mut mailboxes = self.since.iter_mut().enumerate();
        let empty = mailboxes.find(|(mailbox, _)| status & TME0 << mailbox != 0);
        let Some((mailbox, place)) = empty else {
            return false;
        };
        *place = since;
        let base = offset::TI0R + 16 * mailbox;
        let mut data = [0; 8];
        for (to, from) in data.iter_mut().zip(bytes) {
            *to = *from;
        }
        let [d0, d1, d2, d3, d4, d5, d6, d7] = data;
        let low = u32::from_le_bytes([d0, d1, d2, d3]);
        let high = u32::from_le_bytes([d4, d5, d6, d7]);
        self.registers.write(base + 4, bytes.len() as u32);
        self.registers.write(base + 8, low);
        self.registers.write(base + 12, high);
        let id = if frame.extended {
            frame.id << 3 | IDE
        } else {
            frame.id << 21
        };
        let remote = if frame.remote { RTR } else { 0 };
        self.registers.write(base, id | remote | TXRQ);
        true
    }

    fn expire(&mut self, now: u32, timeout: u32) -> u32 {
        let status = self.registers.read(offset::TSR);
        let mut late = 0;
        for (mailbox, since) in self.since.iter().enumerate() {
            let waits = status & TME0 << mailbox == 0;
            if waits && now.wrapping_sub(*since) > timeout {
                late |= ABRQ0 << (8 * mailbox);
            }
        }
        // The bit stands until the mailbox is empty: a transmission that has begun ends first (RM0090 32.7.1).
        late &= !status;
        if late != 0 {
            self.registers.write(offset::TSR, late);
        }
        core::mem::take(&mut self.overruns).saturating_add(late.count_ones())
    }
}

/// Registers of a peripheral of the chip, by its address.
#[cfg(target_os = "none")]
#[derive(Debug)]
pub struct Peripheral(usize);

#[cfg(target_os = "none")]
impl Peripheral {
    /// CAN1, which holds the filters of both controllers.
    pub const CAN1: usize = 0x4000_6400;
    /// CAN2; it receives once [`open_filters`] has been called with the registers of CAN1.
    pub const CAN2: usize = 0x4000_6800;
    /// UART4.
    pub const UART4: usize = 0x4000_4c00;
    /// USART6.
    pub const USART6: usize = 0x4001_1400;

    /// Registers of the peripheral at `address`.
    ///
    /// # Safety
    ///
    /// The address is one of those above. At most one value exists for it, nothing else uses its registers, and its clock
    /// runs.
    pub const unsafe fn new(address: usize) -> Self {
        Self(address)
    }

    fn address(&self, offset: usize) -> *mut u32 {
        // A peripheral has 1 KiB of registers, each of 32 bits.
        (self.0 + (offset & 0x3fc)) as *mut u32
    }
}

#[cfg(target_os = "none")]
impl Registers for Peripheral {
    fn read(&self, offset: usize) -> u32 {
        // SAFETY: an aligned address inside the peripheral, which belongs to this value alone.
        unsafe { self.address(offset).read_volatile() }
    }

    fn write(&mut self, offset: usize, value: u32) {
        // SAFETY: as in `read`.
        unsafe { self.address(offset).write_volatile(value) }
    }
}

#[cfg(test)]
mod tests {
    //! The driver on a model of bxCAN: start, frames there and back, order, overrun, faults.

    use super::*;
    use foretorque_link::drives::in_line::Bridge;
    use std::collections::VecDeque;

    /// Filter master after reset (RM0090 32.9.4).
    const FMR_RESET: u32 = 0x2a1c_0e01;

    /// bxCAN after RM0090: state machine, mailboxes in order of request, FIFO of three, filters.
    #[derive(Default)]
    struct Model {
        mcr: u32,
        btr: u32,
        filters: std::collections::BTreeMap<usize, u32>,
        mailboxes: [[u32; 4]; 3],
        /// Mailboxes in the order of their requests.
        pending: VecDeque<usize>,
        fifo: VecDeque<[u32; 4]>,
        overrun: bool,
        off: bool,
        /// Bus off was, and the status shows it where that is enabled.
        was_off: bool,
        ier: u32,
        /// INAK never comes, as in the emulator, or never goes, as on a dead bus.
        stuck: Option<u32>,
        polls: std::cell::Cell<u32>,
        second: bool,
        /// Mailboxes whose frames were taken back.
        aborted: u32,
    }

    impl Registers for Model {
        fn read(&self, offset: usize) -> u32 {
            match offset {
                offset::MSR => {
                    self.polls.set(self.polls.get() + 1);
                    let was_off = self.was_off && self.ier & BOFIE != 0;
                    self.stuck.unwrap_or(self.mcr & INRQ) | if was_off { ERRI } else { 0 }
                }
                offset::TSR => (0..3)
                    .filter(|mailbox| !self.pending.contains(mailbox))
                    .fold(0, |bits, mailbox| bits | TME0 << mailbox),
                offset::FMR => *self.filters.get(&offset).unwrap_or(&FMR_RESET),
                offset::RF0R => self.fifo.len() as u32 | if self.overrun { FOVR } else { 0 },
                offset::ESR if self.off => BOFF,
                offset::RI0R..=0x1bc => self
                    .fifo
                    .front()
                    .map_or(0, |frame| frame[(offset - offset::RI0R) / 4]),
                _ => 0,
            }
        }

        fn write(&mut self, offset: usize, value: u32) {
            match offset {
                offset::MCR => self.mcr = value,
                offset::MSR => self.was_off &= value & ERRI == 0,
                offset::IER => self.ier = value,
                offset::TSR => {
                    let aborted = |mailbox: &usize| value & ABRQ0 << (8 * mailbox) != 0;
                    self.pending.retain(|mailbox| !aborted(mailbox));
                    self.aborted |= value & !RQCP;
                }
                // Only in initialisation.
                offset::BTR if self.mcr & INRQ != 0 => self.btr = value,
                offset::RF0R if value & RFOM != 0 => drop(self.fifo.pop_front()),
                offset::RF0R => self.overrun &= value & FOVR == 0,
                offset::TI0R..=0x1ac => {
                    let place = (offset - offset::TI0R) / 4;
                    let (mailbox, word) = (place / 4, place % 4);
                    let waits = self.pending.contains(&mailbox);
                    assert!(!waits, "a waiting mailbox is not written");
                    self.mailboxes[mailbox][word] = value;
                    if word == 0 && value & TXRQ != 0 {
                        // Without it the identifier decides the order.
                        assert_ne!(self.mcr & TXFP, 0);
                        self.pending.push_back(mailbox);
                    }
                }
                offset::FMR..=0x37c => drop(self.filters.insert(offset, value)),
                _ => {}
            }
        }
    }

    impl Model {
        fn filter(&self, offset: usize) -> u32 {
            self.filters.get(&offset).copied().unwrap_or_default()
        }

        /// Takes a frame from the bus, through the filters of `can1`.
        fn accept_frame(&mut self, [id, length, low, high]: [u32; 4], can1: &Self) {
            let second_bank = can1.filter(offset::FMR) >> 8 & 0x3f;
            let bank = if self.second { second_bank } else { 0 };
            let open = can1.filter(offset::FMR) & FINIT == 0
                && can1.filter(offset::FA1R) >> bank & 1 == 1
                && can1.filter(offset::FS1R) >> bank & 1 == 1
                && can1.filter(offset::F0R1 + 8 * bank as usize + 4) == 0;
            if !open {
                return;
            }
            if self.fifo.len() == 3 {
                self.overrun = true;
                self.fifo[2] = [id, length, low, high];
            } else {
                self.fifo.push_back([id, length, low, high]);
            }
        }

        /// The next frame that goes to the bus.
        fn take_frame(&mut self) -> Option<[u32; 4]> {
            let [id, length, low, high] = self.mailboxes[self.pending.pop_front()?];
            Some([id & !TXRQ, length, low, high])
        }
    }

    const POLLS: u32 = 1000;

    fn pair() -> (Bxcan<Model>, Bxcan<Model>) {
        let timing = timing(42_000_000, 1_000_000).unwrap();
        let mut first = Model::default();
        open_filters(&mut first);
        let second = Model {
            second: true,
            ..Model::default()
        };
        let start = |model| Bxcan::start(model, timing, POLLS).unwrap();
        (start(first), start(second))
    }

    #[test]
    fn the_wait_of_the_start_is_bounded() {
        let stuck = |value| Model {
            stuck: Some(value),
            ..Model::default()
        };
        assert!(Bxcan::start(stuck(0), 0, POLLS).is_none());
        // A bus that is never idle is one that the controller has not joined.
        let mut outside = Bxcan::start(stuck(INAK), 0, POLLS).unwrap();
        assert!(outside.is_off());
        let (mut can, _) = pair();
        assert!(!can.is_off() && can.registers.polls.get() <= POLLS);
        // 42 MHz / 3 / (1 + 11 + 2).
        assert_eq!(can.registers.btr, 2 | 10 << 16 | 1 << 20);
    }

    #[test]
    fn bit_rates_are_exact_or_refused() {
        for clock_hz in [16_000_000, 42_000_000] {
            for bit_s in [125_000, 250_000, 500_000, 1_000_000] {
                let btr = timing(clock_hz, bit_s).unwrap();
                let (divider, first, second) =
                    ((btr & 0x3ff) + 1, (btr >> 16 & 15) + 1, (btr >> 20 & 7) + 1);
                assert_eq!(clock_hz, bit_s * divider * (1 + first + second));
                let sample = f64::from(1 + first) / f64::from(1 + first + second);
                let late = (0.8..=0.88).contains(&sample);
                assert!(late, "{clock_hz} {bit_s}: {sample}");
            }
        }
        assert_eq!(timing(42_000_000, 800_000), None);
        assert_eq!(timing(42_000_000, 0), None);
    }

    #[test]
    fn frames_pass_unchanged_and_in_order() {
        let (mut near, mut far) = pair();
        let mut random = 1_u64;
        let mut next = || {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            random >> 24
        };
        let (mut sent, mut received) = (VecDeque::new(), 0);
        for _ in 0..100_000 {
            let (data, id) = (next().to_le_bytes(), next() as u32);
            let bytes = &data[..(next() % 9) as usize];
            let frame = match next() % 5 {
                0 => Frame::remote(id),
                1 | 2 => Frame::extended(id, bytes),
                _ => Frame::standard(id, bytes),
            };
            match near.send(&frame, 0) {
                true => sent.push_back(frame),
                false => assert_eq!(sent.len(), 3),
            }
            if !next().is_multiple_of(3)
                && let Some(words) = near.registers.take_frame()
            {
                far.registers.accept_frame(words, &near.registers);
                assert_eq!(far.receive(), sent.pop_front());
                received += 1;
            }
        }
        assert!(received > 50_000);
    }

    #[test]
    fn the_reserved_bits_of_the_filters_stay() {
        let (near, _) = pair();
        let filters = near.registers.filter(offset::FMR);
        assert_eq!(filters, FMR_RESET & !(FINIT | 0x3f << 8) | 14 << 8);
    }

    #[test]
    fn no_old_frame_leaves_after_a_bus_without_acknowledgement() {
        const TIMEOUT_MS: u32 = 20;
        let (near, far) = pair();
        let mut bridge = Bridge::<_, 1>::new([near, far], None, TIMEOUT_MS);
        let (mut left, mut oldest) = (0, 0);
        // The clock comes round meanwhile.
        for ms in 0_u32..200 {
            let now = ms.wrapping_sub(50);
            for _ in 0..3 {
                bridge.send(0, Frame::standard(1, &now.to_le_bytes()), now);
            }
            bridge.pass(now, |_, _| {});
            // Until then nobody acknowledges: the mailboxes stay full.
            while ms >= 100
                && let Some([_, _, sent, _]) = bridge.ports()[0].registers.take_frame()
            {
                (left, oldest) = (left + 1, oldest.max(now.wrapping_sub(sent)));
                bridge.pass(now, |_, _| {});
            }
        }
        assert!(left > 300 && oldest <= TIMEOUT_MS, "{left}: {oldest} ms");
        assert_eq!(left + bridge.lost(), 600);
        let [near, far] = bridge.ports();
        let all = ABRQ0 | ABRQ0 << 8 | ABRQ0 << 16;
        assert_eq!([near, far].map(|can| can.registers.aborted), [all, 0]);
    }

    #[test]
    fn faults_of_the_bus_are_seen() {
        let (mut near, mut far) = pair();
        let frames: Vec<Frame> = (0..5).map(|id| Frame::standard(id, &[id as u8])).collect();
        for frame in &frames {
            assert!(near.send(frame, 0));
            let words = near.registers.take_frame().unwrap();
            far.registers.accept_frame(words, &near.registers);
        }
        // Three fit: the first two and the last.
        assert_eq!(far.receive(), Some(frames[0]));
        assert!(!far.registers.overrun, "the flag is cleared");
        assert_eq!([(); 2].map(|()| far.expire(0, 0)), [1, 0]);
        let others = [Some(frames[1]), Some(frames[4]), None];
        assert_eq!([(); 3].map(|()| far.receive()), others);
        for frame in [Frame::standard(1, &[0; 12]), frames[0].into_fd(0)] {
            assert!(near.send(&frame, 0) && near.registers.pending.is_empty());
        }
        assert!(!near.is_off());
        // It has come back before anybody looked.
        near.registers.was_off = true;
        assert_eq!([near.is_off(), near.is_off()], [true, false]);
        near.registers.off = true;
        assert!(near.is_off());
        // Nobody acknowledges: the mailboxes fill.
        for frame in &frames[..3] {
            assert!(near.send(frame, 0));
        }
        assert!(!near.send(&frames[3], 0));
        // A length beyond 8 means eight bytes.
        far.registers
            .accept_frame([5 << 21, 15, 1, 2], &near.registers);
        let eight = Frame::standard(5, &[1, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(far.receive(), Some(eight));
    }
}
