//! Torques of many arms by the firmware's code, as the board's processor computes them: what the acceptance tests hold
//! against the tables of an outside tool.
//!
//! Two files on the semihosting command line. The first holds records of f32, little-endian: the number of the arm in
//! `answer`, then q, qd and qdd of its joints. The second gets, for each record, the N torques of `rnea` and the N
//! products of `regressor_row` and the base parameters.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod run {
    use foretorque::arm::{Arm, panda::Panda, ur5::Ur5};
    use foretorque::dynamics::{BaseParameters, regressor_row, rnea};
    use foretorque::joint::{JointMotion, JointVector};
    use foretorque_images::{Streams, exit};
    use foretorque_test_arms::*;
    use stm32f4xx_hal as _;

    #[cortex_m_rt::entry]
    fn main() -> ! {
        let streams = Streams::open();
        exit(streams.is_some_and(|streams| run(&streams)))
    }

    /// Answers records until the file ends, which may only be between two of them.
    fn run(streams: &Streams) -> bool {
        while let Some(arm) = number(streams) {
            if answer(arm as usize, streams).is_none() {
                return false;
            }
        }
        true
    }

    fn answer(arm: usize, streams: &Streams) -> Option<()> {
        match arm {
            0 => torques::<Ur5, 6, 40>(streams),
            1 => torques::<Panda, 7, 48>(streams),
            2 => torques::<random_1_a::Random1A, 1, 3>(streams),
            3 => torques::<random_1_b::Random1B, 1, 3>(streams),
            4 => torques::<random_2_a::Random2A, 2, 11>(streams),
            5 => torques::<random_2_b::Random2B, 2, 11>(streams),
            6 => torques::<random_4_a::Random4A, 4, 27>(streams),
            7 => torques::<random_4_b::Random4B, 4, 27>(streams),
            8 => torques::<random_6_a::Random6A, 6, 43>(streams),
            9 => torques::<random_6_b::Random6B, 6, 43>(streams),
            10 => torques::<random_7_a::Random7A, 7, 51>(streams),
            11 => torques::<random_7_b::Random7B, 7, 51>(streams),
            _ => None,
        }
    }

    fn torques<A: Arm<N, P>, const N: usize, const P: usize>(streams: &Streams) -> Option<()> {
        let motion = JointMotion::<N> {
            q: joints(streams)?,
            qd: joints(streams)?,
            qdd: joints(streams)?,
        };
        let beta = BaseParameters::<P>::from(A::NOMINAL);
        for tau in rnea::<A, N, P>(&beta, &motion).iter() {
            tell(streams, *tau)?;
        }
        for joint in 0..N {
            let row = regressor_row::<A, N, P>(joint, &motion);
            tell(streams, row.dot(&beta))?;
        }
        Some(())
    }

    fn joints<const N: usize>(streams: &Streams) -> Option<JointVector<N>> {
        let mut values = JointVector::<N>::zeros();
        for value in values.iter_mut() {
            *value = number(streams)?;
        }
        Some(values)
    }

    fn number(streams: &Streams) -> Option<f32> {
        let mut bytes = [0; 4];
        let read = streams.read(&mut bytes)?;
        Some(f32::from_le_bytes(read.try_into().ok()?))
    }

    fn tell(streams: &Streams, value: f32) -> Option<()> {
        streams.write(&value.to_le_bytes()).then_some(())
    }

    /// The host gets the exit status; a debugger shows the rest.
    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        exit(false)
    }
}

foretorque_f405::on_the_host!();
