//! The encodings of Thumb-2 (ARM DDI 0403E.e, A5.2 to A6.6); the first row that fits an instruction decodes it.
//!
//! A pattern is the encoding bit by bit: 0 and 1 are fixed, a point may be anything, a letter belongs to the field of that
//! name. Field `o` chooses one of several names; `-` is undefined. Of the registers read and written, `n` is the core
//! register of field `n`, `N` the same or none if it is 15, `fn` a float register, `2n` two. A load reads base and
//! index; a store reads base, index and target.

use super::Class::{self, Alu};
use super::Flow;
use Kind::{
    Accumulate, Compare, Conditional, Dual, Expanded, Far, Goes, IfThen, Load, Multiple, Near,
    Plain, Sp, Store, Table,
};

/// The rest of an instruction, from its fields.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    /// Of this class and nothing more.
    Plain(Class),
    /// A float multiply-accumulate into the register it writes.
    Accumulate,
    /// Moves the stack pointer by `i` times so much.
    Sp(i32),
    /// Moves the stack pointer by the modified immediate `i`, up or down (A5.3.2).
    Expanded(i32),
    /// A load at `i` times so much from the base.
    Load(i32),
    Store,
    /// Loads (or stores) the core registers `l`, and `r`, or `i` float words.
    Multiple(bool),
    /// Two core registers to or from memory.
    Dual,
    /// Through a register.
    Goes(Flow),
    /// To a signed distance of `i` halfwords.
    Near(fn(u32) -> Flow),
    /// Forwards by `i` halfwords or on.
    Compare,
    /// Wide, with a condition.
    Conditional,
    /// Wide, to 16 MiB around.
    Far(fn(u32) -> Flow),
    Table,
    IfThen,
}

/// Pattern, name or names, kind, registers read, registers written.
pub(super) type Row = (&'static str, &'static str, Kind, &'static str, &'static str);

const ALU: Kind = Plain(Alu);
const SYSTEM: Kind = Plain(Class::System);
const FLOAT: Kind = Plain(Class::FloatArithmetic);
const MOVE: Kind = Plain(Class::FloatMove);
const SLOW: Kind = Plain(Class::FloatDivide);
const PAIR: Kind = Plain(Class::FloatMovePair);
const STREX: Kind = Plain(Class::Store { indexed: false });
const VSTR: Kind = Plain(Class::Store { indexed: true });
/// Instructions of one halfword.
#[rustfmt::skip]
pub(super) const NARROW: &[Row] = &[
    ("0000 0000 00mm mddd", "mov", ALU, "m", "d"),
    ("0001 10om mmnn nddd", "add sub", ALU, "n m", "d"),
    ("0001 11oi iinn nddd", "add sub", ALU, "n", "d"),
    ("000o oiii iimm mddd", "lsl lsr asr", ALU, "m", "d"),
    ("0010 0ddd iiii iiii", "mov", ALU, "", "d"),
    ("0010 1nnn iiii iiii", "cmp", ALU, "n", ""),
    ("0011 oddd iiii iiii", "add sub", ALU, "d", "d"),
    ("0100 0010 00mm mddd", "tst", ALU, "d m", ""),
    ("0100 0010 1omm mddd", "cmp cmn", ALU, "d m", ""),
    ("0100 0010 01mm mddd", "rsb", ALU, "m", "d"),
    ("0100 0011 11mm mddd", "mvn", ALU, "m", "d"),
    ("0100 000o oomm mddd", "and eor lsl lsr asr adc sbc ror", ALU, "d m", "d"),
    ("0100 0011 oomm mddd", "orr mul bic -", ALU, "d m", "d"),
    ("0100 0100 dmmm mddd", "add", ALU, "d m", "d"),
    ("0100 0101 dmmm mddd", "cmp", ALU, "d m", ""),
    ("0100 0110 dmmm mddd", "mov", ALU, "m", "d"),
    ("0100 0111 1mmm m...", "blx", Goes(Flow::CallIndirect), "m", "lr"),
    ("0100 0111 0111 0...", "bx", Goes(Flow::Return), "lr", ""),
    ("0100 0111 0mmm m...", "bx", Goes(Flow::JumpIndirect), "m", ""),
    ("0100 1ttt iiii iiii", "ldr", Load(4), "pc", "t"),
    ("0101 011m mmnn nttt", "ldrsb", Load(0), "n m", "t"),
    ("0101 0oom mmnn nttt", "str strh strb", Store, "n m t", ""),
    ("0101 1oom mmnn nttt", "ldr ldrh ldrb ldrsh", Load(0), "n m", "t"),
    ("0110 1iii iinn nttt", "ldr", Load(4), "n", "t"),
    ("0111 1iii iinn nttt", "ldrb", Load(1), "n", "t"),
    ("1000 1iii iinn nttt", "ldrh", Load(2), "n", "t"),
    ("011o 0iii iinn nttt", "str strb", Store, "n t", ""),
    ("1000 0iii iinn nttt", "strh", Store, "n t", ""),
    ("1001 0ttt iiii iiii", "str", Store, "sp t", ""),
    ("1001 1ttt iiii iiii", "ldr", Load(4), "sp", "t"),
    ("1010 0ddd iiii iiii", "adr", ALU, "pc", "d"),
    ("1010 1ddd iiii iiii", "add", ALU, "sp", "d"),
    ("1011 0000 0iii iiii", "add", Sp(4), "sp", "sp"),
    ("1011 0000 1iii iiii", "sub", Sp(-4), "sp", "sp"),
    ("1011 o0i1 iiii innn", "cbz cbnz", Compare, "n", ""),
    ("1011 0010 oomm mddd", "sxth sxtb uxth uxtb", ALU, "m", "d"),
    ("1011 010r llll llll", "push", Multiple(false), "sp", ""),
    ("1011 0110 .... ....", "cps", ALU, "", ""),
    ("1011 1010 ..mm mddd", "rev", ALU, "m", "d"),
    ("1011 110r llll llll", "pop", Multiple(true), "sp", ""),
    ("1011 1110 .... ....", "bkpt", ALU, "", ""),
    ("1011 1111 .... 0000", "nop", ALU, "", ""),
    ("1011 1111 .... iiii", "it", IfThen, "", ""),
    ("1100 0nnn llll llll", "stm", Multiple(false), "n", ""),
    ("1100 1nnn llll llll", "ldm", Multiple(true), "n", ""),
    ("1101 1110 .... ....", "-", ALU, "", ""),
    ("1101 1111 .... ....", "svc", ALU, "", ""),
    ("1101 .... iiii iiii", "bcc", Near(Flow::Branch), "", ""),
    ("1110 0iii iiii iiii", "b", Near(Flow::Jump), "", ""),
];

