//! Identity of an arm for both ends of a link.

use super::{LinkColumns, Placement};

/// FNV-1a (32 bit) over the number of joints, gravity, every placement and the base-parameter set.
///
/// Parameters of one arm mean nothing on another; masses and limits may differ, so they are left out. One column means
/// something else with other masses: friction for each unit of load is for a load by the description
/// ([`crate::dynamics::friction_load`]).
pub const fn identity<const N: usize>(
    gravity: &[f32; 3],
    placements: &[Placement; N],
    columns: &[LinkColumns; N],
) -> u32 {
    let mut hash = fnv1a(0x811C_9DC5, N as u32);
    hash = vector(hash, gravity);
    let mut joint = 0;
    while joint < N {
        let mut row = 0;
        while row < 3 {
            hash = vector(hash, &placements[joint].rot_parent_child[row]);
            row += 1;
        }
        hash = vector(hash, &placements[joint].origin);
        let mut flags = columns[joint].rotor as u32;
        let mut k = 0;
        while k < columns[joint].inertial.len() {
            flags = 2 * flags + columns[joint].inertial[k] as u32;
            k += 1;
        }
        hash = fnv1a(hash, flags);
        joint += 1;
    }
    hash
}

const fn vector(mut hash: u32, values: &[f32; 3]) -> u32 {
    let mut k = 0;
    while k < values.len() {
        hash = fnv1a(hash, values[k].to_bits());
        k += 1;
    }
    hash
}

const fn fnv1a(mut hash: u32, word: u32) -> u32 {
    let bytes = word.to_le_bytes();
    let mut k = 0;
    while k < bytes.len() {
        hash = (hash ^ bytes[k] as u32).wrapping_mul(0x0100_0193);
        k += 1;
    }
    hash
}
