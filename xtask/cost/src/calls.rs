//! The functions that code of a linked ELF can reach from an entry, and the depth of their stack.
//!
//! Sound as far as it succeeds: every path through every function is followed, conditional instructions both ways. A
//! target or stack movement that the code does not fix is unknown, never a guess.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use crate::image::Image;
use crate::thumb::{Class, Flow, Registers, Stack};

/// Reasons of an unknown.
const INDIRECT_CALL: &str = "calls through a pointer";
const INDIRECT_JUMP: &str = "jumps through a pointer";
const UNKNOWN_STACK: &str = "moves the stack by an amount the code does not fix";
const MANY_DEPTHS: &str = "reaches one place with ever more stack";
/// Most depths of stack at which one place is followed. The code behind a call that does not return is reached from it, too,
/// at another depth than from elsewhere.
const DEPTHS: usize = 8;
const NO_CODE: &str = "leads to no code";
const RECURSION: &str = "calls itself, directly or through others";

/// One function by itself.
#[derive(Clone, Debug, Default)]
struct Node {
    /// Deepest stack of its own, bytes.
    own: u32,
    /// Functions it calls or jumps to, and the depth of the stack there.
    calls: BTreeSet<(u32, u32)>,
}

/// Everything in reach of an entry.
#[derive(Debug)]
pub(crate) struct Walk<'a> {
    image: &'a Image,
    nodes: BTreeMap<u32, Node>,
    /// The function from which each was reached first; none of an entry.
    callers: BTreeMap<u32, Option<u32>>,
    /// Places the walk could not decide, with their reasons; empty if the walk is complete.
    pub(crate) unknowns: BTreeSet<String>,
}

/// The deepest stack, and the functions on the path there with the stack of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Depth {
    pub(crate) bytes: u32,
    pub(crate) path: Vec<(String, u32)>,
}

impl<'a> Walk<'a> {
    /// Walks from the function at each of `entries`.
    pub(crate) fn from(image: &'a Image, entries: &[u32]) -> Self {
        let mut walk = Self {
            image,
            nodes: BTreeMap::new(),
            callers: entries.iter().map(|&entry| (entry, None)).collect(),
            unknowns: BTreeSet::new(),
        };
        // The nearest functions first: paths are the shortest.
        let mut open = VecDeque::from_iter(entries.iter().copied());
        while let Some(entry) = open.pop_front() {
            let node = walk.function(entry);
            for &(target, _) in &node.calls {
                walk.callers.entry(target).or_insert_with(|| {
                    open.push_back(target);
                    Some(entry)
                });
            }
            walk.nodes.insert(entry, node);
        }
        walk
    }

    /// Leaves out what the function with this last part of its name calls: its own stack stays.
    pub(crate) fn leave_out_calls_of(&mut self, name: &str) {
        let tail = format!("::{name}");
        for (&entry, node) in &mut self.nodes {
            if self.image.names(entry).any(|name| name.ends_with(&tail)) {
                node.calls.clear();
            }
        }
    }