/// Names of data processing by opcode, with a result and for the flags alone.
const DATA: &str = "and bic orr orn eor - pkh - add - adc sbc - sub rsb -";
const FLAGS: &str = "tst bic orr orn teq - pkh - cmn - adc sbc - cmp rsb -";
const BIT_FIELDS: &str = "add - - - - sub - - ssat ssat sbfx - usat usat ubfx -";
const LOADS: &str = "ldrb ldrh ldr ldr ldrsb ldrsh ldr ldr";
const STORES: &str = "strb strh str str strb strh str str";

/// Instructions of two halfwords.
#[rustfmt::skip]
pub(super) const WIDE: &[Row] = &[
    // Loads and stores of several registers, exclusive ones, table branches.
    ("1110 1000 0101 nnnn tttt .... iiii iiii", "ldrex", Load(4), "n", "t"),
    ("1110 1000 1101 nnnn .... .... 000h mmmm", "tb", Table, "n m", ""),
    ("1110 1000 1101 nnnn tttt .... .... ....", "ldrex", Load(0), "n", "t"),
    ("1110 1000 0100 nnnn tttt dddd .... ....", "strex", STREX, "n t", "d"),
    ("1110 1000 1100 nnnn tttt .... .... dddd", "strex", STREX, "n t", "d"),
    ("1110 100. u1w1 nnnn tttt ssss iiii iiii", "ldrd", Dual, "n", "t s"),
    ("1110 100. u1w0 nnnn tttt ssss iiii iiii", "strd", Dual, "n t s", ""),
    ("1110 1000 1011 1101 llll llll llll llll", "pop", Multiple(true), "sp", ""),
    ("1110 1001 0010 1101 llll llll llll llll", "push", Multiple(false), "sp", ""),
    ("1110 100p u0w1 nnnn llll llll llll llll", "ldm", Multiple(true), "n", ""),
    ("1110 100p u0w0 nnnn llll llll llll llll", "stm", Multiple(false), "n", ""),
    // Data processing with a shifted register, and with a modified immediate.
    ("1110 1010 010. 1111 .000 dddd 0000 mmmm", "mov", ALU, "m", "D"),
    ("1110 1010 010. 1111 .... dddd .... mmmm", "shift", ALU, "m", "D"),
    ("1110 1010 011. 1111 .... dddd .... mmmm", "mvn", ALU, "m", "D"),
    ("1110 101o ooo. nnnn .... 1111 .... mmmm", FLAGS, ALU, "N m", ""),
    ("1110 101o ooo. nnnn .... dddd .... mmmm", DATA, ALU, "N m", "d"),
    ("1111 0i01 000. 1101 0iii 1101 iiii iiii", "add", Expanded(1), "sp", "sp"),
    ("1111 0i01 101. 1101 0iii 1101 iiii iiii", "sub", Expanded(-1), "sp", "sp"),
    ("1111 0.00 010. 1111 0... dddd .... ....", "mov", ALU, "", "D"),
    ("1111 0.00 011. 1111 0... dddd .... ....", "mvn", ALU, "", "D"),
    ("1111 0.0o ooo. nnnn 0... 1111 .... ....", FLAGS, ALU, "N", ""),
    ("1111 0.0o ooo. nnnn 0... dddd .... ....", DATA, ALU, "N", "d"),
    // Plain immediates.
    ("1111 0i10 0000 1101 0iii 1101 iiii iiii", "add", Sp(1), "sp", "sp"),
    ("1111 0i10 1010 1101 0iii 1101 iiii iiii", "sub", Sp(-1), "sp", "sp"),
    ("1111 0.10 0000 1111 0... dddd .... ....", "adr", ALU, "pc", "d"),
    ("1111 0.10 1010 1111 0... dddd .... ....", "adr", ALU, "pc", "d"),
    ("1111 0.10 0100 .... 0... dddd .... ....", "movw", ALU, "", "d"),
    ("1111 0.10 1100 .... 0... dddd .... ....", "movt", ALU, "d", "d"),
    ("1111 0.11 0110 1111 0... dddd .... ....", "bfc", ALU, "d", "d"),
    ("1111 0.11 0110 nnnn 0... dddd .... ....", "bfi", ALU, "n d", "d"),
    ("1111 0.1o ooo0 nnnn 0... dddd .... ....", BIT_FIELDS, ALU, "N", "d"),
    // Branches and system registers; writing MSP (8) or PSP (9) moves the stack.
    ("1111 0sii iiii iiii 11j1 kiii iiii iiii", "bl", Far(Flow::Call), "", "lr"),
    ("1111 0sii iiii iiii 10j1 kiii iiii iiii", "b", Far(Flow::Jump), "", ""),
    ("1111 0011 100. nnnn 10.0 .... 0000 100.", "msr", SYSTEM, "n", "sp"),
    ("1111 0011 100. nnnn 10.0 .... .... ....", "msr", SYSTEM, "n", ""),
    ("1111 0011 1010 .... 10.0 .... .... ....", "nop", ALU, "", ""),
    ("1111 0011 1011 .... 10.0 .... .... ....", "barrier", SYSTEM, "", ""),
    ("1111 0011 111. .... 1000 dddd .... ....", "mrs", SYSTEM, "", "d"),
    ("1111 0.11 1... .... 10.0 .... .... ....", "-", ALU, "", ""),
    ("1111 0s.. ..ii iiii 10j0 kiii iiii iiii", "bcc", Conditional, "", ""),
    // Single loads and stores.
    ("1111 100. .0.1 nnnn 1111 .... .... ....", "pld", ALU, "N", ""),
    ("1111 100o uoo1 1111 tttt iiii iiii iiii", LOADS, Load(1), "pc", "t"),
    ("1111 100o 1oo1 nnnn tttt iiii iiii iiii", LOADS, Load(1), "n", "t"),
    ("1111 100o 0oo1 nnnn tttt 0... ..hh mmmm", LOADS, Load(1), "n m", "t"),
    ("1111 100o 0oo1 nnnn tttt 1puw iiii iiii", LOADS, Load(1), "n", "t"),
    ("1111 100o 1oo0 nnnn tttt iiii iiii iiii", STORES, Store, "n t", ""),
    ("1111 100o 0oo0 nnnn tttt 0... ..hh mmmm", STORES, Store, "n m t", ""),
    ("1111 100o 0oo0 nnnn tttt 1puw iiii iiii", STORES, Store, "n t", ""),
    // Data processing with registers alone, multiplication, division.
    ("1111 1010 o... nnnn .... dddd o... mmmm", "shift extend parallel bits", ALU, "N m", "d"),
    ("1111 1011 0... nnnn 1111 dddd .... mmmm", "mul", ALU, "n m", "d"),
    ("1111 1011 0... nnnn aaaa dddd .... mmmm", "mla", ALU, "n m a", "d"),
    ("1111 1011 10.0 nnnn aaaa dddd .... mmmm", "mull", ALU, "n m", "a d"),
    ("1111 1011 10.1 nnnn .... dddd .... mmmm", "div", Plain(Class::Divide), "n m", "d"),
    ("1111 1011 11.. nnnn aaaa dddd .... mmmm", "mlal", ALU, "n m a d", "a d"),
    // Float registers from and to memory; the wait for the register makes a store as slow as an indexed one.
    ("1110 1100 0100 nnnn tttt 101z ..M. mmmm", "vmov", PAIR, "n t", "2m"),
    ("1110 1100 0101 nnnn tttt 101z ..M. mmmm", "vmov", PAIR, "2m", "n t"),
    ("1110 1101 uD01 nnnn dddd 101z iiii iiii", "vldr", Load(4), "n", "fd"),
    ("1110 1101 .D00 nnnn dddd 101z .... ....", "vstr", VSTR, "n fd", ""),
    ("1110 1100 1D11 1101 dddd 101z iiii iiii", "vpop", Multiple(true), "sp", ""),
    ("1110 1101 0D10 1101 dddd 101z iiii iiii", "vpush", Multiple(false), "sp", ""),
    ("1110 110p uDw1 nnnn dddd 101z iiii iiii", "vldm", Multiple(true), "n", ""),
    ("1110 110p uDw0 nnnn dddd 101z iiii iiii", "vstm", Multiple(false), "n", ""),
    // Float arithmetic.
    ("1110 1110 0D0o nnnn dddd 101z NoM0 mmmm", "vmla vmls vnmls vnmla", Accumulate, "fd fn fm", "fd"),
    ("1110 1110 0D1o nnnn dddd 101z NoM0 mmmm", "vmul vnmul vadd vsub", FLOAT, "fn fm", "fd"),
    ("1110 1110 1D00 nnnn dddd 101z N0M0 mmmm", "vdiv", SLOW, "fn fm", "fd"),
    ("1110 1110 1D01 nnnn dddd 101z NoM0 mmmm", "vfnms vfnma", Accumulate, "fd fn fm", "fd"),
    ("1110 1110 1D10 nnnn dddd 101z NoM0 mmmm", "vfma vfms", Accumulate, "fd fn fm", "fd"),
    ("1110 1110 1D11 .... dddd 101z .0.0 ....", "vmov", MOVE, "", "fd"),
    ("1110 1110 1D11 0000 dddd 101z o1M0 mmmm", "vmov vabs", MOVE, "fm", "fd"),
    ("1110 1110 1D11 0001 dddd 101z 01M0 mmmm", "vneg", MOVE, "fm", "fd"),
    ("1110 1110 1D11 0001 dddd 101z 11M0 mmmm", "vsqrt", SLOW, "fm", "fd"),
    ("1110 1110 1D11 0100 dddd 101z .1M0 mmmm", "vcmp", MOVE, "fd fm", ""),
    ("1110 1110 1D11 0101 dddd 101z .1.0 ....", "vcmp", MOVE, "fd", ""),
    ("1110 1110 1D11 001. dddd 101z .1M0 mmmm", "vcvt", FLOAT, "fm", "fd"),
    ("1110 1110 1D11 0111 dddd 101z .1M0 mmmm", "vcvt", FLOAT, "fm", "fd"),
    ("1110 1110 1D11 1000 dddd 101z .1M0 mmmm", "vcvt", FLOAT, "fm", "fd"),
    ("1110 1110 1D11 110. dddd 101z .1M0 mmmm", "vcvt", FLOAT, "fm", "fd"),
    // Fixed point, in place.
    ("1110 1110 1D11 1.1. dddd 101z .1.0 ....", "vcvt", FLOAT, "fd", "fd"),
    // One word between core and float registers; 15 stands for the flags.
    ("1110 1110 0000 nnnn tttt 101. N..1 ....", "vmov", MOVE, "t", "fn"),
    ("1110 1110 0001 nnnn tttt 101. N..1 ....", "vmov", MOVE, "fn", "t"),
    ("1110 1110 1110 .... tttt 101. ...1 ....", "vmsr", MOVE, "t", ""),
    ("1110 1110 1111 .... tttt 101. ...1 ....", "vmrs", MOVE, "", "T"),
];
