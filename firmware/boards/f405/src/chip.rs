//! Constants of the STM32F405RG. Sources: RM0090 (reference manual), DS8626 (data sheet).

use foretorque_link::wire::size::{full_torque, headroom_permille, sample};

/// Internal oscillator, Hz, ± 1 % at room temperature (DS8626 table 41).
pub const HSI_HZ: u32 = 16_000_000;
/// Processor clock from the PLL, Hz: the most the chip allows at voltage scale 1, its reset state (DS8626 table 14).
pub const PLL_HZ: u32 = 168_000_000;
/// Input of the PLL after division by M, Hz: RM0090 7.3.2 recommends 2 MHz against jitter.
pub const PLL_INPUT_HZ: u32 = 2_000_000;
/// Factor N: 2 MHz × 168 = 336 MHz, inside 100 to 432 MHz (RM0090 7.3.2).
pub const PLL_N: u16 = 168;
/// Factor Q: 336 MHz / 7 = 48 MHz for USB and the random number generator.
pub const PLL_Q: u8 = 7;
/// Processor cycles of the shortest period: tick and learning step (90 000 with seven joints, 110 000 with eight), both
/// directions of the link (29 000, 33 000) and commands (10 %), by the estimates of docs/budget.md. At 168 MHz 1 ms, and
/// 1.25 ms with eight joints; 10.5 times as long on the bare oscillator.
pub const fn period_cycles(joints: usize) -> u32 {
    if joints > 7 { 210_000 } else { 168_000 }
}
/// Wait states of the flash at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
pub const FLASH_WAIT_STATES: u8 = 5;
/// Reads of a ready flag before a clock source is given up. One read takes at least three cycles at 16 MHz, so this
/// is more than 18 ms; the crystal needs about 2 ms (DS8626 table 39), the PLL at most 0.3 ms (table 43).
pub const CLOCK_POLLS: u32 = 100_000;
/// First sector of the store, and bytes of each of its two: the last ones of the chip (RM0090 table 5; memory.x).
pub const STORE_SECTOR: u8 = 10;
/// Bytes of a sector of the store.
pub const STORE_SECTOR_BYTES: usize = 128 * 1024;
/// Reads of the busy flag before the flash is given up. One takes at least three cycles at 168 MHz, so this is more than
/// 3.5 s; erasing takes at most 2 s (DS8626 table 48).
pub const FLASH_POLLS: u32 = 200_000_000;
/// Division of the slow peripheral bus while the PLL runs: 42 MHz, its maximum (DS8626 table 14).
pub const APB1_DIVIDER: u32 = 4;

/// Bit rate of the link. USART2 sits on APB1; eight-fold oversampling reaches it from 42 MHz (divider 21/8, exact)
/// and from the bare 16 MHz oscillator (divider 8/8, exact).
pub const LINK_BAUD: u32 = 2_000_000;
/// Capacity of one direction of the link, bytes a second: a byte is a start bit, eight data bits and a stop bit.
pub const LINK_BYTES_S: u32 = LINK_BAUD / 10;

/// Instructions that the board counts for receiving a byte, at most. A test in the emulator holds them to it.
pub const RECEIVE_INSTRUCTIONS: u64 = 60;
/// Cycles that the counter misses: entry and exit of the exception (12 each, ARM DDI 0439, 3.9), and the 36 instructions
/// around the counter's two readings, which save registers and keep the account.
pub const RECEIVE_OVERHEAD: u64 = 24 + 36;

const _: () = assert!(headroom_permille(sample(7), 1000, LINK_BYTES_S) >= 300);
const _: () = assert!(headroom_permille(full_torque(7), 1000, LINK_BYTES_S) >= 300);

/// Division of the watchdog's oscillator, 17 to 47 kHz (DS8626 table 42): 16, which its register calls 2.
pub const WATCHDOG_PRESCALER: u8 = 2;
/// Reload value of a watchdog that resets the board when it is not fed for 68 to 189 ms: three of the longest periods.
pub const WATCHDOG_RELOAD: u16 = 200;

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque_link::wire::size;

    /// Part of the processor that receiving frames of `bytes` at 1 kHz takes at an instruction a cycle, in per mille,
    /// rounded up.
    fn receive_permille(bytes: usize) -> u64 {
        let cycles = (RECEIVE_INSTRUCTIONS + RECEIVE_OVERHEAD) * bytes as u64 * 1000;
        (1000 * cycles).div_ceil(PLL_HZ.into())
    }

    /// The line of the protocol page that begins with these cells.
    fn row<'a>(page: &'a str, cells: &str) -> &'a str {
        let row = page.lines().find(|line| line.starts_with(cells));
        row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
    }

    #[test]
    fn the_protocol_page_states_headroom_and_interrupt_cost() {
        let page = include_str!("../../../../docs/protocol.md");
        let heading = page.find("| receive interrupt |").unwrap();
        let percent = |permille: i64| format!("{}.{} %", permille / 10, permille % 10);
        let share = |bytes| percent(receive_permille(bytes) as i64);
        let counts = RECEIVE_INSTRUCTIONS + RECEIVE_OVERHEAD;
        for joints in [6, 7] {
            let (sample, reply) = (size::sample(joints), size::full_torque(joints));
            for (kind, bytes) in [
                ("request", sample),
                ("reply", size::torque(joints)),
                ("full reply", reply),
                ("reply with motion", size::excited(joints)),
            ] {
                let name = format!("| {kind}, {joints} joints |");
                let headroom = percent(headroom_permille(bytes, 1000, LINK_BYTES_S));
                assert_eq!(row(page, &name), format!("{name} {bytes} | {headroom} |"));
            }
            let name = format!("| request, {joints} joints |");
            let cost = format!("≤ {RECEIVE_INSTRUCTIONS} | {counts} | {}", share(sample));
            assert_eq!(row(&page[heading..], &name), format!("{name} {cost} |"));
            let sums = format!("({sample} + {reply}) × {counts}");
            for stated in [sums, share(sample + reply)] {
                assert!(page.contains(&stated), "{joints} joints: {stated}");
            }
        }
    }
}