    /// Every name of every function in reach.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.nodes.keys().flat_map(|&entry| self.image.names(entry))
    }

    /// The path from an entry to the function of this name, as names.
    pub(crate) fn path_to(&self, name: &str) -> Vec<String> {
        let mut reached = self.nodes.keys().copied();
        let found = reached.find(|&entry| self.image.names(entry).any(|n| n == name));
        let back = std::iter::successors(found, |at| *self.callers.get(at)?);
        let mut path: Vec<_> = back.map(|at| self.name(at)).collect();
        path.reverse();
        path
    }

    /// The deepest stack from `entry` on. Recursion is unknown.
    pub(crate) fn depth(&mut self, entry: u32) -> Depth {
        let mut known = BTreeMap::new();
        self.deepest(entry, &mut Vec::new(), &mut known)
    }

    fn deepest(
        &mut self,
        entry: u32,
        above: &mut Vec<u32>,
        known: &mut BTreeMap<u32, Depth>,
    ) -> Depth {
        if let Some(depth) = known.get(&entry) {
            return depth.clone();
        }
        if above.contains(&entry) {
            self.unknown(entry, entry, RECURSION);
            return Depth::default();
        }
        let node = self.nodes.get(&entry).cloned().unwrap_or_default();
        let mut worst = Depth {
            bytes: node.own,
            path: vec![(self.name(entry), node.own)],
        };
        above.push(entry);
        for (target, depth) in node.calls {
            let below = self.deepest(target, above, known);
            if depth + below.bytes > worst.bytes {
                worst.bytes = depth + below.bytes;
                worst.path = vec![(self.name(entry), depth)];
                worst.path.extend(below.path);
            }
        }
        above.pop();
        known.insert(entry, worst.clone());
        worst
    }

    fn name(&self, address: u32) -> String {
        let name = self.image.names(address).next();
        name.map_or_else(|| format!("{address:#010x}"), str::to_owned)
    }

    fn unknown(&mut self, entry: u32, address: u32, reason: &str) {
        let unknown = format!("{} {reason} at {address:#010x}", self.name(entry));
        self.unknowns.insert(unknown);
    }

    /// Follows every path through the function at `entry`.
    fn function(&mut self, entry: u32) -> Node {
        let mut node = Node::default();
        let Some(code) = self.image.at(entry).map(|f| f.code.clone()) else {
            self.unknown(entry, entry, NO_CODE);
            return node;
        };
        // Places still to visit: address, depth of the stack, conditional instructions left.
        let mut open = vec![(entry, 0u32, 0u32)];
        let mut seen: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
        while let Some((address, depth, conditional)) = open.pop() {
            if !code.contains(&address) {
                // A tail call, or the end behind a call that does not return.
                continue;
            }
            let depths = seen.entry(address).or_default();
            if !depths.insert(depth) {
                continue;
            }
            if depths.len() > DEPTHS {
                self.unknown(entry, address, MANY_DEPTHS);
                continue;
            }
            let Some(instruction) = self.image.instruction(address) else {
                self.unknown(entry, address, NO_CODE);
                continue;
            };
            let next = address + instruction.size;
            let after = match instruction.stack {
                Stack::Kept => depth,
                Stack::Moved(bytes) => depth.saturating_add_signed(-bytes),
                Stack::Lost => {
                    self.unknown(entry, address, UNKNOWN_STACK);
                    depth
                }
            };
            node.own = node.own.max(after);
            let left = match instruction.class {
                Class::IfThen { count } => count,
                _ => conditional.saturating_sub(1),
            };
            let mut targets = Vec::new();
            match instruction.flow {
                Flow::Next | Flow::Return | Flow::Stop => {}
                Flow::Jump(target) | Flow::Branch(target) => targets.push(target),
                Flow::Call(target) => {
                    node.calls.insert((target, after));
                }
                Flow::CallIndirect => self.unknown(entry, address, INDIRECT_CALL),
                Flow::JumpIndirect => self.unknown(entry, address, INDIRECT_JUMP),
                Flow::Table { halfwords, base } => {
                    targets = self.table(address, base, halfwords, &code);
                    if targets.is_empty() {
                        self.unknown(entry, address, INDIRECT_JUMP);
                    }
                }
            }
            for &target in &targets {
                if code.contains(&target) {
                    open.push((target, after, 0));
                } else {
                    node.calls.insert((target, after));
                }
            }
            let ends = matches!(
                instruction.flow,
                Flow::Jump(_) | Flow::JumpIndirect | Flow::Table { .. } | Flow::Return | Flow::Stop
            );
            if !ends {
                open.push((next, after, left));
            }
            if conditional > 0 {
                // Its condition may fail; then it leaves the stack as it was.
                open.push((next, depth, left));
            }
        }
        node
    }

    /// Targets of a table branch at `address` in `code`.
    ///
    /// The table ends where the first of its targets begins, or earlier if padding or constants follow it: as offsets,
    /// those point into the table or out of the function.
    fn table(&self, address: u32, base: u32, halfwords: bool, code: &Range<u32>) -> Vec<u32> {
        let mut targets: Vec<u32> = Vec::new();
        let Some(start) = self.table_start(address, base) else {
            return targets;
        };
        let base = address + 4;
        for entry in (start..).step_by(if halfwords { 2 } else { 1 }) {
            let mask = if halfwords { 0xFFFF } else { 0xFF };
            let offset = self
                .image
                .halfword(entry)
                .map(|half| u32::from(half) & mask);
            let target = offset.map_or(0, |offset| base + 2 * offset);
            let ended = targets.iter().any(|&first| entry >= first);
            if ended || target <= entry || !code.contains(&target) {
                break;
            }
            targets.push(target);
        }
        targets
    }

    /// Start of the table of the branch at `address`: behind it, or where `addw base, pc, #imm` shortly before it points.
    fn table_start(&self, address: u32, base: u32) -> Option<u32> {
        /// Most bytes from that instruction to the branch.
        const NEAR: u32 = 16;
        const PC: u32 = 15;
        if base == PC {
            return Some(address + 4);
        }
        let kept_from = |from: u32| {
            let mut at = from;
            while at < address {
                let between = self.image.instruction(at)?;
                let changed = between.writes.meets(Registers::core(base));
                at += (!changed && between.flow == Flow::Next).then_some(between.size)?;
            }
            (at == address).then_some(())
        };
        (4..=NEAR).step_by(2).find_map(|distance| {
            let from = address - distance;
            let [first, second] = [from, from + 2].map(|at| self.image.halfword(at));
            let (first, second) = (u32::from(first?), u32::from(second?));
            let adds = first & 0xFBFF == 0xF20F && second & 0x8F00 == base << 8;
            adds.then_some(()).and_then(|()| kept_from(from + 4))?;
            let offset = (first & 0x400) << 1 | (second & 0x7000) >> 4 | second & 0xFF;
            Some(((from + 4) & !3) + offset)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAF: u32 = 0x0800_1000;
    const CALLER: u32 = 0x0800_1100;
    /// push {r7, lr}; sub sp, #8; add sp, #8; pop {r7, pc}
    const LEAF_CODE: &[u16] = &[0xB580, 0xB082, 0xB002, 0xBD80];

    /// `bl to` at `from`, for distances below 2 KiB backwards.
    fn call(from: u32, to: u32) -> [u16; 2] {
        let half = to.wrapping_sub(from + 4) >> 1;
        [0xF7FF, 0xF800 | half as u16 & 0x7FF]
    }

    /// Code of a caller, and of a leaf that it may reach.
    fn image(caller: &[u16]) -> Image {
        Image::of_code(&[("leaf", LEAF, LEAF_CODE), ("caller", CALLER, caller)])
    }

    /// The depth of a caller with this code, and the reason of the unknown if there is one.
    fn depth_and_unknown(caller: &[u16]) -> (u32, String) {
        let image = image(caller);
        let mut walk = Walk::from(&image, &[CALLER]);
        let bytes = walk.depth(CALLER).bytes;
        let reasons = walk
            .unknowns
            .iter()
            .flat_map(|unknown| unknown.split(" at ").next());
        let reasons = reasons.map(|reason| reason.trim_start_matches("caller "));
        (bytes, reasons.collect())
    }

    #[test]
    fn frames_add_up_along_the_deepest_path() {
        let [high, low] = call(CALLER + 2, LEAF);
        // push {r4, lr}; bl leaf; pop {r4, pc}
        let caller = [0xB510, high, low, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), (8 + 16, String::new()));
        let image = image(&caller);
        let walk = Walk::from(&image, &[CALLER]);
        assert_eq!(walk.path_to("leaf"), ["caller", "leaf"]);
        let name = "app::main::set_up";
        let image = Image::of_code(&[("leaf", LEAF, LEAF_CODE), (name, CALLER, &caller)]);
        let mut walk = Walk::from(&image, &[CALLER]);
        assert_eq!(walk.depth(CALLER).bytes, 8 + 16);
        walk.leave_out_calls_of("set_up");
        assert_eq!(walk.depth(CALLER).bytes, 8, "calls that are left out");
    }

    #[test]
    fn a_tail_call_has_released_its_frame() {
        // push {r4, lr}; pop.w {r4, lr}; b leaf
        let mut caller = [0xB510, 0xE8BD, 0x4010, 0xE000];
        let half = LEAF.wrapping_sub(CALLER + 6 + 4) >> 1;
        caller[3] |= half as u16 & 0x7FF;
        assert_eq!(depth_and_unknown(&caller), (16, String::new()));
    }

    #[test]
    fn pointers_recursion_and_stacks_of_unfixed_size_are_unknown() {
        // push {r4, lr}; blx r0; pop {r4, pc}
        let caller = [0xB510, 0x4780, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), (8, INDIRECT_CALL.into()));
        let [high, low] = call(CALLER + 2, CALLER);
        assert_eq!(depth_and_unknown(&[0xB510, high, low, 0xBD10]).1, RECURSION);
        // sub.w sp, sp, r0; bx lr
        let unfixed = [0xEBAD, 0x0D00, 0x4770];
        assert_eq!(depth_and_unknown(&unfixed).1, UNKNOWN_STACK);
    }

    #[test]
    fn a_place_is_followed_at_every_depth_and_a_loop_that_pushes_has_none() {
        // cbz r0, over the push; push {r7}; sub sp, #8; add sp, #8; bx lr
        let caller = [0xB100, 0xB480, 0xB082, 0xB002, 0x4770];
        assert_eq!(depth_and_unknown(&caller), (4 + 8, String::new()));
        // push {r7}; b to the push
        assert_eq!(depth_and_unknown(&[0xB480, 0xE7FD]).1, MANY_DEPTHS);
    }

    #[test]
    fn what_follows_a_conditional_return_is_followed_too() {
        // it eq; bxeq lr; push {r4, lr}; pop {r4, pc}
        let caller = [0xBF08, 0x4770, 0xB510, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), (8, String::new()));
        // sub sp, #8; itt eq; addeq sp, #8; bxeq lr; push {r4, lr}; add sp, #8; pop {r4, pc}
        let caller = [0xB082, 0xBF04, 0xB002, 0x4770, 0xB510, 0xB002, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), (8 + 8, String::new()));
    }

    #[test]
    fn every_case_of_a_table_is_followed_and_constants_behind_it_are_not() {
        // tbh [pc, r0, lsl #1] with cases at +8 and +10, then a constant that points nowhere
        let caller = [
            0xE8DF, 0xF010, 4, 5, 0xBF00, 0x7FFF, // table of two, padding, constant
            0x4770, // bx lr
            0xB510, 0xBD10, // push {r4, lr}; pop {r4, pc}
        ];
        assert_eq!(depth_and_unknown(&caller), (8, String::new()));
        // addw r3, pc, #12; tbh [r3, r2, lsl #1], two constants, the table, its cases
        let caller = [
            0xF20F, 0x030C, 0xE8D3, 0xF012, 0, 0, 0, 0, 6, 7, 0x4770, 0xB510, 0xBD10,
        ];
        assert_eq!(depth_and_unknown(&caller), (8, String::new()));
        // A move of another register between the two, or of this one.
        let between = |moved: u16| {
            [
                0xF20F, 0x0308, moved, 0xE8D3, 0xF012, 0xBF00, 3, 4, 0x4770, 0xB510, 0xBD10,
            ]
        };
        assert_eq!(depth_and_unknown(&between(0x4696)), (8, String::new()));
        let unread = (0, INDIRECT_JUMP.into());
        assert_eq!(depth_and_unknown(&between(0x4613)), unread);
        // The same through a register that other code sets.
        let caller = [0xE8D3, 0xF012, 2, 3, 0x4770, 0xB510, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), unread);
        // tbb [pc, r0] with three cases, the first of them a return, and a byte of padding
        let caller = [0xE8DF, 0xF000, 0x0302, 0x0002, 0x4770, 0xB510, 0xBD10];
        assert_eq!(depth_and_unknown(&caller), (8, String::new()));
    }
}
