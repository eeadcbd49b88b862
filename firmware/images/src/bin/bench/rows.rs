//! One function a row, kept apart by its address being taken: nothing about its inputs is known when it is compiled.

use core::hint::black_box;

use foretorque::arm::panda::{self, Panda};
use foretorque::dynamics::{friction, regressor, regressor_row, rnea};
use foretorque::learning::network_inputs;
use foretorque::math;
use foretorque_f405::arm::{Arm, JOINTS, PARAMETERS};
use foretorque_test_arms::ur5_calibrated::{self, Ur5Calibrated};

use crate::stage::Stage;

/// One measured function.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) run: fn(&mut Stage),
}

macro_rules! rows {
    ($table:ident: $($name:ident($stage:pat) $body:expr;)*) => {
        $(
            #[inline(never)]
            pub(crate) fn $name($stage: &mut Stage) {
                $body
            }
        )*
        pub(crate) static $table: &[Row] = &[$(Row { name: stringify!($name), run: $name }),*];
    };
}

// The results of a regressor and of a tick are looked at where they are: a copy would be no part of the work.
// The networks are reached by a pointer to each, as by any caller that does not keep them in a struct of everything.
// The host subtracts the first row: what a call costs whose function returns at once.
rows! {
    ARM_ROWS:
    empty(_) ();
    sin_cos(s) s.sin_cos = math::sin_cos(s.angle);
    rnea_ur5(s) s.tau = rnea::<Arm, JOINTS, PARAMETERS>(&s.set.rigid, &s.motion);
    rnea_calibrated(s) s.calibrated_tau =
        rnea::<Ur5Calibrated, { ur5_calibrated::JOINTS }, { ur5_calibrated::PARAMETERS }>(
            &s.calibrated, &s.calibrated_motion,
        );
    rnea_7dof(s) s.panda_tau =
        rnea::<Panda, { panda::JOINTS }, { panda::PARAMETERS }>(&s.panda, &s.panda_motion);
    regressor_row_ur5(s) { black_box(&regressor_row::<Arm, JOINTS, PARAMETERS>(s.joint, &s.motion)); };
    regressor_ur5(s) { black_box(&regressor::<Arm, JOINTS, PARAMETERS>(&s.motion)); };
    friction_ur5(s) s.tau = friction::<Arm, JOINTS, PARAMETERS>(&s.set.friction, &s.motion.q, &s.motion.qd);
    bp_18_32_6_forward(s) s.output = black_box(&mut s.paper).forward(&s.input);
    bp_18_32_6_update(s) s.output = black_box(&mut s.paper).update(&s.input, &s.target, &s.step);
    block_network(s) s.block_network();
    feedforward_step(s) { black_box(&s.feedforward.step(&s.sample)); };
    learning_step(s) s.learner.learn(&s.learning_sample, &mut s.exchange);
}

rows! {
    LINK_ROWS:
    command(s) s.link.iter_mut().for_each(|link| link.run());
    configure(s) { black_box("another function than that of a command"); s.link.iter_mut().for_each(|link| link.run()) };
    bus_tick(s) s.bus.iter_mut().for_each(|bus| bus.tick());
    in_line(s) s.bus.iter_mut().for_each(|bus| bus.pass());
}

impl Stage {
    /// The residual networks of all joints, their inputs included.
    #[inline(always)]
    fn block_network(&mut self) {
        let joints = self.set.network.iter().zip(self.motion.qd.iter());
        for (tau, (network, &qd)) in self.tau.iter_mut().zip(joints) {
            let [[output]] = network.forward(&network_inputs(qd)).data.0;
            *tau = output;
        }
    }
}
