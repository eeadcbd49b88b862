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

/// `outward!(A: I < N { body })` runs the body for joint I = 0 to N − 1. For a compiled arm `I` is a constant each time,
/// so that everything the arm's geometry fixes is settled while compiling; for one that is read it is a loop.
macro_rules! outward {
    ($arm:ident: $i:ident < $n:ident $body:block) => {
        if const { $arm::COMPILED.is_some() } {
            each!($i < $n $body, 0 1 2 3 4 5 6 7);
        } else {
            for joint in 0..$n {
                #[expect(non_snake_case, reason = "the name of the constant")]
                let $i = joint;
                $body
            }
        }
    };
}

/// Loop as [`outward`] from joint N − 1 down to 0.
macro_rules! inward {
    ($arm:ident: $i:ident < $n:ident $body:block) => {
        if const { $arm::COMPILED.is_some() } {
            each!($i < $n $body, 7 6 5 4 3 2 1 0);
        } else {
            for joint in (0..$n).rev() {
                #[expect(non_snake_case, reason = "the name of the constant")]
                let $i = joint;
                $body
            }
        }
    };
}
