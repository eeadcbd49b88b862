//! Loops over the joints that the compiler sees joint by joint.

/// Most joints of an arm: as often the bodies below are written out.
pub const MAX_JOINTS: usize = 8;

macro_rules! each {
    ($i:ident < $n:ident $body:block, $($joint:literal)*) => {
        $({
            const $i: usize = $joint;
            if $i < $n $body
        })*
    };
}

/// `outward!(I < N { body })` runs the body for joint I = 0 to N − 1, each time with `I` a constant, so that everything
/// the arm's geometry fixes is settled while compiling.
macro_rules! outward {
    ($i:ident < $n:ident $body:block) => {
        each!($i < $n $body, 0 1 2 3 4 5 6 7)
    };
}

/// Unrolled loop from joint N − 1 down to 0.
macro_rules! inward {
    ($i:ident < $n:ident $body:block) => {
        each!($i < $n $body, 7 6 5 4 3 2 1 0)
    };
}
