//! One function a row, kept apart by its address being taken: nothing about its inputs is known when it is compiled.


use foretorque::dynamics::friction;
use foretorque::learning::network_inputs;

use crate::stage::Stage;

/// One measured function.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) run: fn(&mut Stage),
}

macro_rules! rows {
    ($($name:ident($stage:pat) $body:expr;)*) => {
        $(
            #[inline(never)]
            fn $name($stage: &mut Stage) {
                $body
            }
        )*
        pub(crate) static ROWS: &[Row] = &[$(Row { name: stringify!($name), run: $name }),*];
    };
}

// The host subtracts the first row: what a call costs whose function returns at once.
rows! {
    empty(_) ();
    friction_ur5(s) s.tau = friction(&s.set.friction, &s.motion.qd);
    bp_18_32_6_forward(s) s.output = s.paper.forward(&s.input);
    bp_18_32_6_update(s) s.output = s.paper.update(&s.input, &s.target, &s.step);
    block_network(s) s.block_network();
    feedforward_step(s) s.torque = s.feedforward.step(&s.sample);
    learning_step(s) s.learner.learn(&s.lesson, &mut s.exchange);
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
